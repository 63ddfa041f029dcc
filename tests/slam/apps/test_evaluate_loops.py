"""Any table of matches can be evaluated, and the message about a wrong one names the line."""

import json
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from place_recognition.evaluation.revisit_ground_truth import RevisitRule
from slam.apps.evaluate import LoopsOptions, evaluate_loops
from slam.cli import app
from slam.errors import ConfigError, DataError, OutputError
from slam.io.matches import read_matches, write_matches
from slam.io.trajectory_files import write_kitti, write_tum

LAP = 40


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    np.savez(tmp_path / "loops.npz", truth=np.eye(2 * LAP, k=-LAP))
    return tmp_path / "loops.npz"


def table(folder: Path, *lines: str, header: str = "query,match,score") -> Path:
    path = folder / "matches.csv"
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def laps() -> np.ndarray:
    """Two laps of a circle of 200 m."""
    motion = se3.exp(np.array([0.0, 2 * np.pi / LAP, 0.0, 0.0, 0.0, 5.0]))
    return np.array([np.linalg.matrix_power(motion, k) for k in range(2 * LAP)])


def evaluated(matches: Path, truth: Path, **more: object) -> dict:
    return json.loads(evaluate_loops(LoopsOptions(matches, truth, **more), json=True))["rules"]  # type: ignore[arg-type]


def test_both_rules_are_applied(tmp_path: Path, truth: Path) -> None:
    matches = table(tmp_path, "50,10,9", "51,11,8", "52,19,7", "53,30,6", "54,14,5")
    rules = evaluated(matches, truth)
    assert rules["tolerance_0"]["recall_at_100_precision"] == pytest.approx(2 / LAP)
    assert rules["tolerance_10"]["recall_at_100_precision"] == pytest.approx(3 / LAP)
    assert (rules["tolerance_0"]["true_positives"], rules["tolerance_0"]["false_positives"]) == (3, 2)
    assert rules["tolerance_0"]["truth_rows"] == LAP


def test_a_tolerance_of_ones_own_comes_besides(tmp_path: Path, truth: Path) -> None:
    rules = evaluated(table(tmp_path, "53,30,6"), truth, frame_tolerance=17)
    assert rules["tolerance_17"]["recall_at_100_precision"] == pytest.approx(1 / LAP)
    assert rules["tolerance_10"]["recall_at_100_precision"] == 0


def test_the_text_names_the_rules_and_the_truth(tmp_path: Path, truth: Path) -> None:
    text = evaluate_loops(LoopsOptions(table(tmp_path, "50,10,9"), truth))
    assert "40 revisits by" in text
    assert text.index("Exact ground truth") < text.index("Tolerance of 10 images")
    assert "R@P100                   0.0250" in text


@pytest.mark.parametrize("suffix", ["txt", "tum"])
def test_poses_are_a_truth_too(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"poses.{suffix}"
    write_kitti(path, laps()) if suffix == "txt" else write_tum(path, np.arange(2.0 * LAP), laps())
    rules = evaluated(table(tmp_path, "50,10,9", "60,21,8"), path, rule=RevisitRule(max_distance_m=1.0))
    assert (rules["tolerance_0"]["truth_rows"], rules["tolerance_0"]["true_positives"]) == (LAP, 1)


def test_a_gap_needs_times_and_changes_the_truth(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses.txt", laps())
    matches, rule = table(tmp_path, "50,10,9"), RevisitRule(min_time_gap_s=41.0)
    with pytest.raises(ConfigError, match=r"poses\.txt: expected times for --min-time-gap 41, found none; give --fps"):
        evaluated(matches, tmp_path / "poses.txt", rule=rule)
    with pytest.raises(DataError, match="expected at least one revisit, found none"):
        evaluated(matches, tmp_path / "poses.txt", rule=RevisitRule(min_time_gap_s=500.0), fps=1.0)
    assert evaluated(matches, tmp_path / "poses.txt", rule=rule, fps=0.5)["tolerance_0"]["truth_rows"] > 30


def test_matches_written_are_read_back(tmp_path: Path, truth: Path) -> None:
    matches = table(
        tmp_path,
        "50,10,9.25,true,40,true",
        "51,,0.0,false,,true",
        "52,3,1e-3,false,4,false",
        header="query,match,score,accepted,inliers,verified",
    )
    beliefs = read_matches(matches)
    write_matches(tmp_path / "again.csv", beliefs)
    assert read_matches(tmp_path / "again.csv") == beliefs
    assert [b.verified for b in beliefs] == [True, True, False]


def test_files_are_written_on_request_only(tmp_path: Path, truth: Path) -> None:
    matches = table(tmp_path, "50,10,9")
    evaluate_loops(LoopsOptions(matches, truth, out=tmp_path / "out"))
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"metrics.json", "precision_recall.csv", "precision_recall.png"}
    with pytest.raises(OutputError, match="--overwrite"):
        evaluate_loops(LoopsOptions(matches, truth, out=tmp_path / "out"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["50,10,nan"], "line 2: expected a finite score, found 'nan'"),
        (["50,10,high"], "line 2: expected a finite score, found 'high'"),
        (["50,10,9", "50,11,8"], "line 3: expected one line for each query, found a second for 50"),
        (["50,50,9"], "line 2: expected a match earlier than query 50, found 50"),
        (["10,50,9"], "line 2: expected a match earlier than query 10, found 50"),
        (["-4,,0"], "line 2: expected query to be a whole number from 0, found '-4'"),
        (["5.5,1,0"], "line 2: expected query to be a whole number"),
        (["90,1,2"], r"matches\.csv: expected queries below 80, the images of .*loops\.npz, found 90"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, truth: Path, lines: list[str], message: str) -> None:
    with pytest.raises(DataError, match=message):
        evaluated(table(tmp_path, *lines), truth)


@pytest.mark.parametrize(("content", "found"), [("a,b\n1,2\n", "found a, b"), ("", "found an empty file")])
def test_other_columns_are_named(tmp_path: Path, truth: Path, content: str, found: str) -> None:
    (tmp_path / "x.csv").write_text(content)
    with pytest.raises(DataError, match=rf"x\.csv: expected the columns query, match, score, {found}"):
        evaluated(tmp_path / "x.csv", truth)


def test_a_table_in_utf_16_is_read(tmp_path: Path, truth: Path) -> None:
    (tmp_path / "a.csv").write_text("query,match,score\n50,10,9\n", encoding="utf-16")
    assert evaluated(tmp_path / "a.csv", truth)["tolerance_0"]["true_positives"] == 1


def test_a_missing_table_and_one_of_bytes_are_named(tmp_path: Path, truth: Path) -> None:
    (tmp_path / "b.csv").write_bytes(bytes(range(256)))
    with pytest.raises(DataError, match=r"b\.csv: expected a table of matches"):
        evaluated(tmp_path / "b.csv", truth)
    with pytest.raises(DataError, match=r"none\.csv: expected a table of matches, found none"):
        evaluated(tmp_path / "none.csv", truth)


def test_a_fault_is_one_line_on_the_command_line(
    tmp_path: Path, truth: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["evaluate", "loops", str(table(tmp_path, "50,10,nan")), str(truth)]
    assert app._exit_code(lambda: app.app(arguments)) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert app._exit_code(lambda: app.app([*arguments, "--max-distance", "-1"])) == 2


def whole_table(folder: Path, images: int) -> Path:
    """A line for each image; those of the second lap match those of the first."""
    lines = [f"{k},{k - LAP},9" if k >= LAP else f"{k},,0" for k in range(images)]
    return table(folder, *lines)


@pytest.mark.parametrize("count", [2 * LAP - 1, 3 * 2 * LAP, 2 * LAP + 1])
@pytest.mark.parametrize("suffix", ["txt", "tum", "npz"])
def test_a_truth_of_another_rate_is_refused(tmp_path: Path, count: int, suffix: str) -> None:
    poses, path = np.resize(laps(), (count, 4, 4)), tmp_path / f"truth.{suffix}"
    if suffix == "npz":
        np.savez(path, truth=np.eye(count, k=-LAP))
    else:
        write_kitti(path, poses) if suffix == "txt" else write_tum(path, np.arange(count) / 30, poses)
    with pytest.raises(DataError, match=rf"truth\.{suffix}: expected|expected queries below {count}"):
        evaluated(whole_table(tmp_path, 2 * LAP), path)


def test_a_truth_of_another_rate_is_matched_by_the_times_of_the_run(tmp_path: Path) -> None:
    run, motion = tmp_path / "run", se3.log(laps()[1])
    run.mkdir()
    times = np.arange(2 * LAP) / 10
    true_times = np.arange(3 * 2 * LAP + 5) / 30
    write_tum(run / "a.tum", times, laps())
    write_tum(tmp_path / "fast.tum", true_times, np.array([se3.exp(10 * t * motion) for t in true_times]))
    header = "frame,timestamp,status,reason,inliers,tracks,residual_px"
    lines = [f"{k},{time},measured,,100,100,0.5" for k, time in enumerate(times)]
    (run / "frames.csv").write_text("\n".join([header, *lines]) + "\n")
    matches, rule = whole_table(run, 2 * LAP), RevisitRule(max_distance_m=1.0)
    same, fast = (evaluated(matches, path, rule=rule) for path in (run / "a.tum", tmp_path / "fast.tum"))
    assert fast == same
    assert fast["tolerance_0"]["true_positives"] == LAP
    short = tmp_path / "short.tum"
    write_tum(short, true_times[:60], np.array([se3.exp(10 * t * motion) for t in true_times[:60]]))
    with pytest.raises(DataError, match=r"short\.tum: expected true poses at the times of all 80 images, found 20"):
        evaluated(matches, short, rule=rule)


def test_remarks_about_the_truth_are_on_the_screen_and_in_the_metrics(tmp_path: Path) -> None:
    stored = np.eye(2 * LAP, k=LAP)
    stored[70, 1] = 1
    np.savez(tmp_path / "upper.npz", truth=stored)
    options = LoopsOptions(whole_table(tmp_path, 2 * LAP), tmp_path / "upper.npz", out=tmp_path / "out")
    text = evaluate_loops(options)
    remark = "the upper triangle is used with 40 entries; passed over 1 entry below the diagonal"
    assert f"warning: {tmp_path / 'upper.npz'}: {remark}" in text
    assert "R@P100                   1.0000" in text
    assert remark in json.loads((tmp_path / "out" / "metrics.json").read_text())["warnings"][0]


def test_a_table_with_few_lines_says_how_it_is_read(tmp_path: Path, truth: Path) -> None:
    text = evaluate_loops(LoopsOptions(table(tmp_path, "50,10,9"), truth))
    assert "matches.csv: 1 lines for 80 images; image i is the one of row i of the truth, from 0" in text
