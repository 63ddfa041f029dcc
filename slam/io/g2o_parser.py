"""Parser of g2o files: every line is checked, and errors name the file, the line and the remedy.

Edges of Vertigo, `EDGE_SE2_SWITCHABLE` and `EDGE_SE2_MAXMIX` (and SE3), are read as the loops that they stand for; the
number behind their ids, a switch or a weight, belongs to a solver of another kind. Lines that are not read are counted.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError
from slam.io.files import PassedOver, read_text

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

UPPER = {dof: np.triu_indices(dof) for dof in (3, 6)}
_ROUNDING = 1e-9  # of a negative eigenvalue, relative to the largest one; also the size of a repaired eigenvalue
_MIN_EIGENVALUE = 1e-13  # relative to the largest one: solvers cannot use less
_UNIT_TOLERANCE = 0.01  # of the length of a quaternion: files round it, a larger error is damage
_MAX_INFORMATION = 1e100  # whose square is still a finite number
_MAX_ID = np.iinfo(np.int64).max
# Why lines of other tags are passed over, by a part of their tag; the first that fits.
_REASONS = (
    ("SWITCH", "the robust back end decides on the loops without switches"),
    ("PRIOR", "priors are ignored"),
    ("PARAMS", "parameters of sensors change no edge between poses"),
    (r"_XY|XYZ|POINT|BEARING|LINE|DEPTH|DISPARITY", "landmarks are not supported"),
    ("", "only poses and the edges between them are read"),
)
_LOOP_TAG = re.compile(r"EDGE_(SE2|SE3)(?::QUAT)?_(?:SWITCHABLE|MAXMIX)(?::QUAT)?")


@dataclass(frozen=True)
class Kind:
    """Tags and sizes of the lines of planar or of spatial graphs.

    Attributes:
        vertex, edge: tags of pose lines and of edge lines.
        size: number of numbers of a pose.
        dof: rows of an information matrix.
    """

    vertex: str
    edge: str
    size: int
    dof: int

    @classmethod
    def of(cls, name: str) -> "Kind":
        """Return the kind of `SE2` or `SE3:QUAT`."""
        return cls(f"VERTEX_{name}", f"EDGE_{name}", *((3, 3) if name == "SE2" else (7, 6)))


KINDS = (Kind.of("SE2"), Kind.of("SE3:QUAT"))
_BY_TAG = {tag: kind for kind in KINDS for tag in (kind.vertex, kind.edge)}


@dataclass(frozen=True)
class ParsedGraph:
    """The numbers of a g2o file, in the file's order.

    Attributes:
        kind: planar or spatial.
        vertex_ids: ids of the poses, (N,).
        vertices: numbers of the poses, (N, 3) or (N, 7).
        edge_ids: ids that each edge joins, (M, 2).
        edges: numbers of the relative poses, (M, 3) or (M, 7).
        information: information matrices, (M, dof, dof), positive definite.
        is_declared_loop: (M,) bool, edges that their tag declares to be loops.
        fixed: ids of the poses that are to be held fixed, in the file's order; those that exist.
        warnings: repairs and ignored lines, a sentence each.
    """

    kind: Kind
    vertex_ids: Ids
    vertices: Array
    edge_ids: Ids
    edges: Array
    information: Array
    is_declared_loop: NDArray[np.bool_]
    fixed: tuple[int, ...]
    warnings: tuple[str, ...]

    @property
    def has_poses(self) -> bool:
        """Whether the file has poses, not only edges."""
        return len(self.vertex_ids) > 0


class _Table:
    """The lines of one tag: ids of poses, then numbers, of which the first are a pose."""

    def __init__(self, path: Path, tag: str, num_ids: int, num_numbers: int) -> None:
        self.tag = tag
        self._path, self._num_ids, self._num_numbers = path, num_ids, num_numbers
        self._lines: list[int] = []
        self._ids: list[list[int]] = []
        self._numbers: list[list[float]] = []

    def add(self, line: int, words: list[str]) -> None:
        """Parse one line."""
        where, count = f"{self._path}, line {line}: {self.tag}", self._num_ids + self._num_numbers
        if len(words) - 1 != count:
            raise GraphError(f"{where} has {len(words) - 1} numbers, expected {count}; was the file cut short?")
        try:
            ids = [int(word) for word in words[1 : self._num_ids + 1]]
            numbers = [float(word) for word in words[self._num_ids + 1 :]]
        except ValueError as error:
            raise GraphError(f"{where} expected numbers, found others: {error}; correct that line") from error
        if max(map(abs, ids)) > _MAX_ID:
            raise GraphError(f"{where} expected ids of poses up to {_MAX_ID}, found others; correct that line")
        self._lines.append(line)
        self._ids.append(ids)
        self._numbers.append(numbers)

    def where(self, row: int) -> str:
        """Return file and line of a row, for messages."""
        return f"{self._path}, line {self._lines[row]}"

    def are_lines(self, lines: Collection[int]) -> NDArray[np.bool_]:
        """Return which rows (N,) stand in the given lines of the file."""
        return np.array([line in lines for line in self._lines], dtype=np.bool_)

    def arrays(self) -> tuple[Ids, Array]:
        """Return ids (N, 1 or 2) and numbers (N, K) of all lines, checked to be finite with unit quaternions."""
        ids = np.array(self._ids, np.int64).reshape(-1, self._num_ids)
        numbers = np.array(self._numbers).reshape(-1, self._num_numbers)
        is_planar = _BY_TAG[self.tag] is KINDS[0]
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are refused below
            lengths = np.ones(len(numbers)) if is_planar else np.linalg.norm(numbers[:, 3:7], axis=1)
            is_valid = np.isfinite(numbers).all(axis=1) & (np.abs(lengths - 1.0) <= _UNIT_TOLERANCE)
        for row in np.flatnonzero(~is_valid)[:1]:
            quaternion = "" if is_planar else f" and a unit quaternion, its length is {lengths[row]:.6g}"
            raise GraphError(f"{self.where(row)}: {self.tag} expected finite numbers{quaternion}; correct that line")
        return ids, numbers


@dataclass
class _Lines:
    """What has been read of a file.

    Attributes:
        path: the file.
        tables: lines of poses and of edges, by tag; empty before the first one.
        declared_loops: lines of edges that their tag declares to be loops.
        fixed: ids after `FIX`, in the file's order.
        passed_over: lines of other tags.
    """

    path: Path
    tables: dict[str, _Table] = field(default_factory=dict)
    declared_loops: set[int] = field(default_factory=set)
    fixed: list[int] = field(default_factory=list)
    passed_over: PassedOver = field(default_factory=PassedOver)

    def add(self, line: int, words: list[str]) -> None:
        """Parse one line."""
        loop = _LOOP_TAG.fullmatch(words[0])
        if words[0] in _BY_TAG:
            self._add_to_table(line, words)
        elif loop:
            self.declared_loops.add(line)
            self._add_to_table(line, self._plain_edge(line, words, KINDS[loop[1] == "SE3"]))
        elif words[0] == "FIX":
            self.fixed += self._fixed_ids(line, words[1:])
        else:
            self.passed_over.add(words[0], line)

    def _add_to_table(self, line: int, words: list[str]) -> None:
        self.tables = self.tables or _make_tables(self.path, _BY_TAG[words[0]])
        if words[0] not in self.tables:
            raise GraphError(
                f"{self.path}, line {line}: expected {' or '.join(self.tables)} as before, found {words[0]}; poses of"
                " the plane and of space do not mix, write two files"
            )
        self.tables[words[0]].add(line, words)

    def _plain_edge(self, line: int, words: list[str], kind: Kind) -> list[str]:
        """Return the words of the edge without its switch or weight, the third number."""
        expected = 3 + kind.size + len(UPPER[kind.dof][0])
        if len(words) - 1 != expected:
            where = f"{self.path}, line {line}: {words[0]}"
            raise GraphError(f"{where} has {len(words) - 1} numbers, expected {expected}; was the file cut short?")
        return [kind.edge, *words[1:3], *words[4:]]

    def _fixed_ids(self, line: int, words: list[str]) -> list[int]:
        if not words or not all(re.fullmatch(r"\d{1,19}", word) for word in words):
            raise GraphError(
                f"{self.path}, line {line}: expected ids of poses after FIX, found {' '.join(words)[:60] or 'none'};"
                " correct that line"
            )
        return [int(word) for word in words]


def parse_g2o(path: Path) -> ParsedGraph:
    """Parse and check a g2o file.

    Raises:
        GraphError: see `slam.io.g2o.read_g2o`.
    """
    lines = _Lines(path)
    for line, words in _read_words(path):
        lines.add(line, words)
    if not lines.tables:
        others = ", ".join(map(lines.passed_over.describe, lines.passed_over.names()[:3])) or "none"
        raise GraphError(
            f"{path}: expected VERTEX_SE2, VERTEX_SE3:QUAT, EDGE_SE2 or EDGE_SE3:QUAT lines, found {others}; "
            "is this a pose graph in g2o format?"
        )
    return _check_graph(lines)


def _read_words(path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise GraphError(f"{path}: expected a pose graph in g2o format, could not read it: {error}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            yield number, words


def _make_tables(path: Path, kind: Kind) -> dict[str, _Table]:
    edge_size = kind.size + len(UPPER[kind.dof][0])
    return {
        kind.vertex: _Table(path, kind.vertex, 1, kind.size),
        kind.edge: _Table(path, kind.edge, 2, edge_size),
    }


def _check_graph(lines: _Lines) -> ParsedGraph:
    vertex_table, edge_table = lines.tables.values()
    kind = _BY_TAG[vertex_table.tag]
    (ids, vertices), (ends, edges) = vertex_table.arrays(), edge_table.arrays()
    _check_unique(lines.path, ids[:, 0])
    if len(ids):
        _check_ends(edge_table, kind, ids[:, 0], ends)
    information, is_kept, repairs = _repair_information(edge_table, edges[:, kind.size :], ends)
    fixed = tuple(key for key in dict.fromkeys(lines.fixed) if key in (ids if len(ids) else ends))
    return ParsedGraph(
        kind=kind,
        vertex_ids=ids[:, 0],
        vertices=vertices,
        edge_ids=ends[is_kept],
        edges=edges[is_kept, : kind.size],
        information=information,
        is_declared_loop=edge_table.are_lines(lines.declared_loops)[is_kept],
        fixed=fixed,
        warnings=(*repairs, *_describe_passed_over(lines), *_describe_fixed(lines, fixed)),
    )


def _describe_passed_over(lines: _Lines) -> list[str]:
    """Return a sentence for each tag that is not read."""
    sentences = []
    for tag in lines.passed_over.names():
        reason = next(reason for part, reason in _REASONS if re.search(part, tag))
        sentences.append(f"{lines.path}: passed over {lines.passed_over.describe(tag)}: {reason}")
    return sentences


def _describe_fixed(lines: _Lines, fixed: tuple[int, ...]) -> list[str]:
    """Return sentences about ids after `FIX` whose poses are not held."""
    sentences = []
    unknown = [key for key in dict.fromkeys(lines.fixed) if key not in fixed]
    if unknown:
        sentences.append(f"{lines.path}: passed over FIX of {_list_ids(unknown)}: the graph has no such pose")
    if len(fixed) > 1:
        sentences.append(
            f"{lines.path}: passed over FIX of {_list_ids(fixed[1:])}: pose {fixed[0]}, the first, is held, one alone"
        )
    return sentences


def _list_ids(ids: Sequence[int]) -> str:
    return ", ".join(map(str, ids[:5])) + (f" and {len(ids) - 5} more" if len(ids) > 5 else "")


def _check_unique(path: Path, ids: Ids) -> None:
    unique, counts = np.unique(ids, return_counts=True)
    if len(counts) and counts.max() > 1:
        twice = unique[counts.argmax()]
        raise GraphError(f"{path}: pose {twice} is there {counts.max()} times, expected once; remove the others")


def _check_ends(table: _Table, kind: Kind, ids: Ids, ends: Ids) -> None:
    for row in np.flatnonzero(~np.isin(ends, ids).all(axis=1))[:1]:
        missing = next(int(end) for end in ends[row] if end not in ids)
        raise GraphError(
            f"{table.where(row)}: expected poses with a {kind.vertex} line, found "
            f"an edge to {missing}, which has none; add it, or leave out all poses"
        )


def _repair_information(table: _Table, upper: Array, ends: Ids) -> tuple[Array, NDArray[np.bool_], list[str]]:
    """Return the information of usable edges, which edges those are, and warnings about the others."""
    for row in np.flatnonzero(np.abs(upper).max(axis=1, initial=0.0) > _MAX_INFORMATION)[:1]:
        raise GraphError(
            f"{table.where(row)}: expected information up to {_MAX_INFORMATION:g}, found more; correct that line"
        )
    information = _symmetric(upper)
    spectrum = np.linalg.eigvalsh(information) if len(information) else np.ones((0, 1))
    largest = np.abs(spectrum).max(axis=1)
    for row in np.flatnonzero(spectrum[:, 0] < -_ROUNDING * largest)[:1]:
        i, j = ends[row]
        raise GraphError(
            f"{table.where(row)}: the information of edge {i} {j} has a negative eigenvalue, expected none; are its"
            " numbers the upper triangle by rows?"
        )
    is_loop_to_itself, is_empty = ends[:, 0] == ends[:, 1], largest == 0
    is_kept = ~is_loop_to_itself & ~is_empty
    is_singular = is_kept & (spectrum[:, 0] < _MIN_EIGENVALUE * largest)
    lift = np.where(is_singular, _ROUNDING * largest, 0.0)
    information = information + lift[:, None, None] * np.eye(information.shape[1])
    problems = (
        (is_loop_to_itself, "joins a pose to itself and is left out"),
        (is_empty & ~is_loop_to_itself, "has zero information and is left out"),
        (is_singular, "has no information in some direction; a billionth of its largest is put there"),
    )
    warnings = [
        f"{table.where(int(np.argmax(which)))}: an edge {what} ({which.sum()} such edges)"
        for which, what in problems
        if which.any()
    ]
    return information[is_kept], is_kept, warnings


def _symmetric(upper: Array) -> Array:
    """Return the symmetric matrices (M, dof, dof) of upper triangles by rows (M, dof (dof + 1) / 2)."""
    dof = 3 if upper.shape[1] == 6 else 6
    rows, columns = UPPER[dof]
    out = np.zeros((len(upper), dof, dof))
    out[:, rows, columns] = upper
    out[:, columns, rows] = upper
    return out
