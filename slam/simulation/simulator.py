"""Renders a simulated drive into a folder in KITTI odometry layout, with its ground truth.

`SceneStream` gives the renderer the meshes, shadows and sky near each stretch of the path; a whole town would not fit
into memory. Ground truth are the poses, the pairs of images that show the same place, and the surfaces of the town.
"""

import dataclasses
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.evaluation.revisit_ground_truth import RevisitRule, truth_from_poses
from slam.errors import OutputError
from slam.simulation.rendering.depth_camera import encode_depth
from slam.simulation.rendering.renderer import (
    Daylight,
    LitScene,
    RenderFrame,
    Scene,
    build_scene,
    build_shadow_map,
    cull_scene,
    render_view,
)
from slam.simulation.rendering.sensor_model import build_sensor_model, exposure_gain
from slam.simulation.scenario.config import FORMAT, SimulationConfig
from slam.simulation.scenario.vehicle_path import SimulatedTrajectory, plan_trajectory
from slam.simulation.world.materials import build_materials
from slam.simulation.world.textures import panorama
from slam.simulation.world.town import TownBuilder
from slam.simulation.world.vehicles import Traffic

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

SEQUENCE = "00"
MANIFEST = "drive.json"
DEPTH_SCALE = 256.0  # stored depth per metre, as in KITTI's depth maps
# The rule by which runs are evaluated, with a longer minimum distance along the path.
RULE = RevisitRule(min_path_length_m=50.0)
_WORKERS = 2  # threads: frames are independent, and compiled code releases the interpreter
# One filter instead of the best for each row: written in two thirds of the time, read in 0.6 of it, 7 % larger.
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]
_MAX_STRETCH_M = 220.0  # extent in x or y of a stretch, the part of the path that shares one scene
_DRAW_DISTANCE_M = 170.0  # from the stretch; meshes farther away are left out
_SHADOW_DISTANCE_M = 70.0  # from the path; farther surfaces are lit without shadows
# Azimuth and elevation of the sun, degrees, and light of sun and sky: one row for each lap in turn.
_WEATHERS = ((-50.0, 42.0, 1.15, 0.36), (75.0, 27.0, 0.3, 0.75), (160.0, 24.0, 1.3, 0.3))


def simulate(config: SimulationConfig, out: Path, progress: Progress | None = None) -> Path:
    """Render a dataset into a folder in KITTI odometry layout, and return the folder.

    Writes `sequences/00/{image_0,image_1}/%06d.png`, `calib.txt`, `times.txt` (and `depth/%06d.png` on request),
    `poses/00.txt` (T_world_camera of the left camera, world = first camera), `loops_00.npz` (`truth` (N, N) and
    `positions` (N, 3)) and `drive.json` (the configuration). An existing dataset of the same configuration is kept. The
    folder appears complete or not at all.

    Args:
        config: what to render.
        out: folder to write.
        progress: called with the number of finished frames and of all frames.

    Raises:
        OutputError: `out` contains something else, or cannot be written.
    """
    return write_once(manifest(config), out, lambda folder: _DatasetWriter(config, folder).write(progress or ignore))


def ignore(done: int, total: int) -> None:
    """Progress that nobody watches."""


def write_once(contents: dict[str, object], out: Path, write: Callable[[Path], None]) -> Path:
    """Write a dataset into a folder that appears complete or not at all, and return the folder.

    Args:
        contents: of the manifest, which is written last; a folder with the same manifest is kept as it is.
        out: folder to write.
        write: writes all else into an empty folder.

    Raises:
        OutputError: `out` contains something else, or cannot be written.
    """
    out = Path(out)
    if is_complete(contents, out):
        return out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: expected no folder, an empty one or the same drive, found something else; "
                          "remove it or name another folder")  # fmt: skip
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}); name another folder") from error
    try:
        write(unfinished)
        (unfinished / MANIFEST).write_text(json.dumps(contents, indent=1) + "\n")
        unfinished.chmod(0o755)
        _put_in_place(contents, unfinished, out)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return out


def _put_in_place(contents: dict[str, object], unfinished: Path, out: Path) -> None:
    """Replace an empty folder in one step; what another command has rendered there meanwhile stays if it is the same.

    Raises:
        OutputError: something else has appeared there meanwhile, or it cannot be replaced.
    """
    try:
        unfinished.replace(out)
    except OSError as error:
        if not is_complete(contents, out):
            raise OutputError(
                f"{out}: expected no folder or an empty one, found {error.strerror}, perhaps by another command;"
                " name another folder"
            ) from error


def is_complete(contents: dict[str, object], out: Path) -> bool:
    """Whether `out` already contains the dataset with this manifest, written by this version."""
    try:
        return bool(json.loads((out / MANIFEST).read_text()) == contents)
    except (OSError, ValueError):
        return False


def manifest(config: SimulationConfig) -> dict[str, object]:
    """Return the contents of `drive.json`: the configuration, and the contents of a pose file that it names."""
    plan = Path(config.shape).read_text() if config.from_file else None
    return {"format": FORMAT, "config": dataclasses.asdict(config), "plan": plan}


class _DatasetWriter:
    """Writes one dataset into an empty folder."""

    def __init__(self, config: SimulationConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.trajectory = plan_trajectory(config)
        self.sensors = [build_sensor_model(config, side) for side in (0, 1)]
        self.sequence = folder / "sequences" / SEQUENCE
        self.scenes = SceneStream(config, self.trajectory)
        self.done = 0

    def write(self, progress: Progress) -> None:
        """Write every file but the manifest."""
        for name in ("image_0", "image_1", *(["depth"] if self.config.depth else [])):
            (self.sequence / name).mkdir(parents=True)
        total = len(self.trajectory.distance_m)
        for done, _ in enumerate(self._frames(), start=1):
            progress(done, total)
        self._write_tables()

    def _frames(self) -> Iterator[None]:
        """Render all frames in parallel: the pixels of a frame depend on its number alone."""
        with ThreadPoolExecutor(_WORKERS) as pool:
            for lit, frames in self.scenes:
                yield from pool.map(lambda frame, lit=lit: self._render_frame(lit, frame), frames)

    def _render_frame(self, lit: LitScene, frame: int) -> None:
        poses, camera = self.trajectory.T_town_camera, self.config.camera
        wind = float(self.trajectory.timestamps[frame]) if self.config.conditions.real_sensor else None
        scene = cull_scene(lit, RenderFrame(self.scenes.traffic.meshes_at(frame), wind), camera, poses[frame])
        other = min(frame + 1, len(poses) - 1)
        motion = se3.inverse(poses[frame]) @ poses[other]
        exposure = 1.0
        for side, sensor in enumerate(self.sensors):
            here = poses[frame] @ se3.pose(np.eye(3), np.array([side * camera.baseline, 0.0, 0.0]))
            light, depth = render_view(lit, scene, camera, here)
            if side == 0:  # one exposure control serves both cameras
                exposure = exposure_gain(self.config, light, float(self.trajectory.timestamps[frame]))
            self._save(f"image_{side}", frame, sensor.expose(light, depth, motion, exposure, frame))
            if side == 0 and self.config.depth:
                self._save("depth", frame, encode_depth(depth, DEPTH_SCALE))

    def _save(self, name: str, frame: int, image: NDArray[np.generic]) -> None:
        save_png(self.sequence / name / f"{frame:06d}.png", image)

    def _write_tables(self) -> None:
        poses = se3.inverse(self.trajectory.T_town_camera[0]) @ self.trajectory.T_town_camera
        write_kitti_tables(self.folder, poses, self.trajectory.timestamps, self.config.camera)
        truth = loop_truth(poses)
        np.savez_compressed(self.folder / f"loops_{SEQUENCE}.npz", truth=truth, positions=poses[:, :3, 3])


def save_png(path: Path, image: NDArray[np.generic]) -> None:
    """Write an image, quickly.

    Raises:
        OutputError: it cannot be written.
    """
    if not cv2.imwrite(str(path), image, _FAST_PNG):
        raise OutputError(f"{path}: cannot be written; is the disk full?")


def write_kitti_tables(folder: Path, T_world_camera: Array, timestamps: Array, camera: StereoCamera) -> None:
    """Write poses (N, 4, 4), times (N,) and the calibration of a pair in the layout of KITTI."""
    sequence = folder / "sequences" / SEQUENCE
    (folder / "poses").mkdir()
    np.savetxt(folder / "poses" / f"{SEQUENCE}.txt", T_world_camera[:, :3].reshape(-1, 12), fmt="%.9e")
    np.savetxt(sequence / "times.txt", timestamps, fmt="%.6e")
    (sequence / "calib.txt").write_text(_format_calibration(camera))


def _format_calibration(camera: StereoCamera) -> str:
    """Format calib.txt: the grey pair P0 and P1, repeated as P2 and P3, since there are no colour cameras.

    Readers of KITTI expect the pose of a laser too; `Tr` places it in the camera.
    """
    lines = []
    for index in range(4):
        P = np.hstack([camera.K, [[-camera.fx * camera.baseline * (index % 2)], [0.0], [0.0]]])
        lines.append(f"P{index}: " + " ".join(f"{value:.12e}" for value in P.ravel()))
    lines.append("Tr: " + " ".join(f"{value:.12e}" for value in np.eye(4)[:3].ravel()))
    return "\n".join(lines) + "\n"


class SceneStream:
    """Iterates over (scene, its frames) from the first frame to the last."""

    def __init__(self, config: SimulationConfig, trajectory: SimulatedTrajectory) -> None:
        """Build the town around a trajectory."""
        self.config, self.trajectory = config, trajectory
        builder = TownBuilder(config, trajectory)
        self.meshes = builder.build()
        self.traffic = Traffic(config, trajectory, builder.cars)
        self.materials = build_materials(config)

    def __iter__(self) -> Iterator[tuple[LitScene, range]]:
        """Build the scene of one stretch after the other; stretches with the same meshes share them."""
        at = np.array([mesh.position[:2] if any(mesh.position) else _center(mesh.mesh.corners) for mesh in self.meshes])
        scene, members = None, None
        for frames in self._stretches():
            near = self.trajectory.T_town_camera[frames.start : frames.stop, :2, 3]
            low, high = near.min(axis=0) - _DRAW_DISTANCE_M, near.max(axis=0) + _DRAW_DISTANCE_M
            inside = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1))
            if scene is None or members is None or not np.array_equal(inside, members):
                scene, members = build_scene([self.meshes[i].to_town_frame() for i in inside]), inside
            yield self._lit_scene(scene, frames, near), frames

    def _lit_scene(self, scene: Scene, frames: range, near: Array) -> LitScene:
        light = choose_daylight(self.config, int(self.trajectory.lap[frames.start]))
        return LitScene(scene, build_shadow_map(scene, light.to_sun, near, _SHADOW_DISTANCE_M), light, self.materials)

    def _stretches(self) -> Iterator[range]:
        """Split the frames into runs of limited extent, and at the end of a lap if the light changes with the lap."""
        positions, lap = self.trajectory.T_town_camera[:, :2, 3], self.trajectory.lap
        start = 0
        for i in range(1, len(positions) + 1):
            if i < len(positions):
                span = np.ptp(positions[start : i + 1], axis=0).max()
                if span <= _MAX_STRETCH_M and not (self.config.change_illumination and lap[i] != lap[start]):
                    continue
            yield range(start, i)
            start = i


def _center(corners: Array) -> Array:
    return (corners[:, :, :2].min(axis=(0, 1)) + corners[:, :, :2].max(axis=(0, 1))) / 2


def choose_daylight(config: SimulationConfig, lap: int) -> Daylight:
    """Return sun and sky of a lap."""
    which = lap % len(_WEATHERS) if config.change_illumination else 0
    azimuth, height, sun, ambient = _WEATHERS[which]
    a, h = np.radians([azimuth, height])
    to_sun = np.array([np.cos(a) * np.cos(h), np.sin(a) * np.cos(h), np.sin(h)])
    sky = panorama(config.rng(9, which))
    return Daylight(to_sun, sun, ambient, 0.72, sky)


def loop_truth(T_world_camera: Array) -> NDArray[np.uint8]:
    """Matrix (N, N) of poses (N, 4, 4), metres: row = query image, column = earlier image, 1 = the same place.

    The same place: within 10 m, looking within 45 degrees of each other, with at least 50 m of path in between.
    """
    return truth_from_poses(T_world_camera, rule=RULE).astype(np.uint8)


def ground_truth_surfaces(config: SimulationConfig) -> NDArray[np.float64]:
    """Return the triangles (T, 3, 3) of all static objects, metres, in the world frame (the first camera)."""
    trajectory = plan_trajectory(config)
    corners = np.concatenate([mesh.to_town_frame().corners for mesh in TownBuilder(config, trajectory).build()])
    return se3.transform(se3.inverse(trajectory.T_town_camera[0]), corners.reshape(-1, 3)).reshape(-1, 3, 3)
