"""What people have in their g2o files besides poses and plain edges is read, or counted and named."""

import codecs
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.errors import GraphError
from slam.io.g2o import Graph, read_g2o, write_g2o
from slam.io.g2o_problem import classify_edges

UNIT = "1 0 0 1 0 1"
UNIT_SPACE = " ".join(str(float(i == j)) for i in range(6) for j in range(i, 6))
PLANE = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(3)) + "".join(
    f"EDGE_SE2 {k} {k + 1} 1 0 0 {UNIT}\n" for k in range(2)
)
SPACE = "".join(f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1\n" for k in range(3)) + "".join(
    f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0 0 0 0 1 {UNIT_SPACE}\n" for k in range(2)
)
SYMBOL_A, SYMBOL_B = ord("a") << 56, ord("b") << 56


def read(folder: Path, text: str) -> Graph:
    path = folder / "a.g2o"
    path.write_text(text)
    return read_g2o(path)


@pytest.mark.parametrize(
    ("lines", "tag", "sentence"),
    [
        ("VERTEX_XY 9 1 2\nVERTEX_XY 8 1 2", "VERTEX_XY", "2 lines VERTEX_XY (first in line 6): landmarks"),
        ("EDGE_SE2_XY 0 9 1 2 1 0 1", "EDGE_SE2_XY", "1 line EDGE_SE2_XY (first in line 6): landmarks"),
        ("EDGE_BEARING_SE2_XY 0 9 1 1", "EDGE_BEARING_SE2_XY", "(first in line 6): landmarks"),
        ("EDGE_PRIOR_SE2_XY 0 1 2 1 0 1", "EDGE_PRIOR_SE2_XY", "(first in line 6): priors are ignored"),
        ("PARAMS_SE2OFFSET 0 0 0 0", "PARAMS_SE2OFFSET", "(first in line 6): parameters"),
        ("VERTEX_SWITCH 9 1\nEDGE_SWITCH_PRIOR 9 1 1", "EDGE_SWITCH_PRIOR", "(first in line 7): the robust back end"),
        ("EQUIV 0 1\nEQUIV 1 2\nEQUIV 0 2", "EQUIV", "3 lines EQUIV (first in line 6): only poses and the edges"),
    ],
)
def test_each_tag_that_is_not_read_is_counted_with_its_first_line(
    tmp_path: Path, lines: str, tag: str, sentence: str
) -> None:
    warning = next(w for w in read(tmp_path, PLANE + lines + "\n").warnings if f" {tag} " in w)
    assert "a.g2o: passed over " in warning
    assert sentence in warning


def test_landmarks_in_space_are_counted_and_the_edges_between_poses_stay(tmp_path: Path) -> None:
    lines = "VERTEX_TRACKXYZ 7 1 2 3\nEDGE_SE3_TRACKXYZ 0 7 0 1 2 3 1 0 0 1 0 1\n"
    graph = read(tmp_path, SPACE + lines)
    assert [w.split("passed over ")[1] for w in graph.warnings] == [
        "1 line VERTEX_TRACKXYZ (first in line 6): landmarks are not supported",
        "1 line EDGE_SE3_TRACKXYZ (first in line 7): landmarks are not supported",
    ]
    assert len(graph.first) == 2


def test_a_file_of_other_tags_alone_names_them(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match=r"found 2 lines EDGE2 \(first in line 1\)"):
        read(tmp_path, "EDGE2 0 1 1 0 0\nEDGE2 1 2 1 0 0\n")


def test_a_graph_without_loops_says_so(tmp_path: Path) -> None:
    found = classify_edges(read(tmp_path, PLANE), "a")
    assert found.warnings == ("a: there is no loop, so the poses stay where odometry puts them",)


@pytest.mark.parametrize("kind", ["SWITCHABLE", "MAXMIX"])
@pytest.mark.parametrize("middle", ["1000", "0.01"])
def test_edges_of_vertigo_are_the_loops_that_they_stand_for(tmp_path: Path, kind: str, middle: str) -> None:
    plain = read(tmp_path, PLANE + "EDGE_SE2 0 2 1.5 0.5 0.25 2 0 0 3 0 4\n")
    graph = read(tmp_path, PLANE + f"EDGE_SE2_{kind} 0 2 {middle} 1.5 0.5 0.25 2 0 0 3 0 4\n")
    for name in ("first", "second", "motions", "information"):
        np.testing.assert_array_equal(getattr(graph, name), getattr(plain, name))
    assert graph.declared_loops.tolist() == [2]
    assert classify_edges(graph, "a").trusted.tolist() == [True, True, False]


@pytest.mark.parametrize("tag", ["EDGE_SE3_SWITCHABLE", "EDGE_SE3_MAXMIX", "EDGE_SE3:QUAT_SWITCHABLE"])
def test_edges_of_vertigo_in_space_are_loops_too(tmp_path: Path, tag: str) -> None:
    graph = read(tmp_path, SPACE + f"{tag} 0 2 77 1 2 3 0 0 1 0 {UNIT_SPACE}\n")
    np.testing.assert_allclose(
        graph.motions[2], se3.pose(np.diag([-1.0, -1.0, 1.0]), np.array([1.0, 2.0, 3.0])), atol=1e-15
    )
    assert classify_edges(graph, "a").trusted.tolist() == [True, True, False]


def test_a_declared_loop_between_successive_poses_is_no_odometry(tmp_path: Path) -> None:
    loop = f"EDGE_SE2_SWITCHABLE 0 1 1000 9 9 0 {UNIT}\n"
    found = classify_edges(read(tmp_path, loop + PLANE), "a")
    assert found.trusted.tolist() == [False, True, True]


def test_an_edge_of_vertigo_that_is_cut_short_is_named(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="line 6: EDGE_SE2_MAXMIX has 11 numbers, expected 12"):
        read(tmp_path, PLANE + "EDGE_SE2_MAXMIX 0 2 0.01 1 0 1 0 0 1 0 1\n")


@pytest.mark.parametrize("fix", ["FIX 1 2", "FIX 1\nFIX 2", "FIX 1\nFIX 2 1"])
def test_the_first_of_several_fixed_poses_is_held_and_all_are_written(tmp_path: Path, fix: str) -> None:
    graph = read(tmp_path, PLANE + fix + "\n")
    assert (graph.fixed, graph.also_fixed) == (1, (2,))
    assert "passed over FIX of 2: pose 1, the first, is held" in graph.warnings[0]
    write_g2o(tmp_path / "b.g2o", graph)
    assert (tmp_path / "b.g2o").read_text().endswith("FIX 1\nFIX 2\n")
    assert read_g2o(tmp_path / "b.g2o").also_fixed == (2,)


def test_a_fixed_vertex_that_is_no_pose_is_named(tmp_path: Path) -> None:
    graph = read(tmp_path, PLANE + "VERTEX_XY 9 1 2\nFIX 9 2\n")
    assert (graph.fixed, graph.also_fixed) == (2, ())
    assert "passed over FIX of 9: the graph has no such pose" in graph.warnings[-1]


@pytest.mark.parametrize("words", ["", " a", " 1 2.5", " -1"])
def test_fix_without_ids_is_refused_with_its_line(tmp_path: Path, words: str) -> None:
    with pytest.raises(GraphError, match="line 6: expected ids of poses after FIX, found"):
        read(tmp_path, PLANE + f"FIX{words}\n")


@pytest.mark.parametrize(
    "data",
    [
        codecs.BOM_UTF8 + PLANE.encode(),
        codecs.BOM_UTF16_LE + PLANE.encode("utf-16-le"),
        codecs.BOM_UTF16_BE + PLANE.encode("utf-16-be"),
    ],
)
def test_a_byte_order_mark_costs_no_line(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.g2o").write_bytes(data)
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph.ids.tolist() == [0, 1, 2]
    assert graph.warnings == ()


def two_robots(first: int, second: int, false: str, step: int = 1, count: int = 12) -> str:
    """Two robots that drive the same line, with true loops between them and a false one written where it says."""
    lines = [
        f"EDGE_SE2 {robot + step * k} {robot + step * (k + 1)} 1 0 0 {UNIT}"
        for robot in (first, second)
        for k in range(count - 1)
    ]
    loops = [f"EDGE_SE2 {first + step * k} {second + step * k} 0 0.5 0 {UNIT}" for k in range(0, count, 2)]
    wrong = [f"EDGE_SE2 {first + step * (count - 1)} {second} 8 3 2 {UNIT}"]
    parts = {"first": [wrong, lines, loops], "between": [lines, wrong, loops], "last": [lines, loops, wrong]}[false]
    return "\n".join(line for part in parts for line in part) + "\n"


@pytest.mark.parametrize("false", ["first", "between", "last"])
@pytest.mark.parametrize(
    ("first", "second", "step"),
    [
        (SYMBOL_A, SYMBOL_B, 1),
        (SYMBOL_A, SYMBOL_A + (1 << 48), 1),  # labelled symbols
        (0, 1000, 1),
        (0, 100, 1),
        (0, 10000, 5),  # key frames
    ],
)
def test_an_edge_between_two_robots_is_never_odometry(
    tmp_path: Path, first: int, second: int, step: int, false: str
) -> None:
    graph = read(tmp_path, two_robots(first, second, false, step))
    found = classify_edges(graph, "a")
    wrong = (graph.first == first + 11 * step) & (graph.second == second)
    assert not found.trusted[wrong].any()
    assert found.trusted.sum() == 2 * 11 + 1
    # One true loop connects the two, so the second robot starts where it truly is.
    np.testing.assert_allclose(found.problem.start[12:, :2, 2], [[k, 0.5] for k in range(12)], atol=1e-12)
    assert "no odometry leads to some poses; 1 other edges are trusted instead" in found.warnings[0]
    assert found.connecting.sum() == 1


def test_key_frames_with_uneven_gaps_are_one_robot(tmp_path: Path) -> None:
    ids = np.cumsum([0, 4, 5, 9, 3, 30, 5, 6])
    lines = [f"EDGE_SE2 {i} {j} 1 0 0 {UNIT}" for i, j in pairwise(ids)]
    graph = read(tmp_path, "\n".join([f"EDGE_SE2 {ids[0]} {ids[-1]} 9 9 0 {UNIT}", *lines]) + "\n")
    assert classify_edges(graph, "a").trusted.tolist() == [False] + [True] * 7


def test_robots_of_few_poses_differ_by_their_symbols(tmp_path: Path) -> None:
    edges = [(SYMBOL_A, SYMBOL_B, 8), (SYMBOL_B, SYMBOL_B + 1, 1), (SYMBOL_A, SYMBOL_B + 1, 1)]
    graph = read(tmp_path, "".join(f"EDGE_SE2 {i} {j} {x} 0 0 {UNIT}\n" for i, j, x in edges))
    assert classify_edges(graph, "a").connecting.sum() == 1
