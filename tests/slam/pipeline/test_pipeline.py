"""One recorded drive from its images to its results, on real images."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from evo.tools import file_interface
from markupsafe import escape
from rich.console import Console

from slam.errors import DataError, OutputError
from slam.io.metrics import read_metrics
from slam.io.trajectory_files import read_tum
from slam.pipeline.pipeline import RunOptions, run_pipeline

QUIET = Console(quiet=True)
HOSTILE = 'o\'drive <i id=x> "[bold]" &amp; улица 街道'

FILES = {
    "metrics.json",
    "config.toml",
    "frames.csv",
    "loops.csv",
    "matches.csv",
    "map.db",
    "loop_stages.csv",
    "loop_events.csv",
    "covariances.npz",
    "calibration.toml",
    "pose_graph_before.g2o",
    "pose_graph_after.g2o",
    "map_before.ply",
    "map_after.ply",
    "landmarks.npz",
    "before_after.png",
    "recording.rrd",
    "report.html",
    "run.log",
} | {f"trajectory_{name}.{ending}" for name in ("odometry", "online", "corrected") for ending in ("txt", "tum")}


def run(source: Path, out: Path, sequence: str | None = None, **settings: object) -> dict:
    run_pipeline(RunOptions(source=source, sequence=sequence, out=out), settings, QUIET, QUIET)
    return json.loads((out / "metrics.json").read_text())


def library_walk(test_data: Path, root: Path) -> Path:
    """Every second pair of a hand-held walk round book shelves, which ends where it began (KITTI layout)."""
    source, target = test_data / "real_revisits" / "library_stereo" / "sequences" / "00", root / "sequences" / "00"
    count = len(list((source / "image_0").glob("*.png"))) // 2
    for camera in ("image_0", "image_1"):
        (target / camera).mkdir(parents=True)
        for k in range(count):
            (target / camera / f"{k:06d}.png").symlink_to(source / camera / f"{2 * k:06d}.png")
    (target / "calib.txt").write_bytes((source / "calib.txt").read_bytes())
    (target / "times.txt").write_text("".join(f"{0.2 * i:e}\n" for i in range(count)))
    return root


def errors_of_measured_loops_m(test_data: Path, out: Path, name: str) -> np.ndarray:
    """Difference, metres, between each measured step from an early to a late frame and that of a trajectory."""
    poses = np.loadtxt(out / f"trajectory_{name}.txt").reshape(-1, 3, 4)
    errors = []
    rows = np.loadtxt(test_data / "real_revisits" / "library_stereo" / "loops_measured.csv", delimiter=",", skiprows=2)
    for a, b, _, *step, _ in rows:
        if a % 2 == 0 and b % 2 == 0:
            first, last = poses[int(a) // 2], poses[int(b) // 2]
            errors.append(np.linalg.norm(first[:, :3].T @ (last[:, 3] - first[:, 3]) - step))
    return np.array(errors)


@pytest.fixture(scope="module")
def clip05(test_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "05"
    run(test_data / "kitti_clips", out, "05")
    return out


def test_a_run_writes_every_file(clip05: Path):
    assert {path.name for path in clip05.iterdir()} == FILES


def test_a_real_clip_drifts_less_than_two_percent(clip05: Path):
    metrics = json.loads((clip05 / "metrics.json").read_text())
    assert metrics["odometry"]["end_error_percent"] < 2.0
    assert metrics["corrected"]["end_error_percent"] < 2.0


def test_another_real_clip_drifts_less_than_two_percent(test_data: Path, tmp_path: Path):
    metrics = run(test_data / "kitti_clips", tmp_path / "06", "06", save_recording=False)
    assert metrics["odometry"]["end_error_percent"] < 2.0


@pytest.mark.parametrize("name", ["odometry", "online", "corrected"])
def test_evo_reads_every_trajectory(clip05: Path, name: str):
    kitti = file_interface.read_kitti_poses_file(clip05 / f"trajectory_{name}.txt")
    tum = file_interface.read_tum_trajectory_file(clip05 / f"trajectory_{name}.tum")
    assert kitti.check()[0]
    assert tum.check()[0]
    np.testing.assert_allclose(tum.positions_xyz, kitti.positions_xyz, atol=1e-9)


def test_there_is_one_pose_for_every_frame(clip05: Path):
    metrics = json.loads((clip05 / "metrics.json").read_text())
    assert metrics["frames"] == 60
    assert len((clip05 / "trajectory_corrected.txt").read_text().splitlines()) == 60
    assert len((clip05 / "frames.csv").read_text().splitlines()) == 61


def test_a_real_walk_closes_loops_and_ends_where_it_did(test_data: Path, tmp_path: Path):
    metrics = run(library_walk(test_data, tmp_path / "drive"), tmp_path / "out", save_recording=False)
    assert metrics["loops"]["kept"] >= 5
    assert errors_of_measured_loops_m(test_data, tmp_path / "out", "odometry").max() > 0.05
    assert errors_of_measured_loops_m(test_data, tmp_path / "out", "corrected").max() < 0.04


def test_a_paradigm_that_answers_late_closes_loops_all_the_same(test_data: Path, tmp_path: Path):
    source = library_walk(test_data, tmp_path / HOSTILE)
    metrics = run(source, tmp_path / "out", paradigm="sequence-histograms")  # recorded: the viewer must bear it too
    assert metrics["places"]["queries"] == metrics["frames"]
    assert metrics["places"]["words"] > 0
    assert metrics["loops"]["kept"] >= 5
    assert errors_of_measured_loops_m(test_data, tmp_path / "out", "corrected").max() < 0.04
    queries = [int(line.split(",")[0]) for line in (tmp_path / "out" / "loops.csv").read_text().splitlines()[1:]]
    assert queries == sorted(set(queries))
    # whatever the folder is called, it is text in the report
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"<h1>{escape(HOSTILE)} 00</h1>" in report
    assert "<i id" not in report
    assert metrics["source"] == str(source)
    assert metrics["memory_mb"]["place recognition"] == metrics["places"]["map_bytes"] / 1e6
    assert all(0 < held < metrics["peak_memory_mb"] for held in metrics["memory_mb"].values() if held is not None)
    # and each loop that was proposed has its images, with where they agree
    details = json.loads(re.search(r'id="loop-details">(.*?)</script>', report)[1])
    kept = [row for row in details["rows"] if row["outcome"] == "kept"]
    assert len(kept) == metrics["loops"]["kept"]
    assert all({str(row["query"]), str(row["match"])} <= set(details["pictures"]) for row in details["rows"])
    assert all(len(row["lines"]) >= 4 * 20 for row in kept)
    assert max(max(row["lines"]) for row in kept) < details["width"]


def test_an_invalid_vocabulary_is_refused_before_anything_is_written(test_data: Path, tmp_path: Path):
    (tmp_path / "x.vocabulary").write_bytes(b"no words")
    settings = {
        "paradigm": "sequence-histograms",
        "vocabulary": str(tmp_path / "x.vocabulary"),
        "save_recording": False,
    }
    with pytest.raises(DataError, match=r"x\.vocabulary"):
        run(test_data / "kitti_clips", tmp_path / "out", "06", **settings)
    assert not (tmp_path / "out").exists()


def test_the_same_dataset_gives_the_same_bits_with_any_number_of_threads(test_data: Path, tmp_path: Path):
    source = library_walk(test_data, tmp_path / "drive")
    threads = cv2.getNumThreads()
    for count in (1, 2):
        cv2.setNumThreads(count)
        run(source, tmp_path / f"out{count}", save_recording=False)
    cv2.setNumThreads(threads)
    for name in sorted(FILES - {"metrics.json", "frames.csv", "recording.rrd", "report.html", "run.log", "map.db"}):
        assert (tmp_path / "out1" / name).read_bytes() == (tmp_path / "out2" / name).read_bytes(), name


def test_an_earlier_run_is_overwritten_only_on_request(clip05: Path, test_data: Path):
    before = (clip05 / "metrics.json").read_bytes()
    with pytest.raises(OutputError, match="--overwrite"):
        run(test_data / "kitti_clips", clip05, "05")
    assert (clip05 / "metrics.json").read_bytes() == before


def test_the_error_for_a_dataset_with_one_camera_names_it(test_data: Path, tmp_path: Path):
    with pytest.raises(DataError, match=r"kitti_clips.*left"):
        run(test_data / "kitti_clips", tmp_path / "out", "07")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("save_map", [True, False])
def test_a_damaged_image_midway_costs_no_frame_before_it(clip05: Path, test_data: Path, tmp_path: Path, save_map: bool):
    source = library_walk(test_data, tmp_path / "drive")
    damaged = source / "sequences" / "00" / "image_1" / "000007.png"
    damaged.unlink()
    damaged.write_bytes(b"not a picture")
    options = RunOptions(source=source, sequence="00", out=tmp_path / "out")
    with pytest.raises(DataError, match=r"000007\.png: .*; the results of the 7 frames before it are in .*out"):
        run_pipeline(options, {"save_recording": False, "save_map": save_map}, QUIET, QUIET)
    _, poses = read_tum(tmp_path / "out" / "trajectory_corrected.tum")
    assert len(poses) == 7
    assert read_metrics(tmp_path / "out" / "metrics.json")["interrupted"]
    assert (tmp_path / "out" / "report.html").exists()


def test_a_damaged_image_midway_leaves_an_earlier_run_untouched(clip05: Path, test_data: Path, tmp_path: Path):
    source = library_walk(test_data, tmp_path / "drive")
    damaged = source / "sequences" / "00" / "image_1" / "000007.png"
    damaged.unlink()
    damaged.write_bytes(b"not a picture")
    before = {path.name: path.read_bytes() for path in clip05.iterdir()}
    with pytest.raises(DataError, match=r"000007\.png"):
        run_pipeline(
            RunOptions(source=source, sequence="00", out=clip05, overwrite=True),
            {"save_recording": False},
            QUIET,
            QUIET,
        )
    assert {path.name: path.read_bytes() for path in clip05.iterdir()} == before
