"""Graphs in g2o files: the same for us and for GTSAM."""

import re
from pathlib import Path

import gtsam
import numpy as np
import pytest

from odometry import se3
from slam.errors import GraphError
from slam.io.g2o import Graph, chain_graph, read_g2o, write_g2o
from slam.io.g2o_problem import classify_edges
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.lie_groups import SE2, inverse, planar_poses

RNG_SEED = 5
IDENTITY = "0 0 0 0 0 0 1"
UNIT_INFORMATION = " ".join(str(float(i == j)) for i in range(6) for j in range(i, 6))


def covariance(rng: np.random.Generator) -> np.ndarray:
    factor = rng.normal(size=(6, 6))
    return factor @ factor.T * 1e-3 + 1e-4 * np.eye(6)


def random_graph(count: int = 6) -> Graph:
    rng = np.random.default_rng(RNG_SEED)
    poses = np.array([se3.exp(rng.normal(size=6)) for _ in range(count)])
    odometry = [(se3.exp(rng.normal(size=6)), covariance(rng)) for _ in range(count - 1)]
    loop = LoopClosure(count - 1, 1, se3.exp(rng.normal(size=6)), covariance(rng), 30)
    return chain_graph(poses, odometry, [loop])


def test_a_graph_comes_back_from_its_file(tmp_path: Path) -> None:
    graph = random_graph()
    write_g2o(tmp_path / "a.g2o", graph)
    back = read_g2o(tmp_path / "a.g2o")
    np.testing.assert_array_equal(back.first, graph.first)
    np.testing.assert_array_equal(back.second, graph.second)
    for name in ("poses", "motions", "information"):
        np.testing.assert_allclose(getattr(back, name), getattr(graph, name), rtol=1e-12, atol=1e-13)


def test_writing_what_was_read_settles_to_the_same_bytes(tmp_path: Path) -> None:
    first, second, third = (tmp_path / f"{n}.g2o" for n in range(3))
    write_g2o(first, random_graph())
    write_g2o(second, random_graph())
    assert first.read_bytes() == second.read_bytes()
    write_g2o(third, read_g2o(first))
    write_g2o(second, read_g2o(third))
    difference = np.abs(read_g2o(third).poses - read_g2o(second).poses).max()
    assert difference < 1e-14


def test_gtsam_reads_the_same_poses_and_the_same_errors(tmp_path: Path) -> None:
    graph = random_graph()
    write_g2o(tmp_path / "a.g2o", graph)
    factors, values = gtsam.readG2o(str(tmp_path / "a.g2o"), True)
    expected = gtsam.NonlinearFactorGraph()
    for i, j, T, information in zip(graph.first, graph.second, graph.motions, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        expected.add(gtsam.BetweenFactorPose3(int(i), int(j), gtsam.Pose3(T), noise))
    for key, T in zip(graph.ids, graph.poses, strict=True):
        np.testing.assert_allclose(values.atPose3(int(key)).matrix(), T, atol=1e-12)
    assert factors.error(values) == pytest.approx(expected.error(values), rel=1e-9)


@pytest.mark.parametrize("name", ["sphere2500", "parking-garage", "smallGrid3D"])
def test_standard_graphs_have_the_error_that_gtsam_finds(test_data: Path, name: str) -> None:
    path = test_data / "pose_graphs" / f"{name}.g2o"
    graph = read_g2o(path)
    factors, values = gtsam.readG2o(str(path), True)
    row = {int(key): k for k, key in enumerate(graph.ids)}
    total = 0.0
    for i, j, T, information in zip(graph.first, graph.second, graph.motions, graph.information, strict=True):
        T_i_j = se3.inverse(graph.poses[row[int(i)]]) @ graph.poses[row[int(j)]]
        error = se3.log(se3.inverse(T) @ T_i_j)
        total += 0.5 * error @ information @ error
    assert len(graph.first) == factors.size()
    assert total == pytest.approx(factors.error(values), rel=1e-6)


def test_a_quaternion_is_normalised(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text("VERTEX_SE3:QUAT 3 1 2 3 0 0.7071 0 0.7071\n")
    graph = read_g2o(path)
    np.testing.assert_allclose(graph.poses[0, :3, :3] @ graph.poses[0, :3, :3].T, np.eye(3), atol=1e-15)
    assert graph.ids.tolist() == [3]
    assert graph.motions.shape == (0, 4, 4)


def test_lines_of_other_kinds_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(f"# made by hand\nPARAMS_SE3OFFSET 0 {IDENTITY}\n\nVERTEX_SE3:QUAT 0 {IDENTITY}\nFIX 0\n")
    assert len(read_g2o(path).ids) == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0", r"line 2: VERTEX_SE3:QUAT has 7 numbers, expected 8"),
        ("VERTEX_SE3:QUAT 1 0 zero 0 0 0 0 1", r"line 2.*expected numbers, found others"),
        ("VERTEX_SE3:QUAT 1.5 0 0 0 0 0 0 1", r"line 2.*expected numbers, found others"),
        ("VERTEX_SE3:QUAT 1 0 nan 0 0 0 0 1", r"line 2.*finite numbers"),
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 2", r"line 2.*unit quaternion, its length is 2"),
        (f"VERTEX_SE3:QUAT 0 {IDENTITY}", "pose 0 is there 2 times, expected once"),
        (
            f"EDGE_SE3:QUAT 0 9 {IDENTITY} {UNIT_INFORMATION}",
            "expected poses with a VERTEX_SE3:QUAT line, found an edge to 9",
        ),
        (
            f"VERTEX_SE3:QUAT 1 {IDENTITY}\nEDGE_SE3:QUAT 0 1 {IDENTITY} -{UNIT_INFORMATION}",
            "edge 0 1 has a negative eigenvalue",
        ),
        (f"EDGE_SE3:QUAT 0 0 {IDENTITY}", "has 9 numbers, expected 30; was the file cut short"),
    ],
)
def test_damage_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "bad.g2o"
    path.write_text(f"VERTEX_SE3:QUAT 0 {IDENTITY}\n{line}\n")
    with pytest.raises(GraphError, match=message) as caught:
        read_g2o(path)
    assert "bad.g2o" in str(caught.value)


def test_a_file_that_is_missing_or_empty_or_binary_is_named(tmp_path: Path) -> None:
    empty, binary = tmp_path / "empty.g2o", tmp_path / "binary.g2o"
    empty.write_text("# nothing\n")
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(GraphError, match="is this a pose graph"):
        read_g2o(empty)
    with pytest.raises(GraphError, match=r"could not read"):
        read_g2o(binary)
    with pytest.raises(GraphError, match=r"missing\.g2o.*could not read"):
        read_g2o(tmp_path / "missing.g2o")


def test_a_single_pose_has_a_graph() -> None:
    graph = chain_graph(np.eye(4)[None], [], [])
    assert graph.ids.tolist() == [0]
    assert graph.information.shape == (0, 6, 6)


PLANE = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
UNIT_PLANE = "1 0 0 1 0 1"


def plane_graph() -> Graph:
    rng = np.random.default_rng(RNG_SEED)
    poses = SE2().exp(rng.normal(size=(4, 3)))
    factors = rng.normal(size=(4, 3, 3))
    information = factors @ factors.swapaxes(1, 2) + np.eye(3)
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    motions = inverse(poses[ends[:, 0]]) @ poses[ends[:, 1]]
    return Graph(np.arange(4), poses, ends[:, 0], ends[:, 1], motions, information, fixed=2)


def test_a_graph_of_the_plane_comes_back_and_gtsam_finds_the_same_errors(tmp_path: Path) -> None:
    graph, path = plane_graph(), tmp_path / "a.g2o"
    write_g2o(path, graph)
    back = read_g2o(path)
    assert back.fixed == 2
    for name in ("poses", "motions", "information"):
        np.testing.assert_allclose(getattr(back, name), getattr(graph, name), rtol=1e-12, atol=1e-13)
    factors, values = gtsam.readG2o(str(path), False)
    moved = gtsam.Values()
    for key in range(4):
        moved.insert(key, values.atPose2(key).compose(gtsam.Pose2(0.1 * key, -0.2, 0.05 * key)))
    poses = planar_poses(gtsam.utilities.extractPose2(moved))
    ours = 0.5 * Edges(back.first, back.second, back.motions, back.information).chi2(poses).sum()
    assert factors.error(moved) == pytest.approx(ours, rel=1e-9)


def test_a_file_of_edges_alone_has_the_poses_of_its_edges(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(f"EDGE_SE2 7 9 1 0 0 {UNIT_PLANE}\nEDGE_SE2 9 8 1 0 0 {UNIT_PLANE}\n")
    graph = read_g2o(path)
    assert graph.ids.tolist() == [7, 8, 9]
    assert not graph.has_poses
    np.testing.assert_allclose(classify_edges(graph, "a").problem.start[:, 0, 2], [0, 2, 1])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"EDGE_SE3:QUAT 0 1 {IDENTITY} {UNIT_INFORMATION}", r"line 3.*plane and of space do not mix"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0", r"line 3: EDGE_SE2 has 10 numbers, expected 11"),
        ("EDGE_SE2 0 1 1 0 inf 1 0 0 1 0 1", r"line 3: EDGE_SE2 expected finite numbers"),
        ("EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1", r"line 3: the information of edge 0 1 has a negative eigenvalue"),
        (f"EDGE_SE2 0 5 1 0 0 {UNIT_PLANE}", r"line 3: expected poses with a VERTEX_SE2 line, found an edge to 5"),
    ],
)
def test_damage_in_the_plane_is_named_with_its_line(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "bad.g2o"
    path.write_text(PLANE + line + "\n")
    with pytest.raises(GraphError, match=message):
        read_g2o(path)


@pytest.mark.parametrize(
    ("line", "message", "left"),
    [
        (f"EDGE_SE2 1 1 0 0 0 {UNIT_PLANE}", r"line 3: an edge joins a pose to itself and is left out", 0),
        ("EDGE_SE2 0 1 1 0 0 0 0 0 0 0 0", r"line 3: an edge has zero information and is left out", 0),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 0", r"line 3: an edge has no information in some direction", 1),
        (f"EDGE_PRIOR_SE2 0 0 0 0 {UNIT_PLANE}", r"1 line EDGE_PRIOR_SE2 \(first in line 3\): priors are ignored", 0),
    ],
)
def test_what_can_be_repaired_is_with_a_warning(tmp_path: Path, line: str, message: str, left: int) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(PLANE + line + "\n")
    graph = read_g2o(path)
    assert len(graph.first) == left
    assert re.search(message, graph.warnings[0])
    assert (np.linalg.eigvalsh(graph.information) > 0).all()


def test_a_graph_in_two_pieces_is_named_with_the_pose_that_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(PLANE + f"VERTEX_SE2 4 0 0 0\nVERTEX_SE2 5 0 0 0\nEDGE_SE2 0 1 1 0 0 {UNIT_PLANE}\n")
    with pytest.raises(GraphError, match=r"a\.g2o: expected edges that join all 4 poses, found none .* pose 4 \(2"):
        classify_edges(read_g2o(path), str(path))


def test_where_odometry_is_missing_another_edge_is_trusted(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(PLANE + f"VERTEX_SE2 4 2 0 0\nEDGE_SE2 0 1 1 0 0 {UNIT_PLANE}\nEDGE_SE2 4 0 -2 0 0 {UNIT_PLANE}\n")
    found = classify_edges(read_g2o(path), "a")
    assert found.trusted.all()
    assert (
        "no odometry leads to some poses; 1 other edges are trusted instead, the first from 4 to 0" in found.warnings[0]
    )
    np.testing.assert_allclose(found.problem.start[:, 0, 2], [0, 1, 2])
