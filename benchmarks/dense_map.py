"""Errors of the dense map of a simulated drive or room against the true surfaces, before and after correction.

Run from the root, on a run of a drive, or of a room with a depth camera, that `revisit simulate` has rendered:
`python benchmarks/dense_map.py RUN [PICTURE.png]`. An error is the distance of a point of the map, seen
from at most 25 m, to the nearest static surface; points of moving cars count as errors. The map is aligned
with the truth twice: by its first camera, and by SE(3) alignment of the trajectory, as for the ATE. The control is the
map on the trajectory of the odometry. The cost is printed as well.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d
from command_line import existing, run_script
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from odometry import se3
from slam.apps.dense import DenseOptions, MappedRun, read_run
from slam.evaluation.trajectory_errors import Similarity, umeyama
from slam.io.trajectory_reader import read_trajectory
from slam.mapping.dense_mapper import DenseMapper, group_key_frames
from slam.mapping.occupancy_grid import FREE, OCCUPIED, OccupancyGrid, build_occupancy_grid
from slam.mapping.submaps import SubmapStore
from slam.pipeline.provenance import peak_memory_mb
from slam.simulation.room_simulator import SURFACES
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import plan_trajectory
from slam.simulation.simulator import MANIFEST, ground_truth_surfaces

Array = NDArray[np.float64]
REACH_M = 25.0
HEIGHTS_M = (0.45, 0.8, 1.2, 1.6, 1.9)  # above the road, at which the grid is compared


def fuse_run(run: MappedRun, folder: Path) -> tuple[SubmapStore, str]:
    """Fuse the recording of a run; return the submaps and a line about the cost."""
    store, groups = SubmapStore(folder), group_key_frames(run.odometry, run.key_frames, 20)
    wall, processor = time.perf_counter(), time.process_time()
    mapper = DenseMapper(run.calibration, DenseOptions(folder).config(run.has_depth), run.has_depth)
    done = len(list(mapper.fuse(run.dataset, run.odometry, groups, store)))
    wall, processor = (time.perf_counter() - wall) / done, (time.process_time() - processor) / done
    held = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
    cost = f"{1e3 * wall:.1f} ms a key frame by the clock, {1e3 * processor:.1f} ms of processor, reading included"
    return store, f"{done} key frames in {len(store)} submaps, {held:.0f} MB: {cost}"


def load_surfaces(source: Path) -> open3d.t.geometry.RaycastingScene:
    """Return the true surfaces of a simulated recording, in the frame of its first camera."""
    scene = open3d.t.geometry.RaycastingScene()
    if (source / SURFACES).exists():
        mesh, poses = open3d.t.io.read_triangle_mesh(str(source / SURFACES)), source / "groundtruth.txt"
        # One camera's poses are those of the room, a pair's those of KITTI's layout.
        T_surfaces_camera = read_trajectory(poses).poses[0] if poses.exists() else np.eye(4)
        scene.add_triangles(mesh.transform(se3.inverse(T_surfaces_camera)))
        return scene
    corners = ground_truth_surfaces(read_town(source)).astype(np.float32)
    rows = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(open3d.core.Tensor(corners.reshape(-1, 3)), open3d.core.Tensor(rows))
    return scene


def read_town(source: Path) -> SimulationConfig:
    """Return the configuration of a simulated drive."""
    return SimulationConfig(**json.loads((source / MANIFEST).read_text())["config"])


def distances(store: SubmapStore, poses: Array, scene: open3d.t.geometry.RaycastingScene) -> Array:
    """Distance (N,), metres, of each point of a map on a trajectory (F, 4, 4) to the nearest true surface."""
    out = []
    for submap in store:
        points = submap.surface.points.astype(np.float64)
        near = np.zeros(len(points), dtype=bool)
        for T_anchor_camera in submap.T_anchor_camera:
            near |= np.linalg.norm(points - T_anchor_camera[:3, 3], axis=1) <= REACH_M
        world = se3.transform(poses[submap.anchor], points[near])
        out.append(scene.compute_distance(open3d.core.Tensor(world.astype(np.float32))).numpy())
    return np.concatenate(out)


def agreement(
    grid: OccupancyGrid, fit: Similarity, spec: SimulationConfig, scene: open3d.t.geometry.RaycastingScene
) -> str:
    """Return the shares of occupied cells with a surface of the town within 0.3 m, and of free cells within 0.1 m."""
    T_town_world = plan_trajectory(spec).T_town_camera[0]
    shares = {}
    for value, near in ((OCCUPIED, 0.3), (FREE, 0.1)):
        rows, columns = np.nonzero(grid.cells[::-1] == value)
        x, y = ((np.stack([columns, rows], axis=1) + 0.5) * grid.resolution_m + grid.origin).T
        cells = se3.transform(T_town_world, fit.apply(np.stack([-y, 0 * x, x], axis=1)))
        nearest = np.full(len(cells), np.inf)
        for cells[:, 2] in HEIGHTS_M:  # the town's road lies at zero
            world = se3.transform(se3.inverse(T_town_world), cells).astype(np.float32)
            nearest = np.minimum(nearest, scene.compute_distance(open3d.core.Tensor(world)).numpy())
        shares[value] = np.mean(nearest < near)
    return f"occupied cells with something there: {shares[OCCUPIED]:.1%}, free ones: {shares[FREE]:.1%}"


def draw(store: SubmapStore, trajectories: dict[str, Array], path: Path) -> None:
    """Draw the points within half a metre of the plane across the street at the end of each trajectory."""
    T_camera_world = se3.inverse(trajectories["corrected"][-1])
    figure = Figure(figsize=(9, 2.4), layout="constrained")
    for axes, (name, poses) in zip(
        figure.subplots(1, len(trajectories), sharey=True), trajectories.items(), strict=True
    ):
        for surface in store.surfaces_in_world(poses):
            across, down, ahead = se3.transform(T_camera_world, surface.points).T
            near = np.abs(ahead) < 0.5
            axes.plot(across[near], -down[near], ".", color="black", markersize=1.5)
        axes.set(title=name, aspect="equal", xlim=(-10, 10), ylim=(-2.5, 1.5), xlabel="to the right [m]")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Print the distances of both maps and the cost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=existing, help="folder of the run")
    parser.add_argument("picture", type=Path, nargs="?", help="picture of a cross-section at the end of the drive")
    arguments = parser.parse_args()
    folder = arguments.run
    run = read_run(folder)
    source = Path(json.loads((folder / "metrics.json").read_text())["source"])
    scene = load_surfaces(source)
    truth = run.dataset.ground_truth
    assert truth is not None
    trajectories = {"odometry": run.odometry.T_world_camera, "corrected": run.corrected, "true poses": truth}
    table = Table("map on", "aligned by", "median [m]", "75 % [m]", "90 % [m]", "over 2 cm", "over 0.3 m", box=None)
    medians = {}
    with tempfile.TemporaryDirectory() as temporary:
        store, cost = fuse_run(run, Path(temporary))
        for name, poses in trajectories.items():
            fit = umeyama(poses[:, :3, 3], truth[: len(poses), :3, 3])
            for alignment, aligned in (
                ("first camera", truth[0] @ se3.inverse(poses[0]) @ poses),
                ("alignment", fit.apply_poses(poses)),
            ):
                found = distances(store, aligned, scene)
                quartiles = np.percentile(found, [50, 75, 90])
                medians[name, alignment] = quartiles[0]
                shares = (f"{np.mean(found > limit_m):.1%}" for limit_m in (0.02, 0.3))
                table.add_row(name, alignment, *(f"{value:.4f}" for value in quartiles), *shares)
        if not (source / SURFACES).exists():
            fit = umeyama(run.corrected[:, :3, 3], truth[: len(run.corrected), :3, 3])
            grid = build_occupancy_grid(store, run.corrected)
            Console().print(agreement(grid, fit, read_town(source), scene))
        if arguments.picture:
            draw(store, {name: trajectories[name] for name in ("odometry", "corrected")}, arguments.picture)
    Console().print(table)
    for alignment in ("first camera", "alignment"):
        Console().print(
            f"after / before, {alignment}: {medians['corrected', alignment] / medians['odometry', alignment]:.2f}"
        )
    Console().print(cost)
    Console().print(f"{peak_memory_mb():.0f} MB of memory at most, including the benchmark's own town")


if __name__ == "__main__":
    run_script(main)
