"""Drives that meet end in one frame, and drives that do not stay apart."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from odometry import se3
from slam.errors import ConfigError, DataError
from slam.evaluation.trajectory_errors import path_length, trajectory_errors
from slam.io.trajectory_files import read_kitti
from slam.loop_closing.loop_closer import LoopClosure
from slam.map_database.database import MapDatabase
from slam.map_database.session_merging import align_sessions
from slam.pipeline.pipeline import RunOptions, run_pipeline

QUIET = Console(quiet=True)
LAP = 80  # frames of one lap, of which every second is taken


def part_of(circle_drive: Path, root: Path, begin: int, end: int, mirrored: bool = False) -> Path:
    """Every second frame of a part of the drive; mirrored it is another town."""
    source, target = circle_drive / "sequences" / "00", root / "sequences" / "00"
    for camera, other in (("image_0", "image_1"), ("image_1", "image_0")):
        (target / camera).mkdir(parents=True)
        for new, old in enumerate(range(begin, end, 2)):
            path = target / camera / f"{new:06d}.png"
            if mirrored:
                cv2.imwrite(
                    str(path), cv2.imread(str(source / other / f"{old:06d}.png"), cv2.IMREAD_GRAYSCALE)[:, ::-1]
                )
            else:
                path.symlink_to(source / camera / f"{old:06d}.png")
    shutil.copy(source / "calib.txt", target)
    (target / "times.txt").write_text("".join(f"{0.2 * k:e}\n" for k in range(len(range(begin, end, 2)))))
    return root


def run(source: Path, out: Path, known: Path | None = None, **settings: object) -> dict:
    options = RunOptions(source=source, out=out, map_file=known)
    run_pipeline(options, {"save_recording": False} | settings, QUIET, QUIET)
    return json.loads((out / "metrics.json").read_text())


@pytest.fixture(scope="module")
def first(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("first")
    run(part_of(circle_drive, root / "drive", 0, 160), root / "run")
    return root / "run"


def test_a_second_lap_ends_in_the_frame_of_the_first(circle_drive: Path, first: Path, tmp_path: Path):
    before = (first / "map.db").read_bytes()
    metrics = run(part_of(circle_drive, tmp_path / "drive", 170, 320), tmp_path / "run", first)
    assert metrics["map"]["joined"]
    assert metrics["map"]["sessions"] == [0]
    assert metrics["map"]["kept"] > 20
    truth = read_kitti(circle_drive / "poses" / "00.txt")
    truth = np.concatenate([truth[0:160:2], truth[170:320:2]])
    with MapDatabase.open(tmp_path / "run" / "map.db") as store:
        poses, sessions = store.poses(), store.sessions()
    assert [session.map_id for session in sessions] == [0, 0]
    assert all(session.finished for session in sessions)
    assert trajectory_errors(poses, truth, "se3").ate_m < 0.005 * path_length(truth)
    in_map = read_kitti(tmp_path / "run" / "trajectory_map.txt")
    np.testing.assert_allclose(in_map, poses[80:], atol=1e-6)
    own = read_kitti(tmp_path / "run" / "trajectory_corrected.txt")
    np.testing.assert_allclose(np.array(metrics["map"]["T_map_session"]) @ own, in_map, atol=1e-6)
    assert (first / "map.db").read_bytes() == before


def test_sessions_without_common_places_are_not_merged(circle_drive: Path, first: Path, tmp_path: Path):
    source = part_of(circle_drive, tmp_path / "drive", 0, 120, mirrored=True)
    metrics = run(source, tmp_path / "run", first)
    alone = run(source, tmp_path / "alone")
    assert not metrics["map"]["joined"]
    assert metrics["map"]["kept"] == 0
    assert not (tmp_path / "run" / "trajectory_map.txt").exists()
    with MapDatabase.open(tmp_path / "run" / "map.db") as store, MapDatabase.open(first / "map.db") as known:
        assert [session.map_id for session in store.sessions()] == [0, 1]
        np.testing.assert_array_equal(store.poses()[:80], known.poses())
    assert metrics["odometry"] == alone["odometry"]
    name = "trajectory_odometry.txt"
    assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_a_session_needs_the_recogniser_and_the_camera_of_its_map(circle_drive: Path, first: Path, tmp_path: Path):
    source = part_of(circle_drive, tmp_path / "drive", 0, 20)
    with pytest.raises(ConfigError, match="expected the recogniser that made"):
        run(source, tmp_path / "out", first, paradigm="global-descriptor")
    calibration = source / "sequences" / "00" / "calib.txt"
    calibration.write_text(calibration.read_text().replace("P1: 3", "P1: 4", 1).replace("P0: 3", "P0: 4", 1))
    with pytest.raises(DataError):
        run(source, tmp_path / "out", first)
    with pytest.raises(DataError, match="expected a map database, found none"):
        run(source, tmp_path / "out", tmp_path / "nothing.db")


def loops(
    T_world_session: np.ndarray, known: np.ndarray, own: np.ndarray, pairs: list[tuple[int, int]]
) -> list[LoopClosure]:
    return [
        LoopClosure(query, match, se3.inverse(known[match]) @ T_world_session @ own[query], 1e-4 * np.eye(6), 50)
        for query, match in pairs
    ]


def test_sessions_are_aligned_by_the_majority_of_loops():
    known = np.array([se3.exp(np.array([0, 0.02 * k, 0, 0, 0, 1.0 * k])) for k in range(60)])
    own = np.array([se3.exp(np.array([0, -0.01 * k, 0, 0, 0, 0.8 * k])) for k in range(60)])
    true = se3.exp(np.array([0.1, 1.2, -0.1, 30.0, 2.0, -15.0]))
    false = se3.exp(np.array([0.0, -0.6, 0.1, -80.0, 0.0, 40.0]))
    right = loops(true, known, own, [(k, 59 - k) for k in range(10, 40)])
    wrong = loops(false, known, own, [(k, k) for k in range(40, 55)])
    np.testing.assert_allclose(align_sessions(known, own, wrong[:10] + right + wrong[10:]), true, atol=1e-9)
    scattered = [
        loops(se3.exp(np.array([0, 0, 0, 30.0 * k, 0, 0])), known, own, [(k, 5)])[0] for k in range(20)
    ]  # each says something else
    assert align_sessions(known, own, scattered) is None
    assert align_sessions(known, own, right[:4]) is None
    assert align_sessions(known, own, loops(true, known, own, [(10, k) for k in range(10)])) is None  # one image alone
