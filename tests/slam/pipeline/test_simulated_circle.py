"""The promise of the first page, on a small simulated drive: two laps drift apart, and closing loops joins them."""

import json
import shutil
from pathlib import Path

import numpy as np
import open3d
import pytest
from rich.console import Console
from scipy.io import savemat
from typer.testing import CliRunner

from slam.apps.dense import RESULTS, DenseOptions, build_dense_map, read_run
from slam.cli import app
from slam.errors import ConfigError, DataError, OutputError
from slam.evaluation.trajectory_errors import umeyama
from slam.io.frames_and_loops_csv import read_loops
from slam.mapping.dense_mapper import DenseMapper, group_key_frames
from slam.mapping.submaps import SubmapStore
from slam.simulation import SimulationConfig
from slam.simulation.simulator import MANIFEST, ground_truth_surfaces
from slam.viewer.rerun_viewer import RerunViewer

from ...command_lines import Shown
from ...command_lines import lines as shown_commands

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def metrics(circle_run: Path) -> dict:
    return json.loads((circle_run / "metrics.json").read_text())


def test_the_second_lap_is_recognised_and_no_false_loop_is_kept(metrics: dict):
    assert metrics["loops"]["false"] == 0
    assert metrics["loops"]["recall"] > 0.5


def test_closing_the_loops_corrects_the_trajectory(metrics: dict):
    assert metrics["corrected"]["ate_m"] < metrics["odometry"]["ate_m"]


def test_closing_the_loops_joins_the_laps(metrics: dict):
    """What both laps share no loop can see, and it is most of so small an error; the drift between them goes."""
    assert metrics["corrected"]["end_error_m"] < 0.4 * metrics["odometry"]["end_error_m"]


def test_metrics_of_the_recogniser_stand_beside_those_of_the_trajectory(metrics: dict):
    assert metrics["places"]["recall_at_100_precision"] > 0.5
    assert metrics["places"]["truth_rows"] > 100


def test_every_belief_has_a_row_with_a_reason(circle_run: Path):
    rows = read_loops(circle_run / "loops.csv")
    assert all(row.reason for row in rows)
    assert [row.query for row in rows] == sorted({row.query for row in rows})


def test_every_kept_loop_was_verified(circle_run: Path):
    assert all(row.accepted and row.verified for row in read_loops(circle_run / "loops.csv") if row.in_graph)


@pytest.fixture(scope="module")
def town(circle_drive: Path) -> open3d.t.geometry.RaycastingScene:
    spec = SimulationConfig(**json.loads((circle_drive / MANIFEST).read_text())["config"])
    corners = ground_truth_surfaces(spec).astype(np.float32).reshape(-1, 3)
    rows = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(rows))
    return scene


def test_the_dense_map_lies_on_the_true_surfaces(
    circle_run: Path, town: open3d.t.geometry.RaycastingScene, tmp_path: Path
):
    run, store = read_run(circle_run), SubmapStore(tmp_path)
    groups = group_key_frames(run.odometry, run.key_frames, 20)
    chosen = [groups[1], groups[-2]]  # one of each lap
    assert list(DenseMapper(run.calibration).fuse(run.dataset, run.odometry, chosen, store))[-1] == len(
        [*chosen[0], *chosen[1]]
    )
    truth = run.dataset.ground_truth
    assert truth is not None
    poses = umeyama(run.corrected[:, :3, 3], truth[:, :3, 3]).apply_poses(run.corrected)
    points = np.concatenate([surface.points for surface in store.surfaces_in_world(poses)]).astype(np.float32)
    distances = town.compute_distance(open3d.core.Tensor(points)).numpy()
    assert len(points) > 10000
    assert np.median(distances) < 0.1
    assert np.percentile(distances, 80) < 0.3


def test_true_surfaces_are_where_the_camera_sees_them(town: open3d.t.geometry.RaycastingScene):
    """Under the car is road, a camera's height below, and nothing stands within a metre of it."""
    down = town.cast_rays(open3d.core.Tensor([[0, 0, 0, 0, 1, 0]], dtype=open3d.core.float32))["t_hit"].numpy()
    assert down == pytest.approx([1.65], abs=0.05)
    assert town.compute_distance(open3d.core.Tensor([[0, 0, 0]], dtype=open3d.core.float32)).numpy() > 1.0


@pytest.fixture
def short(circle_run: Path, tmp_path: Path) -> Path:
    """Make a run that was interrupted after 40 frames."""
    run = tmp_path / "run"
    run.mkdir()
    for name in ("calibration.toml", "config.toml", "metrics.json"):
        shutil.copy(circle_run / name, run)
    for name, lines in (("trajectory_odometry.tum", 40), ("trajectory_corrected.tum", 40), ("frames.csv", 41)):
        (run / name).write_text("".join((circle_run / name).read_text().splitlines(keepends=True)[:lines]))
    return run


def test_dense_maps_of_a_run_are_written_beside_it_and_never_lost_by_accident(short: Path):
    before = {path.name for path in short.iterdir()}
    assert "key frames in 2 submaps" in build_dense_map(DenseOptions(short), QUIET)
    assert {path.name for path in short.iterdir()} - before == set(RESULTS) - {"dense.rrd"}  # nothing was recorded
    clouds = {name: open3d.io.read_point_cloud(short / name) for name in RESULTS if name.endswith(".ply")}
    assert len(clouds["dense_before.ply"].points) == len(clouds["mesh_after.ply"].points) > 1000
    first = (short / "mesh_after.ply").read_bytes()
    with pytest.raises(OutputError, match="dense map already; give --overwrite"):
        build_dense_map(DenseOptions(short), QUIET)
    build_dense_map(DenseOptions(short, overwrite=True), QUIET)
    assert (short / "mesh_after.ply").read_bytes() == first


def test_the_dense_map_has_a_page_to_which_the_report_links_and_a_recording(circle_run: Path, short: Path):
    assert '<a href="dense.html">' in (circle_run / "report.html").read_text(encoding="utf-8")
    RerunViewer(short / "recording.rrd", read_run(short).dataset.camera).close()
    assert build_dense_map(DenseOptions(short), QUIET).endswith("dense.html, dense.rrd")
    assert (short / "dense.html").read_text(encoding="utf-8").count("data:image/webp;base64,") >= 3
    assert (short / "dense.rrd").stat().st_size > 1_000_000


def test_a_damaged_recording_does_not_lose_the_dense_map(short: Path, capsys: pytest.CaptureFixture[str]):
    (short / "recording.rrd").write_text("not ours")
    build_dense_map(DenseOptions(short), Console(stderr=True))
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"no dense.rrd: {short / 'recording.rrd'}: expected a recording of the rerun viewer")
    assert {path.name for path in short.iterdir()} >= set(RESULTS) - {"dense.rrd"}


def test_a_recording_that_is_not_the_runs_own_is_refused(circle_drive: Path, short: Path, tmp_path: Path):
    other = shutil.copytree(circle_drive, tmp_path / "other")
    calibration = other / "sequences" / "00" / "calib.txt"
    calibration.write_text(calibration.read_text().replace("3.59", "3.49"))
    with pytest.raises(
        DataError, match=r"other: expected the drive that .* was made of, found another: not the same camera;"
    ):
        build_dense_map(DenseOptions(short, other), QUIET)
    (short / "trajectory_corrected.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(DataError, match="found 40, 1, 40 and"):
        build_dense_map(DenseOptions(short), QUIET)


CHEAP = ("check", "doctor", "evaluate", "explain", "export")
# One of those that differ by nothing but a name.
SHOWN = {
    (*one.words[: 2 if one.name == "evaluate" else 1], *(word for word in one.words if word.startswith("-"))): one
    for one in shown_commands()
    if one.name in CHEAP
}


@pytest.fixture(scope="module")
def everything(circle_run: Path, circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that has what the pages speak of, under the names they use."""
    folder = tmp_path_factory.mktemp("everything")
    for name in ("my_drive", "SOURCE", "data/circle", "data/kitti"):
        shutil.copytree(circle_drive, folder / name)
    shutil.copytree(circle_drive / "sequences" / "00", folder / "data" / "kitti" / "sequences" / "05")
    shutil.copy(circle_drive / "poses" / "00.txt", folder / "data" / "kitti" / "poses" / "05.txt")
    for name in ("runs/demo", "runs/kitti05", "runs/places05"):
        shutil.copytree(circle_run, folder / name)
    shutil.copy(circle_run / "loops.csv", folder / "runs" / "places05" / "matches.csv")
    truth = np.load(circle_drive / "loops_00.npz")["truth"]
    savemat(folder / "groundTruthKITTI05.mat", {"truth": truth.astype(np.uint8)})
    return folder


@pytest.mark.parametrize("shown", SHOWN.values(), ids=str)
def test_a_printed_command_can_be_run(shown: Shown, everything: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(everything)
    result = CliRunner().invoke(app.app, list(shown.words), env={"TERM": "xterm-256color"})
    assert result.exit_code == 0, result.output
    assert len(result.stdout.split()) > 0
    assert "\x1b" not in result.output


def test_a_voxel_size_of_zero_is_refused_before_anything_is_read(tmp_path: Path):
    with pytest.raises(ConfigError, match="--voxel-size, --max-depth: expected positive numbers"):
        build_dense_map(DenseOptions(tmp_path, voxel_m=0.0), QUIET)
