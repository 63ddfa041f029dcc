"""The chain with the odometry and the loops of other programs."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.datasets.formats.registry import open_dataset
from slam.errors import ConfigError, DataError
from slam.io.frames_and_loops_csv import read_loops
from slam.io.matches import read_matches
from slam.io.trajectory_files import read_tum, write_tum
from slam.pipeline.pipeline import RunOptions, run_pipeline

QUIET = Console(quiet=True)


def run(source: Path, out: Path, **settings: object) -> dict:
    settings = {"save_recording": False, "save_map": False} | settings
    run_pipeline(RunOptions(source=source, out=out), settings, QUIET, QUIET)
    return json.loads((out / "metrics.json").read_text())


def corrected(run_folder: Path) -> np.ndarray:
    return read_tum(run_folder / "trajectory_corrected.tum")[1]


def test_its_own_odometry_and_matches_from_files_give_the_same_trajectory(
    circle_drive: Path, circle_run: Path, tmp_path: Path
):
    odometry, matches = circle_run / "trajectory_odometry.tum", circle_run / "matches.csv"
    metrics = run(circle_drive, tmp_path / "out", odometry_file=str(odometry), paradigm=f"file:{matches}")
    np.testing.assert_allclose(corrected(tmp_path / "out"), corrected(circle_run), rtol=0, atol=1e-6)
    known = json.loads((circle_run / "metrics.json").read_text())
    assert metrics["loops"]["kept"] == known["loops"]["kept"] > 50
    for name in ("recall_at_100_precision", "average_precision"):
        assert metrics["places"][name] == pytest.approx(known["places"][name])


def test_seventy_per_cent_of_false_matches_do_not_worsen_the_odometry(
    circle_drive: Path, circle_run: Path, tmp_path: Path
):
    rng = np.random.default_rng(5)
    true = [belief for belief in read_matches(circle_run / "matches.csv") if belief.accepted][::2]
    answered, lines = {belief.query for belief in true}, ["query,match,score"]
    lines += [f"{belief.query},{belief.match},0.5" for belief in true]
    free = [query for query in range(60, len(corrected(circle_run))) if query not in answered]
    # Queries with a true match get a surer false one beside it: the geometry tells them apart.
    lines += [f"{belief.query},{belief.match // 2},0.9" for belief in true[::3] if belief.match > 100]
    for query in rng.choice(free, min(len(free), round(len(true) * 0.7 / 0.3)), replace=False):
        lines.append(f"{query},{rng.integers(0, query - 50)},{rng.random():.3f}")
    path = tmp_path / "matches.csv"
    path.write_text("\n".join(lines) + "\n")
    metrics = run(circle_drive, tmp_path / "out", paradigm=f"file:{path}")
    assert metrics["loops"]["kept"] > 20
    rows = read_loops(tmp_path / "out" / "loops.csv")
    assert len({row.query for row in rows}) < len(rows)  # some queries have two proposals
    assert metrics["corrected"]["ate_m"] < metrics["odometry"]["ate_m"]
    assert metrics["places"]["recall_at_100_precision"] < 0.5  # of the file, which is mostly wrong


def test_another_odometry_is_bridged_and_corrected_by_trusted_poses(
    circle_drive: Path, circle_run: Path, tmp_path: Path
):
    drive, rng = open_dataset(circle_drive), np.random.default_rng(3)
    truth, poses = drive.ground_truth, [np.eye(4)]
    for before, after in pairwise(truth):
        error = np.r_[0.0, 5e-4, 0.0, 0.0, 0.0, 5e-3] + np.repeat([2e-4, 5e-3], 3) * rng.normal(size=6)
        poses.append(poses[-1] @ se3.inverse(before) @ after @ se3.exp(error))
    kept = np.setdiff1d(np.arange(len(truth)), range(100, 110))
    write_tum(tmp_path / "other.tum", drive.timestamps[kept], np.array(poses)[kept])
    lines = ["query,match,score,x,y,z,qx,qy,qz,qw"]
    for belief in read_matches(circle_run / "matches.csv"):
        if belief.accepted:
            T = se3.inverse(truth[belief.match]) @ truth[belief.query]
            numbers = (*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat())
            lines.append(f"{belief.query},{belief.match},1,{','.join(map(str, numbers))}")
    (tmp_path / "loops.csv").write_text("\n".join(lines) + "\n")
    metrics = run(
        circle_drive,
        tmp_path / "out",
        odometry_file=str(tmp_path / "other.tum"),
        paradigm=f"file:{tmp_path / 'loops.csv'}",
        trust_poses=True,
    )
    assert metrics["motions"]["predicted"] == 10
    assert metrics["loops"]["kept"] > 50
    assert metrics["loops"]["false"] == 0
    assert metrics["corrected"]["ate_m"] < 0.5 * metrics["odometry"]["ate_m"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"odometry_file": "{tmp}/none.txt"}, r"none\.txt: expected this file, found none"),
        ({"paradigm": "file:{tmp}/none.csv"}, r"none\.csv: expected a table of matches, found none"),
        ({"trust_poses": True}, "--trust-poses: takes the poses of a file of matches; add --matches FILE"),
        ({"odometry_covariance": "0.1,0.1"}, "--odometry-covariance: .* add --odometry FILE"),
        ({"paradigm": "file:{tmp}/none.csv", "preset": "published"}, "--preset published: a file of matches has no"),
    ],
)
def test_a_setting_that_cannot_work_is_one_line_and_writes_nothing(
    circle_drive: Path, tmp_path: Path, settings: dict, message: str
):
    given = {k: v.format(tmp=tmp_path) if isinstance(v, str) else v for k, v in settings.items()}
    with pytest.raises((ConfigError, DataError), match=message):
        run(circle_drive, tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()
