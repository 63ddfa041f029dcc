"""The whole chain with one camera: a drive without right images, from its images to its files."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from slam.config import read_config
from slam.errors import ConfigError, DataError
from slam.io.frames_and_loops_csv import read_loops
from slam.io.g2o import read_g2o
from slam.io.trajectory_files import read_kitti
from slam.pipeline.pipeline import RunOptions, run_pipeline

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def left_only(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive of two laps, its right images lost."""
    root = tmp_path_factory.mktemp("left") / "drive"
    shutil.copytree(circle_drive, root, ignore=shutil.ignore_patterns("image_1"))
    return root


@pytest.fixture(scope="module")
def run(left_only: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mono") / "run"
    run_pipeline(RunOptions(source=left_only, out=out), {"mono": True, "save_recording": False}, QUIET, QUIET)
    return out


@pytest.fixture(scope="module")
def metrics(run: Path) -> dict:
    return json.loads((run / "metrics.json").read_text())


def test_without_mono_the_remedy_is_named(left_only: Path, tmp_path: Path):
    with pytest.raises(DataError, match=r"expected left and right images, found left ones only.*--mono"):
        run_pipeline(RunOptions(source=left_only, out=tmp_path / "out"), {}, QUIET, QUIET)


def test_errors_are_those_after_alignment_with_scale(metrics: dict):
    assert {metrics[name]["ate_alignment"] for name in ("odometry", "online", "corrected")} == {"sim3"}
    assert metrics["odometry"]["ate_m"] < 0.01 * metrics["path_length_m"]


def test_loops_are_closed_and_correct_the_trajectory(metrics: dict):
    assert metrics["loops"]["false"] == 0
    assert metrics["loops"]["recall"] > 0.3
    assert metrics["corrected"]["ate_m"] < metrics["odometry"]["ate_m"]
    assert metrics["corrected"]["ate_m"] < 0.003 * metrics["path_length_m"]


def test_there_is_one_finite_pose_for_every_frame(run: Path, metrics: dict):
    for name in ("odometry", "online", "corrected"):
        poses = read_kitti(run / f"trajectory_{name}.txt")
        assert len(poses) == metrics["frames"]
        assert np.isfinite(poses).all()


def test_the_graph_after_agrees_with_the_corrected_trajectory(run: Path):
    graph = read_g2o(run / "pose_graph_after.g2o")
    poses = read_kitti(run / "trajectory_corrected.txt")
    np.testing.assert_allclose(graph.poses[:, :3, 3], poses[:, :3, 3], atol=1e-4)
    kept = [row for row in read_loops(run / "loops.csv") if row.in_graph]
    assert len(graph.first) == len(poses) - 1 + len(kept)


def test_every_loop_has_a_reason_and_there_is_a_map(run: Path):
    assert all(row.reason for row in read_loops(run / "loops.csv"))
    for name in ("map_before.ply", "map_after.ply", "report.html", "before_after.png"):
        assert (run / name).stat().st_size > 1000


def test_the_written_settings_have_mono(run: Path):
    assert read_config(run / "config.toml").mono


def test_a_height_without_mono_is_refused(left_only: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match=r"--camera-height.*add --mono"):
        run_pipeline(RunOptions(source=left_only, out=tmp_path / "out"), {"camera_height": 1.65}, QUIET, QUIET)
