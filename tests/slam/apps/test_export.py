"""What is exported is what the run holds; whatever cannot be is one line."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.cli import app
from slam.io.trajectory_files import read_kitti, read_tum, write_tum

TIMES = np.array([0.0, 0.1, 0.2])


def poses(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    stack = np.tile(np.eye(4), (3, 1, 1))
    stack[:, :3, :3] = Rotation.random(3, rng=rng).as_matrix()
    stack[:, :3, 3] = rng.normal(size=(3, 3))
    return stack


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "käthe <1>"
    folder.mkdir()
    for seed, name in enumerate(("odometry", "online", "corrected")):
        write_tum(folder / f"trajectory_{name}.tum", TIMES, poses(seed))
    for name in ("before", "after"):
        (folder / f"pose_graph_{name}.g2o").write_text(f"# {name}\n")
        (folder / f"map_{name}.ply").write_bytes(b"ply\n" + name.encode())
    return folder


def export(*arguments: object) -> int:
    return app._exit_code(lambda: app.app(["export", *map(str, arguments)]))


@pytest.mark.parametrize("state", ["odometry", "online", "corrected"])
def test_a_trajectory_comes_out_as_it_went_in(run: Path, tmp_path: Path, state: str) -> None:
    expected = read_tum(run / f"trajectory_{state}.tum")[1]
    assert export(run, "--format", "tum", "--state", state, "--out", tmp_path / "a.tum") == 0
    assert export(run, "--format", "kitti", "--state", state, "--out", tmp_path / "a.txt") == 0
    times, as_tum = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(times, TIMES)
    np.testing.assert_allclose(as_tum, expected, atol=1e-12)
    np.testing.assert_allclose(read_kitti(tmp_path / "a.txt"), expected, atol=1e-12)


@pytest.mark.parametrize(("kind", "file"), [("g2o", "pose_graph"), ("ply", "map")])
def test_graph_and_map_come_as_they_were_and_as_they_became(run: Path, kind: str, file: str) -> None:
    for state, name in (("odometry", "before"), ("corrected", "after")):
        assert export(run, "--format", kind, "--state", state) == 0
        written = run.with_name(f"{run.name}_{state}.{kind}")
        assert written.read_bytes() == (run / f"{file}_{name}.{kind}").read_bytes()


def test_whatever_cannot_be_exported_is_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faults = (
        (["--format", "bvh"], 2, "--format: expected one of tum, kitti, g2o, ply, colmap, found 'bvh'"),
        (["--format", "ply", "--state", "online"], 2, "--state: expected one of odometry, corrected for ply"),
    )
    for arguments, code, message in faults:
        assert export(run, *arguments) == code
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    (run / "map_after.ply").unlink()
    assert export(run, "--format", "ply") == 1
    assert "map_after.ply: expected the result of a run, found none" in capsys.readouterr().err


def test_an_existing_file_stays_without_overwrite(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.tum"
    out.write_text("dear to me")
    assert export(run, "--format", "tum", "--out", out) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert out.read_text() == "dear to me"
    assert export(run, "--format", "tum", "--out", out, "--overwrite") == 0
    assert len(read_tum(out)[0]) == 3
