"""The lines of a g2o file as numbers, each one checked: complaints name the file, the line and the remedy."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

UPPER = {dof: np.triu_indices(dof) for dof in (3, 6)}
_ROUNDING = 1e-9  # of a negative eigenvalue, relative to the largest
_SINGULAR = 1e-13  # least eigenvalue, relative to the largest, that solvers can use
_UNIT_TOLERANCE = 0.01  # files round quaternions; more than this is damage
_LARGEST_INFORMATION = 1e100  # whose square is a number still
_LARGEST_ID = np.iinfo(np.int64).max
_PASSED_OVER = "PRIOR"  # part of the names of factors that pull poses to absolute places


@dataclass(frozen=True)
class Kind:
    """How a group's poses are written.

    Attributes:
        vertex, edge: the tags of its lines.
        size: numbers of a pose.
        dof: rows of an information matrix.
    """

    vertex: str
    edge: str
    size: int
    dof: int

    @classmethod
    def of(cls, name: str) -> "Kind":
        """Kind of `SE2` or `SE3:QUAT`."""
        return cls(f"VERTEX_{name}", f"EDGE_{name}", *((3, 3) if name == "SE2" else (7, 6)))


KINDS = (Kind.of("SE2"), Kind.of("SE3:QUAT"))
_BY_TAG = {tag: kind for kind in KINDS for tag in (kind.vertex, kind.edge)}


@dataclass(frozen=True)
class GraphLines:
    """What a file says, in the file's order of numbers.

    Attributes:
        kind: plane or space.
        vertex_ids: (N,).
        vertices: (N, 3 or 7).
        edge_ids: (M, 2).
        edges: (M, 3 or 7).
        information: (M, dof, dof), positive definite.
        fixed: id of the pose that keeps its place, or None.
        warnings: what was repaired or passed over.
    """

    kind: Kind
    vertex_ids: Ids
    vertices: Array
    edge_ids: Ids
    edges: Array
    information: Array
    fixed: int | None
    warnings: tuple[str, ...]

    @property
    def placed(self) -> bool:
        """The file has poses, not edges alone."""
        return len(self.vertex_ids) > 0


class _Reader:
    """Collects the numbers of one file's lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.kind: Kind | None = None
        self.ids: list[int] = []
        self.vertices: list[Array] = []
        self.ends: list[tuple[int, int]] = []
        self.edges: list[Array] = []
        self.edge_lines: list[int] = []
        self.fixed: int | None = None
        self.priors: list[int] = []

    def take(self, number: int, words: list[str]) -> None:
        """Take one line in, or pass it over."""
        if words[0] in _BY_TAG:
            self._take_numbers(number, words)
        elif words[0] == "FIX" and self.fixed is None and re.fullmatch(r"FIX \d{1,19}", " ".join(words)):
            self.fixed = int(words[1])
        elif _PASSED_OVER in words[0]:
            self.priors.append(number)

    def _take_numbers(self, number: int, words: list[str]) -> None:
        kind = _BY_TAG[words[0]]
        self.kind = self.kind or kind
        if kind is not self.kind:
            raise GraphError(
                f"{self.path}, line {number}: expected {self.kind.vertex} or {self.kind.edge} as before, found "
                f"{words[0]}; poses of the plane and of space do not mix, write two files"
            )
        if words[0] == kind.vertex:
            ids, numbers = self._parsed(number, words, 1, kind.size)
            self.ids.append(ids[0])
            self.vertices.append(numbers)
        else:
            ids, numbers = self._parsed(number, words, 2, kind.size + kind.dof * (kind.dof + 1) // 2)
            self.ends.append((ids[0], ids[1]))
            self.edges.append(numbers)
            self.edge_lines.append(number)

    def _parsed(self, number: int, words: list[str], ids: int, size: int) -> tuple[list[int], Array]:
        """Names of poses, and the numbers that follow them."""
        where = f"{self.path}, line {number}: {words[0]}"
        if len(words) - 1 != ids + size:
            raise GraphError(f"{where} has {len(words) - 1} numbers, expected {ids + size}; was the file cut short?")
        try:
            names, numbers = [int(word) for word in words[1 : ids + 1]], np.array([*map(float, words[ids + 1 :])])
        except ValueError as error:
            raise GraphError(f"{where} expected numbers, found others: {error}; mend that line") from error
        if not all(abs(name) <= _LARGEST_ID for name in names):
            raise GraphError(f"{where} expected names of poses up to {_LARGEST_ID}, found others; mend that line")
        self._check_finite(where, numbers)
        return names, numbers

    def _check_finite(self, where: str, numbers: Array) -> None:
        flat = self.kind is KINDS[0]
        length = 1.0 if flat else float(np.linalg.norm(numbers[3:7]))
        if not np.isfinite(numbers).all() or abs(length - 1.0) > _UNIT_TOLERANCE:
            quaternion = "" if flat else f" and a unit quaternion, its length is {length:.6g}"
            raise GraphError(f"{where} expected finite numbers{quaternion}; mend that line")


def read_lines_of(path: Path) -> GraphLines:
    """Read and check the lines of a g2o file.

    Raises:
        GraphError: see `slam.storage.g2o.read_g2o`.
    """
    reader = _Reader(path)
    for number, words in _lines(path):
        reader.take(number, words)
    if reader.kind is None:
        raise GraphError(
            f"{path}: expected VERTEX_SE2, VERTEX_SE3:QUAT, EDGE_SE2 or EDGE_SE3:QUAT lines, found none; "
            "is this a pose graph in g2o format?"
        )
    return _checked(reader, reader.kind)


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise GraphError(f"{path}: expected a pose graph in g2o format, could not read it: {error}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            yield number, words


def _checked(reader: _Reader, kind: Kind) -> GraphLines:
    vertices = np.array(reader.vertices).reshape(-1, kind.size)
    edges = np.array(reader.edges).reshape(-1, kind.size + len(UPPER[kind.dof][0]))
    ids, ends = np.array(reader.ids, np.int64), np.array(reader.ends, np.int64).reshape(-1, 2)
    _check_ids(reader.path, ids)
    if len(ids):
        _check_ends(reader, kind, ids, ends)
    information, kept, warnings = _mended(reader, edges[:, kind.size :], ends)
    if reader.priors:
        warnings.append(f"{reader.path}, line {reader.priors[0]}: {len(reader.priors)} priors are passed over")
    return GraphLines(
        kind, ids, vertices, ends[kept], edges[kept, : kind.size], information, reader.fixed, tuple(warnings)
    )


def _check_ids(path: Path, ids: Ids) -> None:
    known, counts = np.unique(ids, return_counts=True)
    if len(counts) and counts.max() > 1:
        twice = known[counts.argmax()]
        raise GraphError(f"{path}: pose {twice} is there {counts.max()} times, expected once; remove the others")


def _check_ends(reader: _Reader, kind: Kind, ids: Ids, ends: Ids) -> None:
    lost = np.flatnonzero(~np.isin(ends, ids).all(axis=1))
    if lost.size:
        missing = next(int(end) for end in ends[lost[0]] if end not in ids)
        raise GraphError(
            f"{reader.path}, line {reader.edge_lines[lost[0]]}: expected poses with a {kind.vertex} line, found "
            f"an edge to {missing}, which has none; add it, or leave out all poses"
        )


def _mended(reader: _Reader, upper: Array, ends: Ids) -> tuple[Array, NDArray[np.bool_], list[str]]:
    """Information of the edges that say something, which those are, and what was said about the others."""
    beyond = np.flatnonzero(np.abs(upper).max(axis=1, initial=0.0) > _LARGEST_INFORMATION)
    if beyond.size:
        raise GraphError(
            f"{reader.path}, line {reader.edge_lines[beyond[0]]}: expected information up to {_LARGEST_INFORMATION:g}, "
            "found more; mend that line"
        )
    information = _symmetric(upper)
    spectrum = np.linalg.eigvalsh(information) if len(information) else np.ones((0, 1))
    largest = np.abs(spectrum).max(axis=1)
    negative = np.flatnonzero(spectrum[:, 0] < -_ROUNDING * largest)
    if negative.size:
        i, j = ends[negative[0]]
        raise GraphError(
            f"{reader.path}, line {reader.edge_lines[negative[0]]}: the information of edge {i} {j} has a negative "
            "eigenvalue, expected none; are its numbers the upper triangle by rows?"
        )
    selves, empty = ends[:, 0] == ends[:, 1], largest == 0
    flat = ~selves & ~empty & (spectrum[:, 0] < _SINGULAR * largest)
    lift = np.where(flat, _ROUNDING * largest, 0.0)
    information = information + lift[:, None, None] * np.eye(information.shape[1])
    told = (
        (selves, "joins a pose to itself and is left out"),
        (empty & ~selves, "has zero information and is left out"),
        (flat, "has no information in some direction; a billionth of its largest is put there"),
    )
    warnings = [
        f"{reader.path}, line {reader.edge_lines[np.flatnonzero(which)[0]]}: an edge {what} ({which.sum()} such edges)"
        for which, what in told
        if which.any()
    ]
    kept = ~selves & ~empty
    return information[kept], kept, warnings


def _symmetric(upper: Array) -> Array:
    """Matrices (M, dof, dof) of their upper triangles by rows (M, dof (dof + 1) / 2)."""
    dof = 3 if upper.shape[1] == 6 else 6
    rows, columns = UPPER[dof]
    out = np.zeros((len(upper), dof, dof))
    out[:, rows, columns] = upper
    out[:, columns, rows] = upper
    return out
