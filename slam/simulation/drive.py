"""`simulate`: a whole drive into a folder in KITTI odometry layout."""

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
from slam.simulation.camera_effects import build_sensor, gain
from slam.simulation.render import Moment, Stage, in_view, render
from slam.simulation.routes import plan_drive
from slam.simulation.spec import FORMAT, DriveSpec
from slam.simulation.stages import Stages
from slam.simulation.truth import loop_truth

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
SEQUENCE = "00"
MANIFEST = "drive.json"
DEPTH_SCALE = 256.0  # stored depth per metre, as in KITTI's depth maps
_WORKERS = 2
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def simulate(spec: DriveSpec, out: Path, progress: Progress | None = None) -> Path:
    """Render a drive into `out`, which then holds KITTI's layout, and return `out`.

    Writes `sequences/00/{image_0,image_1}/%06d.png`, `calib.txt`, `times.txt` (and `depth/%06d.png` on
    request), `poses/00.txt` (T_world_camera of the left camera, world = first camera), `loops_00.npz`
    (`truth` (N, N) and
    `positions` (N, 3)) and `drive.json` (the spec). A drive of the same spec that is already there is kept.
    progress: called with frames done and frames in all.

    Raises OutputError where `out` holds something else. The folder appears whole or not at all.
    """
    out = Path(out)
    if is_complete(spec, out):
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
        _Recording(spec, unfinished).write(progress or (lambda done, total: None))
        unfinished.chmod(0o755)
        # Replaces an empty folder in one step.
        unfinished.replace(out)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return out


def is_complete(spec: DriveSpec, out: Path) -> bool:
    """Whether `out` already holds the drive of this very spec, written by this version."""
    try:
        return json.loads((out / MANIFEST).read_text()) == manifest(spec)
    except (OSError, ValueError):
        return False


def manifest(spec: DriveSpec) -> dict[str, object]:
    """Return what `drive.json` says: the whole spec and what the numbers mean."""
    plan = Path(spec.shape).read_text() if spec.from_file else None
    return {"format": FORMAT, "spec": dataclasses.asdict(spec), "plan": plan}


class _Recording:
    """Writes one drive into a folder of its own."""

    def __init__(self, spec: DriveSpec, folder: Path) -> None:
        self.spec, self.folder = spec, folder
        self.drive = plan_drive(spec)
        self.sensors = [build_sensor(spec, side) for side in (0, 1)]
        self.sequence = folder / "sequences" / SEQUENCE
        self.stages = Stages(spec, self.drive)
        self.done = 0

    def write(self, progress: Progress) -> None:
        """Write every file, the manifest last."""
        for name in ("image_0", "image_1", *(["depth"] if self.spec.depth else [])):
            (self.sequence / name).mkdir(parents=True)
        total = len(self.drive.along)
        for done, _ in enumerate(self._frames(), start=1):
            progress(done, total)
        self._write_tables()
        (self.folder / MANIFEST).write_text(json.dumps(manifest(self.spec), indent=1) + "\n")

    def _frames(self) -> Iterator[None]:
        """Render all frames, two at a time: each depends on nothing but its number."""
        with ThreadPoolExecutor(_WORKERS) as pool:
            for stage, frames in self.stages:
                yield from pool.map(lambda frame, stage=stage: self._frame(stage, frame), frames)

    def _frame(self, stage: Stage, frame: int) -> None:
        poses, camera = self.drive.T_town_camera, self.spec.camera
        wind = None if self.spec.clean else float(self.drive.timestamps[frame])
        scene = in_view(stage, Moment(self.stages.traffic.at(frame), wind), camera, poses[frame])
        other = min(frame + 1, len(poses) - 1)
        motion = se3.inverse(poses[frame]) @ poses[other]
        exposure = 1.0
        for side, sensor in enumerate(self.sensors):
            here = poses[frame] @ se3.pose(np.eye(3), np.array([side * camera.baseline, 0.0, 0.0]))
            light, depth = render(stage, scene, camera, here)
            exposure = gain(self.spec, light, float(self.drive.timestamps[frame])) if side == 0 else exposure
            self._save(f"image_{side}", frame, sensor.expose(light, depth, motion, exposure, frame))
            if side == 0 and self.spec.depth:
                self._save("depth", frame, _stored(depth))

    def _save(self, name: str, frame: int, image: NDArray[np.generic]) -> None:
        path = self.sequence / name / f"{frame:06d}.png"
        if not cv2.imwrite(str(path), image, _PNG):
            raise OutputError(f"{path}: cannot be written; is the disk full?")

    def _write_tables(self) -> None:
        poses = se3.inverse(self.drive.T_town_camera[0]) @ self.drive.T_town_camera
        (self.folder / "poses").mkdir()
        np.savetxt(self.folder / "poses" / f"{SEQUENCE}.txt", poses[:, :3].reshape(-1, 12), fmt="%.9e")
        np.savetxt(self.sequence / "times.txt", self.drive.timestamps, fmt="%.6e")
        (self.sequence / "calib.txt").write_text(_calibration(self.spec))
        truth = loop_truth(poses)
        np.savez_compressed(self.folder / f"loops_{SEQUENCE}.npz", truth=truth, positions=poses[:, :3, 3])


def _stored(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Depth in 1/256 m; what is farther than 16 bits reach is 0, like the sky."""
    scaled = np.rint(depth * DEPTH_SCALE)
    return np.where(scaled < 2**16, scaled, 0).astype(np.uint16)


def _calibration(spec: DriveSpec) -> str:
    """calib.txt: the grey pair P0 and P1; P2 and P3 repeat them, as there are no colour cameras.

    Readers of KITTI expect the pose of a laser as well; `Tr` puts it into the camera.
    """
    camera, lines = spec.camera, []
    for index in range(4):
        P = np.hstack([camera.K, [[-camera.fx * camera.baseline * (index % 2)], [0.0], [0.0]]])
        lines.append(f"P{index}: " + " ".join(f"{value:.12e}" for value in P.ravel()))
    lines.append("Tr: " + " ".join(f"{value:.12e}" for value in np.eye(4)[:3].ravel()))
    return "\n".join(lines) + "\n"
