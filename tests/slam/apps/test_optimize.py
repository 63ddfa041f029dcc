"""`revisit optimize`: the files it writes, the truth it knows, the faults it names."""

import csv
from pathlib import Path

import numpy as np
import pytest

from slam.cli import app
from slam.io.g2o import read_g2o
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
