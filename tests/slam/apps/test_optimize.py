"""`revisit optimize`: the files it writes, the truth it knows, the faults it names."""

import csv
from pathlib import Path

import numpy as np
import pytest

from slam.cli import app
from slam.io.g2o import read_g2o
from slam.io.g2o_problem import classify_edges
from slam.io.metrics import read_metrics

INFORMATION = "400 0 0 400 0 40000"
SIDE = 10


def square(path: Path, false: bool = True) -> Path:
    """Write two laps of a square with drifting odometry, true loops and, at the end, a false one."""
    lines, turn, rng = [], np.pi / 2, np.random.default_rng(0)
    for k in range(2 * 4 * SIDE - 1):
        along, across, angle = rng.normal([1.0, 0.0, 0.002], [0.03, 0.03, 0.004])
        angle += turn if k % SIDE == SIDE - 1 else 0.0
        lines.append(f"EDGE_SE2 {k} {k + 1} {along} {across} {angle} {INFORMATION}")
    lines += [f"EDGE_SE2 {k} {k + 4 * SIDE} 0.0 0.0 0.0 {INFORMATION}" for k in range(0, 4 * SIDE - 2, 3)]
    lines += [f"EDGE_SE2 3 {2 * SIDE + 2} 0.1 0.0 0.0 {INFORMATION}"] if false else []
    path.write_text("\n".join(lines) + "\n")
    path.with_name(path.stem + "_GT_LC.txt").write_text(
        "".join(f"{k + 4 * SIDE} {k}\n" for k in range(0, 4 * SIDE - 2, 3))
    )
    return path


def truth(path: Path) -> Path:
    """Write the square's true poses in KITTI's axes: x of the plane is z, y is -x."""
    x, y, heading, rows = 0.0, 0.0, 0.0, []
    for k in range(2 * 4 * SIDE):
        rows.append(f"1 0 0 {-y} 0 1 0 0 0 0 1 {x}")
        x, y = x + np.cos(heading), y + np.sin(heading)
        heading += np.pi / 2 if k % SIDE == SIDE - 1 else 0.0
    path.write_text("\n".join(rows) + "\n")
    return path


def run(*arguments: object) -> int:
    return app._exit_code(lambda: app.app(["optimize", *map(str, arguments)]))


def test_every_file_is_written_and_the_false_loop_left_out(tmp_path: Path) -> None:
    graph, out = square(tmp_path / "drive_07.g2o"), tmp_path / "out"
    (tmp_path / "poses").mkdir()
    truth(tmp_path / "poses" / "07.txt")
    assert run(graph, "--out", out, "--ground-truth", tmp_path / "poses") == 0
    assert {path.name for path in out.iterdir()} == {"metrics.json", "optimized.g2o", "edges.csv", "before_after.png"}
    section = read_metrics(out / "metrics.json")["graph"]
    assert isinstance(section, dict)
    assert (section["false_kept"], section["true_kept"], section["loop_edges"]) == (0, 13, 14)
    assert section["ate_m"] < 0.5 * section["ate_initial_m"]
    rows = list(csv.DictReader((out / "edges.csv").open()))
    assert len(rows) == 2 * 4 * SIDE - 1 + 14
    assert (rows[0]["role"], rows[0]["kept"]) == ("odometry", "true")
    assert (rows[-1]["role"], rows[-1]["kept"], rows[-1]["truth"]) == ("loop", "false", "false")
    assert rows[-1]["reason"].startswith("left out")
    assert len(read_g2o(out / "optimized.g2o").first) == len(rows) - 1


def test_without_truth_the_gaps_in_the_metrics_have_reasons(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o")
    graph.with_name("a_GT_LC.txt").unlink()
    assert run(graph, "--out", tmp_path / "out") == 0
    metrics = read_metrics(tmp_path / "out" / "metrics.json")
    assert metrics["graph"]["ate_m"] is None  # type: ignore[index]
    assert metrics["notes"]["graph.ate_m"] == "no ground truth was given"  # type: ignore[index]
    assert "no list of true loops" in metrics["notes"]["graph.true_kept"]  # type: ignore[index]


def test_several_graphs_get_a_folder_each(tmp_path: Path) -> None:
    graphs = [square(tmp_path / "a.g2o"), square(tmp_path / "b.g2o", false=False)]
    assert run(*graphs, "--out", tmp_path / "out", "--robust", "dcs") == 0
    assert (tmp_path / "out" / "a" / "metrics.json").is_file()
    assert (tmp_path / "out" / "b" / "optimized.g2o").is_file()


def test_the_same_graph_gives_the_same_bytes(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o")
    for name in ("one", "two"):
        assert run(graph, "--out", tmp_path / name) == 0
    for file in ("optimized.g2o", "edges.csv", "before_after.png"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--robust", "hope"], 2, "unknown robust back end 'hope': expected one of none"),
        (["--ground-truth", "short.txt"], 1, "short.txt: expected a pose for each id from 0 to 79"),
        (["--ground-truth", "nothing"], 1, "nothing: expected one file of poses named as a word of a, found none"),
    ],
)
def test_faults_are_one_line_and_leave_nothing_behind(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    square(Path("a.g2o"))
    Path("short.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    Path("nothing").mkdir()
    assert run("a.g2o", "--out", "out", *arguments) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    assert not Path("out").exists()


def test_an_empty_list_of_true_loops_makes_every_kept_loop_false(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o", false=False)
    graph.with_name("a_GT_LC.txt").write_text("")
    assert run(graph, "--out", tmp_path / "out") == 0
    section = read_metrics(tmp_path / "out" / "metrics.json")["graph"]
    assert isinstance(section, dict)
    assert (section["true"], section["true_kept"], section["false_kept"]) == (0, 0, section["loops_kept"])
    assert section["loops_kept"] == 13


def test_listed_pairs_that_are_no_loops_are_counted(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o")
    labels = graph.with_name("a_GT_LC.txt")
    labels.write_text(labels.read_text() + "70 2\n900 901\n")
    assert run(graph, "--out", tmp_path / "out") == 0
    warnings = read_metrics(tmp_path / "out" / "metrics.json")["warnings"]
    assert isinstance(warnings, list)
    assert any("passed over 2 pairs that are no loops of the graph, such as 2 70" in warning for warning in warnings)


def test_what_is_passed_over_is_on_the_screen_and_in_the_metrics(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    graph = square(tmp_path / "a.g2o")
    graph.write_text(graph.read_text() + "VERTEX_XY 999 0 0\nEDGE_SE2_XY 0 999 1 1 1 0 1\n")
    assert run(graph, "--out", tmp_path / "out") == 0
    sentence = "passed over 1 line EDGE_SE2_XY (first in line 95): landmarks are not supported"
    assert f"warning: {graph}: {sentence}" in capsys.readouterr().err
    assert f"{graph}: {sentence}" in read_metrics(tmp_path / "out" / "metrics.json")["warnings"]  # type: ignore[operator]


def test_loops_of_vertigo_give_the_result_of_plain_edges(tmp_path: Path) -> None:
    plain, vertigo = square(tmp_path / "plain.g2o"), square(tmp_path / "vertigo.g2o")
    lines = plain.read_text().splitlines()
    loops = [line.split() for line in lines[2 * 4 * SIDE - 1 :]]
    switchable = [" ".join(["EDGE_SE2_SWITCHABLE", *w[1:3], str(1000 + k), *w[3:]]) for k, w in enumerate(loops)]
    vertigo.write_text("\n".join(lines[: 2 * 4 * SIDE - 1] + switchable) + "\n")
    for graph in (plain, vertigo):
        assert run(graph, "--out", tmp_path / graph.stem) == 0
    assert (tmp_path / "plain" / "optimized.g2o").read_bytes() == (tmp_path / "vertigo" / "optimized.g2o").read_bytes()


def test_a_fixed_pose_keeps_its_place_and_the_file_its_fix_lines(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o")
    poses = read_g2o(graph).ids
    vertices = "".join(f"VERTEX_SE2 {key} {0.5 * key} {-0.25 * key} 0.125\n" for key in poses)
    graph.write_text(vertices + graph.read_text() + "FIX 5 30\n")
    assert run(graph, "--out", tmp_path / "out") == 0
    written = read_g2o(tmp_path / "out" / "optimized.g2o")
    assert (written.fixed, written.also_fixed) == (5, (30,))
    np.testing.assert_allclose(written.poses[5], read_g2o(graph).poses[5], atol=1e-12)


def test_two_robots_keep_their_true_loops_though_a_false_one_joins_neighbours(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o", false=False)
    first, second, half = ord("a") << 56, ord("b") << 56, 4 * SIDE
    renamed = []
    for words in map(str.split, graph.read_text().splitlines()):
        ids = [int(word) for word in words[1:3]]
        if ids != [half - 1, half]:
            names = [str(first + key if key < half else second + key - half) for key in ids]
            renamed.append(" ".join([words[0], *names, *words[3:]]))
    false = f"EDGE_SE2 {first + half - 1} {second} 8 3 2 {INFORMATION}"
    graph.write_text("\n".join([false, *renamed]) + "\n")
    graph.with_name("a_GT_LC.txt").unlink()
    assert run(graph, "--out", tmp_path / "out") == 0
    rows = list(csv.DictReader((tmp_path / "out" / "edges.csv").open()))
    assert (rows[0]["role"], rows[0]["kept"]) == ("loop", "false")
    assert [row["kept"] for row in rows if row["role"] == "loop"][1:] == ["true"] * 12
    assert [row["reason"] for row in rows].count("trusted, as no odometry joins its poses") == 1


def test_a_truth_with_lines_without_a_pose_is_refused_as_lines_stand_for_ids(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [f"{k} {k} 0 0 0 0 0 1" for k in range(2 * 4 * SIDE + 1)]
    lines[3] = "3 nan nan nan nan nan nan nan"
    (tmp_path / "truth.tum").write_text("\n".join(lines) + "\n")
    graph = square(tmp_path / "a.g2o")
    assert run(graph, "--out", tmp_path / "out", "--ground-truth", tmp_path / "truth.tum") == 1
    error = capsys.readouterr().err
    assert "passed over 1 line without a pose" in error
    assert "(first in line 4); expected a pose in each line, as line i is the pose of id i" in error


def ate_against(tmp_path: Path, rows: list[str]) -> tuple[float, list[str]]:
    """Optimise the square against a truth in TUM's form (x y z of each pose); return the ATE and the warnings."""
    file = tmp_path / "truth.tum"
    file.write_text("".join(f"{0.1 * k} {row} 0 0 0 1\n" for k, row in enumerate(rows)))
    out = tmp_path / f"out_{len(list(tmp_path.glob('out_*')))}"
    assert run(square(tmp_path / "a.g2o"), "--out", out, "--ground-truth", file) == 0
    metrics = read_metrics(out / "metrics.json")
    return metrics["graph"]["ate_m"], metrics["warnings"]  # type: ignore[index, return-value]


def test_a_planar_truth_is_taken_in_the_plane_in_which_it_moves(tmp_path: Path) -> None:
    poses = np.loadtxt(truth(tmp_path / "kitti.txt")).reshape(-1, 3, 4)[:, :, 3]
    x, y = poses[:, 2], -poses[:, 0]
    kitti, silent = ate_against(tmp_path, [f"{-b} 0 {a}" for a, b in zip(x, y, strict=True)])
    assert kitti < 0.2
    assert not any("plane" in warning for warning in silent)
    for row, plane in (("{0} {1} 0", "(x, y)"), ("{0} {1} 0.1", "(x, y)"), ("0 {0} {1}", "(y, z)")):
        found, warnings = ate_against(tmp_path, [row.format(a, b) for a, b in zip(x, y, strict=True)])
        assert found == pytest.approx(kitti)
        assert any(f"taken as {plane}, not KITTI's (z, -x)" in warning for warning in warnings)
    up = np.arange(len(x)) % 9
    _, warnings = ate_against(tmp_path, [f"{-b} {3 * c} {a}" for a, b, c in zip(x, y, up, strict=True)])
    assert any("no clear plane; KITTI's (z, -x) is taken" in warning for warning in warnings)


def test_negative_ids_are_of_the_robot_of_0(tmp_path: Path) -> None:
    graph = square(tmp_path / "a.g2o")
    lines = [line.split() for line in graph.read_text().splitlines()]
    shifted = [" ".join([line[0], str(int(line[1]) - 5), str(int(line[2]) - 5), *line[3:]]) for line in lines]
    (tmp_path / "b.g2o").write_text("\n".join(shifted) + "\n")
    for name in ("a", "b"):
        edges = classify_edges(read_g2o(tmp_path / f"{name}.g2o"), name)
        assert (int(edges.trusted.sum()), int(edges.connecting.sum()), edges.warnings) == (79, 0, ())
