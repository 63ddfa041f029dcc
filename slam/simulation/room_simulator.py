"""Renders a camera that moves through a room: TUM RGB-D layout for one camera, KITTI layout for a pair.

Ground truth are the poses and the surfaces of the room. Frames go to the disk one by one.
"""

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.simulation.rendering.depth_camera import DEPTH_SCALE, encode_depth, measure_depth
from slam.simulation.rendering.indoor_renderer import IndoorView, LitRoom, render_indoors
from slam.simulation.rendering.light_volume import LightSource, bake_light
from slam.simulation.rendering.renderer import build_scene
from slam.simulation.rendering.sensor_model import build_sensor_model, exposure_gain
from slam.simulation.scenario.room_config import ROOM, ROOM_FORMAT, RoomConfig
from slam.simulation.scenario.room_motion import RoomTrajectory, plan_room_trajectory
from slam.simulation.simulator import SEQUENCE, ignore, save_png, write_kitti_tables, write_once
from slam.simulation.world.room import Room, build_room
from slam.simulation.world.room_materials import RoomSurface, build_room_materials
from slam.simulation.world.textures import panorama

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Progress = Callable[[int, int], None]

_WORKERS = 2  # threads: frames are independent, and compiled code releases the interpreter
_FRAMES_AHEAD = 64  # that wait for a thread at a time
_WINDOW_LIGHT = 1.0  # strength of the window per square metre
_LAMP_LIGHT = 3.0  # strength per metre of a lamp's extent
SURFACES = "surfaces.ply"


def simulate_room(config: RoomConfig, out: Path, progress: Progress | None = None) -> Path:
    """Render a room into a folder, and return the folder.

    One camera: `rgb/`, `depth/` (with a depth camera), `rgb.txt`, `depth.txt`, `groundtruth.txt` (T_world_camera, world
    = the room, z up, origin in a corner on the floor) and `camera.toml`. A pair: `sequences/00` and `poses/00.txt` as
    `simulate` writes them (world = first left camera). Both: `surfaces.ply`, all surfaces in the frame of the poses,
    and `drive.json`, the configuration. An existing dataset of the same configuration is kept. The folder appears
    complete or not at all.

    Args:
        config: what to render.
        out: folder to write.
        progress: called with the number of finished frames and of all frames.

    Raises:
        OutputError: `out` contains something else, or cannot be written.
    """
    contents = {"format": ROOM_FORMAT, "shape": ROOM, "config": dataclasses.asdict(config)}
    return write_once(contents, out, lambda folder: _RoomWriter(config, folder).write(progress or ignore))


@lru_cache(maxsize=2)
def light_room(seed: int) -> LitRoom:
    """Compute the light of the room of a seed, and make it ready to be rendered."""
    room = build_room(seed)
    sources = [*_lamps(room), _daylight(room)]
    corners = np.concatenate([mesh.corners[mesh.material != RoomSurface.LAMP] for mesh in room.meshes])
    volume = bake_light(corners, sources, room.floors, room.height)
    outdoors = panorama(RoomConfig(seed=seed).rng(32), 2048)
    return LitRoom(build_scene(room.meshes), volume, outdoors, build_room_materials(seed))


def _lamps(room: Room) -> Iterator[LightSource]:
    """Return a source for each lamp: four points at its lower side."""
    for mesh in room.meshes:
        shade = mesh.corners[mesh.material == RoomSurface.LAMP].reshape(-1, 3)
        if len(shade):
            low, high = shade.min(axis=0), shade.max(axis=0)
            spots = np.array([[0.2, 0.2], [0.8, 0.2], [0.2, 0.8], [0.8, 0.8]]) * (high - low)[:2] + low[:2]
            points = np.column_stack([spots, np.full(4, low[2] - 0.02)])
            yield LightSource(points, np.zeros(3), _LAMP_LIGHT * float((high - low)[:2].mean()))


def _daylight(room: Room) -> LightSource:
    """Return the window as a source: nine points that shine into the room."""
    low, high = room.window
    shares = (np.indices((3, 3)).reshape(2, -1).T + 0.5) / 3
    wide = int(np.argmax((high - low)[:2]))
    points = np.tile((low + high) / 2, (9, 1))
    points[:, wide] = low[wide] + shares[:, 0] * (high - low)[wide]
    points[:, 2] = low[2] + shares[:, 1] * (high - low)[2]
    facing = np.zeros(3)
    facing[1 - wide] = 1.0 if low[1 - wide] < 0.5 else -1.0
    return LightSource(points, facing, _WINDOW_LIGHT * float(np.prod((high - low)[[wide, 2]])))


class _RoomWriter:
    """Writes one dataset into an empty folder."""

    def __init__(self, config: RoomConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.room = build_room(config.seed)
        self.trajectory = plan_motion(config, self.room)
        self.lit = light_room(config.seed)
        sides = (0, 1) if config.sensor == "stereo" else (0,)
        self.sensors = [build_sensor_model(config, side) for side in sides]
        self.layout: _TumLayout | _KittiLayout
        self.layout = _KittiLayout(config, folder) if config.sensor == "stereo" else _TumLayout(config, folder)

    def write(self, progress: Progress) -> None:
        """Write every file but the manifest."""
        self.layout.make_folders()
        total = len(self.trajectory.timestamps)
        with ThreadPoolExecutor(_WORKERS) as pool:
            for first in range(0, total, _FRAMES_AHEAD):
                batch = range(first, min(first + _FRAMES_AHEAD, total))
                for done, _ in enumerate(pool.map(self._render_frame, batch), start=first + 1):
                    progress(done, total)
        T_world_room = self.layout.write_tables(self.trajectory)
        corners = np.concatenate([mesh.corners for mesh in self.room.meshes]).reshape(-1, 3)
        write_triangles(self.folder / SURFACES, se3.transform(T_world_room, corners))

    def _render_frame(self, frame: int) -> None:
        config, camera, poses = self.config, self.config.camera, self.trajectory.T_room_camera
        motion = se3.inverse(poses[frame]) @ poses[min(frame + 1, len(poses) - 1)]
        time, exposure = float(self.trajectory.timestamps[frame]), 1.0
        images: list[NDArray[np.uint8]] = []
        depth = None
        for sensor in self.sensors:
            here = poses[frame] @ se3.pose(np.eye(3), np.array([sensor.side * camera.baseline, 0.0, 0.0]))
            view = render_indoors(self.lit, camera, here)
            if sensor.side == 0:  # one exposure control serves both cameras
                exposure = exposure_gain(config, view.light, time)
            images.append(sensor.expose(view.light, view.depth, motion, exposure, frame))
            if config.sensor == "depth":
                depth = sensor.displace(self._measure(view, frame), frame, cv2.INTER_NEAREST)
        self.layout.save(frame, time, images, depth)

    def _measure(self, view: IndoorView, frame: int) -> Image:
        """Return what the depth camera measures (H, W), metres; with a perfect sensor, the true depth."""
        if not self.config.conditions.real_sensor:
            return np.where(np.isfinite(view.depth), view.depth, 0.0).astype(np.float32)
        return measure_depth(view.depth, view.returns, self.config.camera, self.config.rng(18, frame))


def plan_motion(config: RoomConfig, room: Room) -> RoomTrajectory:
    """Plan the motion of a configuration through its room."""
    return plan_room_trajectory(config, room.floors, room.obstacles, room.door, room.sights)


class _TumLayout:
    """Files of one camera in the layout of the TUM RGB-D benchmark."""

    def __init__(self, config: RoomConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.names = ("rgb", "depth") if config.sensor == "depth" else ("rgb",)

    def make_folders(self) -> None:
        """Make the folders of the images."""
        for name in self.names:
            (self.folder / name).mkdir()

    def save(self, frame: int, time: float, images: list[NDArray[np.uint8]], depth: Image | None) -> None:
        """Write the image of a frame, and its depth if there is one; files are named by their time."""
        save_png(self.folder / "rgb" / f"{time:.6f}.png", images[0])
        if depth is not None:
            save_png(self.folder / "depth" / f"{time:.6f}.png", encode_depth(depth))

    def write_tables(self, trajectory: RoomTrajectory) -> Array:
        """Write lists, poses and calibration; return T_world_room (4, 4) of the poses."""
        for name in self.names:
            lines = [f"{time:.6f} {name}/{time:.6f}.png\n" for time in trajectory.timestamps]
            (self.folder / f"{name}.txt").write_text("# timestamp filename\n" + "".join(lines))
        poses = trajectory.T_room_camera
        rows = np.column_stack(
            [trajectory.timestamps, poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()]
        )
        formats = ["%.6f", *["%.7f"] * 3, *["%.9f"] * 4]
        np.savetxt(self.folder / "groundtruth.txt", rows, formats, header="timestamp tx ty tz qx qy qz qw")
        camera = self.config.camera
        values: dict[str, float] = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        if self.config.sensor == "depth":
            values["depth_scale"] = DEPTH_SCALE
        (self.folder / "camera.toml").write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
        return np.eye(4)


class _KittiLayout:
    """Files of a pair in the layout of KITTI."""

    def __init__(self, config: RoomConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.sequence = folder / "sequences" / SEQUENCE

    def make_folders(self) -> None:
        """Make the folders of the images."""
        for side in (0, 1):
            (self.sequence / f"image_{side}").mkdir(parents=True)

    def save(self, frame: int, time: float, images: list[NDArray[np.uint8]], depth: Image | None) -> None:
        """Write the pair of a frame; files are named by its number."""
        for side, image in enumerate(images):
            save_png(self.sequence / f"image_{side}" / f"{frame:06d}.png", image)

    def write_tables(self, trajectory: RoomTrajectory) -> Array:
        """Write poses, times and calibration; return T_world_room (4, 4) of the poses."""
        T_world_room = se3.inverse(trajectory.T_room_camera[0])
        write_kitti_tables(
            self.folder, T_world_room @ trajectory.T_room_camera, trajectory.timestamps, self.config.camera
        )
        return np.asarray(T_world_room)


def write_triangles(path: Path, corners: Array) -> None:
    """Write triangles, three corners (3 T, 3) each, metres, as a binary PLY file."""
    faces = np.zeros(len(corners) // 3, dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, np.arange(len(corners)).reshape(-1, 3)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(corners)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + corners.astype("<f4").tobytes() + faces.tobytes())
