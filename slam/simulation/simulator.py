"""Renders a simulated dataset into a folder in KITTI odometry layout."""

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
from slam.errors import OutputError
from slam.simulation.ground_truth import loop_truth
from slam.simulation.rendering.renderer import LitScene, RenderFrame, cull_scene, render_view
from slam.simulation.rendering.sensor_model import build_sensor_model, exposure_gain
from slam.simulation.scenario.config import FORMAT, SimulationConfig
from slam.simulation.scenario.trajectory import plan_trajectory
from slam.simulation.scene_streaming import SceneStream

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
SEQUENCE = "00"
MANIFEST = "drive.json"
DEPTH_SCALE = 256.0  # stored depth per metre, as in KITTI's depth maps
_WORKERS = 2  # threads: frames are independent, and compiled code releases the interpreter
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


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
    out = Path(out)
    if is_complete(config, out):
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
        _DatasetWriter(config, unfinished).write(progress or (lambda done, total: None))
        unfinished.chmod(0o755)
        # Replaces an empty folder in one step.
        unfinished.replace(out)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return out


def is_complete(config: SimulationConfig, out: Path) -> bool:
    """Whether `out` already contains the dataset of this configuration, written by this version."""
    try:
        return json.loads((out / MANIFEST).read_text()) == manifest(config)
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
        """Write every file, the manifest last."""
        for name in ("image_0", "image_1", *(["depth"] if self.config.depth else [])):
            (self.sequence / name).mkdir(parents=True)
        total = len(self.trajectory.distance_m)
        for done, _ in enumerate(self._frames(), start=1):
            progress(done, total)
        self._write_tables()
        (self.folder / MANIFEST).write_text(json.dumps(manifest(self.config), indent=1) + "\n")

    def _frames(self) -> Iterator[None]:
        """Render all frames in parallel: the pixels of a frame depend on its number alone."""
        with ThreadPoolExecutor(_WORKERS) as pool:
            for lit, frames in self.scenes:
                yield from pool.map(lambda frame, lit=lit: self._render_frame(lit, frame), frames)

    def _render_frame(self, lit: LitScene, frame: int) -> None:
        poses, camera = self.trajectory.T_town_camera, self.config.camera
        wind = None if self.config.ideal_sensor else float(self.trajectory.timestamps[frame])
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
                self._save("depth", frame, _encode_depth(depth))

    def _save(self, name: str, frame: int, image: NDArray[np.generic]) -> None:
        path = self.sequence / name / f"{frame:06d}.png"
        if not cv2.imwrite(str(path), image, _FAST_PNG):
            raise OutputError(f"{path}: cannot be written; is the disk full?")

    def _write_tables(self) -> None:
        poses = se3.inverse(self.trajectory.T_town_camera[0]) @ self.trajectory.T_town_camera
        (self.folder / "poses").mkdir()
        np.savetxt(self.folder / "poses" / f"{SEQUENCE}.txt", poses[:, :3].reshape(-1, 12), fmt="%.9e")
        np.savetxt(self.sequence / "times.txt", self.trajectory.timestamps, fmt="%.6e")
        (self.sequence / "calib.txt").write_text(_format_calibration(self.config))
        truth = loop_truth(poses)
        np.savez_compressed(self.folder / f"loops_{SEQUENCE}.npz", truth=truth, positions=poses[:, :3, 3])


def _encode_depth(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Encode depth in units of 1/256 m; depths beyond 16 bits (256 m) and the sky are 0."""
    scaled = np.rint(depth * DEPTH_SCALE)
    return np.where(scaled < 2**16, scaled, 0).astype(np.uint16)


def _format_calibration(config: SimulationConfig) -> str:
    """Format calib.txt: the grey pair P0 and P1, repeated as P2 and P3, since there are no colour cameras.

    Readers of KITTI expect the pose of a laser too; `Tr` places it in the camera.
    """
    camera, lines = config.camera, []
    for index in range(4):
        P = np.hstack([camera.K, [[-camera.fx * camera.baseline * (index % 2)], [0.0], [0.0]]])
        lines.append(f"P{index}: " + " ".join(f"{value:.12e}" for value in P.ravel()))
    lines.append("Tr: " + " ".join(f"{value:.12e}" for value in np.eye(4)[:3].ravel()))
    return "\n".join(lines) + "\n"
