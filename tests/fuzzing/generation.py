"""Files put together from what files of their kind hold: hypothesis strategies of bytes."""

import dataclasses
import json
from typing import Any, get_type_hints

import yaml
from hypothesis import strategies as st

from slam.config import RunConfig
from slam.simulation.scenario.config import SHAPES

from .valid_files import CALIB, CAMERA, TRUTH, toml
from .valid_files import array_files as _arrays

IMAGE_MARKS = (
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff\xe0",
    b"BM",
    b"P5\n",
    b"P2 ",
    b"II*\0",
    b"MM\0*",
    b"GIF89a",
    b"RIFF",
)
NUMBERS = st.one_of(st.integers(-3, 12), st.integers(), st.floats(-2, 2), st.floats())
VALUES = st.recursive(
    NUMBERS | st.booleans() | st.text(max_size=8), lambda inner: st.lists(inner, max_size=4), max_leaves=6
)
CELLS = st.one_of(
    NUMBERS.map(str), st.sampled_from(["", "true", "false", "nan", '"', "9" * 400, "\0", "predicted", "measured"])
)


def files_of(*marks: bytes) -> st.SearchStrategy[bytes]:
    """Anything behind the mark by which a kind of file is known."""
    return st.builds(lambda mark, data: mark + data, st.sampled_from(marks), st.binary(max_size=200))


def tables(
    header: str, separator: str = ",", columns: int | None = None, words: tuple[str, ...] = ("0",)
) -> st.SearchStrategy[bytes]:
    """Rows of cells, most of them with the right number of these."""
    count = columns or header.count(separator) + 1
    right = st.lists(CELLS | st.sampled_from(words), min_size=count, max_size=count)
    rows = st.lists(right | right | st.lists(CELLS, max_size=count + 1), max_size=5)
    return rows.map(lambda cells: "\n".join([header, *map(separator.join, cells)]).encode("utf-8", "surrogatepass"))


def calibrations() -> st.SearchStrategy[bytes]:
    lines = st.builds(lambda name, cells: f"{name}: {' '.join(cells)}", st.sampled_from(["P0", "P1", "Tr", "P0:"]),
        st.lists(CELLS, min_size=11, max_size=13))  # fmt: skip
    return st.lists(lines | st.sampled_from(CALIB.decode().splitlines()), max_size=6).map(_lines)


def graphs() -> st.SearchStrategy[bytes]:
    tags = st.sampled_from(["VERTEX_SE2", "EDGE_SE2", "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX", "#", "EDGE_PRIOR"])
    ids, sizes = st.integers(0, 3) | st.integers(), {"VERTEX_SE2": 3, "EDGE_SE2": 9, "VERTEX_SE3:QUAT": 7}

    @st.composite
    def line(draw: Any) -> str:
        tag = draw(tags)
        count = sizes.get(tag, 28)
        ends = draw(st.lists(ids, min_size=1 + tag.startswith("EDGE"), max_size=1 + tag.startswith("EDGE")))
        near = draw(st.lists(st.sampled_from([0, 1, 0.5, -1]) | NUMBERS, min_size=count, max_size=count))
        return " ".join(map(str, [tag, *ends, *near]))

    return st.lists(line(), max_size=5).map(_lines)


def _lines(lines: list[str]) -> bytes:
    return "\n".join(lines).encode()


def _of(names: list[str]) -> st.SearchStrategy[dict[str, Any]]:
    return st.dictionaries(st.sampled_from(names), VALUES, max_size=6)


_LENS = ["fx", "fy", "cx", "cy", "baseline", "model", "distortion", "fps", "left", "right", "ground_truth"]


def camera_files() -> st.SearchStrategy[bytes]:
    good = {"fx": 10, "fy": 10, "cx": 7.5, "cy": 5.5, "fps": 10}
    models = st.sampled_from(["radtan", "equidistant", "rational", "none"])
    bent = st.fixed_dictionaries({"model": models, "distortion": st.lists(st.floats(-2, 2), min_size=4, max_size=8)})
    T = st.lists(st.sampled_from([0, 1, 0.1, -1]), min_size=16, max_size=16)
    right = st.builds(lambda a, b, T: good | a | b | {"T_left_right": T}, _of(_LENS), bent, T)
    return st.one_of(
        _of(_LENS).map(lambda values: toml(good | values)),
        bent.map(lambda values: toml(good | values)),
        st.builds(lambda a, b: toml(good | a | {"right_camera": b}), bent, right),
    )


def sensors() -> st.SearchStrategy[bytes]:
    names = ["T_BS", "intrinsics", "distortion_model", "distortion_coefficients", "resolution"]
    good = {"T_BS": [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "intrinsics": [20, 20, 7, 5]}
    return _of(names).map(lambda values: yaml.safe_dump(good | values).encode())


def _names(kind: type) -> dict[str, Any]:
    """Names of the settings of a configuration; tables hold more of them."""
    hints = get_type_hints(kind)
    return {name: _names(hint) if dataclasses.is_dataclass(hint) else None for name, hint in hints.items()}  # type: ignore[arg-type]


def _settings(names: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    """At most two settings at each level."""
    choices = {name: VALUES if inner is None else VALUES | _settings(inner) for name, inner in names.items()}
    one = st.sampled_from(sorted(names)).flatmap(lambda name: choices[name].map(lambda value: {name: value}))
    return st.lists(one, max_size=2).map(lambda parts: {key: value for part in parts for key, value in part.items()})


def configurations() -> st.SearchStrategy[bytes]:
    return _settings(_names(RunConfig)).map(toml)


def sweeps() -> st.SearchStrategy[bytes]:
    paths = st.sampled_from(["data/kitti", "", "~", "~x", "..", *SHAPES]) | VALUES
    source = st.dictionaries(
        st.sampled_from(["path", "simulate", "sequence", "name", "laps", "length_m", "seed", "width", "kind"]),
        paths, max_size=4,
    )  # fmt: skip
    whole = st.fixed_dictionaries(
        {"sources": st.lists(source, max_size=3)},
        optional={name: VALUES | st.lists(VALUES, max_size=3) for name in ("paradigms", "robust", "seeds", "config")},
    )
    return whole.map(toml)


def json_texts() -> st.SearchStrategy[bytes]:
    inner = st.dictionaries(st.text(max_size=8), VALUES | st.none(), max_size=4)
    return (inner | VALUES).map(lambda value: json.dumps(value).encode("utf-8", "surrogatepass"))


def vocabularies() -> st.SearchStrategy[bytes]:
    whole = st.one_of(st.integers(-2, 8), st.integers(), st.floats(), st.text(max_size=3), st.none())
    header = st.fixed_dictionaries(
        {"kind": st.sampled_from(["orb", "surf-upright-64"]) | VALUES, "words": whole, "size": whole},
        optional={"encoding": st.sampled_from(["bits", "int8", "float32", ""]) | VALUES, "nodes": whole},
    )
    return st.builds(
        lambda version, head, numbers: (
            b"REVISIT VOCABULARY %d\n%s\n" % (version, json.dumps(head).encode()) + numbers + bytes(32)
        ),
        st.sampled_from([1, 2]),
        header,
        st.binary(max_size=80),
    )


def array_files() -> st.SearchStrategy[bytes]:
    """`.npy` files whose header says what their numbers do not bear out."""
    sides = st.lists(st.integers(-1, 4) | st.sampled_from([10**5, 10**9, 2**62]), max_size=3)
    kinds = st.sampled_from(["|u1", "<f8", "|O", "<U9", "<c16", "|b1", "<M8[s]", "V8", "[('a', '<f8')]", "x", ">f2"])

    def written(kind: str, shape: list[int], order: bool, data: bytes) -> bytes:
        head = f"{{'descr': {kind!r}, 'fortran_order': {order}, 'shape': {tuple(shape)}, }}".encode()
        head += b" " * (-(len(head) + 11) % 64) + b"\n"
        return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + data

    return st.builds(written, kinds, sides, st.booleans(), st.binary(max_size=80)) | st.sampled_from(_arrays(TRUTH))


def calibration_files() -> st.SearchStrategy[bytes]:
    groups = st.dictionaries(st.sampled_from(["lens", "column", "row", "x"]), VALUES, max_size=3)
    camera = st.dictionaries(st.sampled_from(["fx", "fy", "cx", "cy", "baseline", "width", "height"]), NUMBERS)
    good = {key: float(value) for key, _, value in (line.partition(" = ") for line in CAMERA.splitlines())}
    return st.builds(
        lambda c, error, sigma: toml({"camera": good | {"baseline": 0.5, "width": 16, "height": 12} | c,
                                      "error_px": error, "sigma_px": sigma}),
        camera, groups, groups,
    )  # fmt: skip
