"""Writes what a rig has seen in every layout that can be read."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.datasets.rectification import Rectification, rectify_pair
from slam.io.trajectory_files import write_tum

from .rig import RIGS, SIZE, Rig, Walls, rig_poses

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

START, RATE = 1403636580, 20.0  # s; images a second
TRUTH_RATE = 200.0


@dataclass(frozen=True)
class Taken:
    """What a rig recorded along its path.

    Attributes:
        rig: the cameras.
        poses: T_world_left (N, 4, 4) of the left camera, metres.
        pairs: N raw images.
    """

    rig: Rig
    poses: Array
    pairs: list[tuple[Image, Image]] = field(repr=False)

    @property
    def times(self) -> Array:
        """(N,) seconds."""
        return START + np.arange(len(self.pairs)) / RATE

    @property
    def ideal(self) -> Rectification:
        """What should become of the images."""
        return rectify_pair(self.rig.left, self.rig.right, self.rig.T_left_right, SIZE)

    @property
    def truth(self) -> Array:
        """T_world_camera (N, 4, 4) of the ideal left camera; world is the first."""
        T = self.poses @ self.ideal.T_camera_view
        return se3.inverse(T[0]) @ T


def taken(name: str, count: int = 5) -> Taken:
    walls, poses = Walls(), rig_poses(count)
    return Taken(RIGS[name], poses, [walls.pair(RIGS[name], T) for T in poses])


T_BODY_LEFT = se3.pose(Rotation.from_euler("xyz", [10, -5, 90], degrees=True).as_matrix(), np.array([0.1, -0.2, 0.05]))


def write_euroc(root: Path, drive: Taken) -> Path:
    """EuRoC, its truth ten times as often as its images, and from a tenth of a second before to one after."""
    cameras = ((drive.rig.left, T_BODY_LEFT), (drive.rig.right, T_BODY_LEFT @ drive.rig.T_left_right))
    nanoseconds = [round(time * 1e9) for time in drive.times]
    for camera, (lens, T_body_camera) in enumerate(cameras):
        folder = root / "mav0" / f"cam{camera}"
        (folder / "data").mkdir(parents=True)
        lines = ["#timestamp [ns],filename"] + [f"{t},{t}.png" for t in nanoseconds]
        (folder / "data.csv").write_text("\r\n".join(lines) + "\r\n")
        for t, pair in zip(nanoseconds, drive.pairs, strict=True):
            cv2.imwrite(str(folder / "data" / f"{t}.png"), pair[camera])
        model = {"radtan": "radial-tangential"}.get(lens.distortion_model, lens.distortion_model)
        (folder / "sensor.yaml").write_text(
            "#Default camera\n"
            "sensor_type: camera\ncomment: VI-EurocCamera\n\n# pose in the body\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: {[float(v) for v in T_body_camera.ravel()]}\n\n"
            f"rate_hz: 20\nresolution: {list(SIZE)}\ncamera_model: pinhole\n"
            f"intrinsics: [{lens.fx}, {lens.fy}, {lens.cx}, {lens.cy}] #fu, fv, cu, cv\n"
            f"distortion_model: {model}\ndistortion_coefficients: {list(lens.coefficients)}\n"
        )
    _write_euroc_truth(root / "mav0" / "state_groundtruth_estimate0", drive)
    return root


def _write_euroc_truth(folder: Path, drive: Taken) -> None:
    folder.mkdir()
    lines = ["#timestamp, p_RS_R_x [m], ..."]
    for time, T_world_left in zip(*finely(drive), strict=True):
        T = T_world_left @ se3.inverse(T_BODY_LEFT)
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        cells = [str(round(time * 1e9)), *map(repr, map(float, [*T[:3, 3], w, x, y, z])), *["0.0"] * 9]
        lines.append(",".join(cells))
    (folder / "data.csv").write_text("\n".join(lines) + "\n")


def finely(drive: Taken) -> tuple[Array, Array]:
    """Times and poses of the left camera, as a motion capture would have them; exact where the images are."""
    step = int(TRUTH_RATE / RATE)
    times, poses = [], []
    for k in range(len(drive.poses) - 1):
        xi = se3.log(se3.inverse(drive.poses[k]) @ drive.poses[k + 1])
        for part in range(step):
            times.append(drive.times[k] + part / TRUTH_RATE)
            poses.append(drive.poses[k] @ se3.exp(xi * part / step))
    return np.array([*times, drive.times[-1]]), np.array([*poses, drive.poses[-1]])


def write_tum_rgbd(root: Path, drive: Taken) -> Path:
    (root / "rgb").mkdir(parents=True)
    lines = ["# color images", "# file: 'rgbd.bag'", "# timestamp filename"]
    for time, (left, _) in zip(drive.times, drive.pairs, strict=True):
        name = f"rgb/{time:.6f}.png"
        cv2.imwrite(str(root / name), cv2.cvtColor(left, cv2.COLOR_GRAY2BGR))
        lines.append(f"{time:.6f} {name}")
    (root / "rgb.txt").write_text("\n".join(lines) + "\n")
    write_tum(root / "groundtruth.txt", *finely(drive))
    return root


def camera_toml(rig: Rig, pair: bool = True, **more: object) -> str:
    """A `camera.toml` with everything in it."""

    def lens(of: Any) -> list[str]:
        numbers = [f"{name} = {getattr(of, name)}" for name in ("fx", "fy", "cx", "cy")]
        model = (
            []
            if of.distortion_model == "none"
            else [f'model = "{of.distortion_model}"', f"distortion = {list(of.coefficients)}"]
        )
        return numbers + model

    lines = lens(rig.left) + [f"{key} = {value!r}".replace("'", '"') for key, value in more.items()]
    if pair:
        lines += ["[right_camera]", *lens(rig.right), f"T_left_right = {rig.T_left_right.tolist()}"]
    return "\n".join(lines) + "\n"


def write_folders(root: Path, drive: Taken, names: tuple[str, str] = ("left", "right"), **more: object) -> Path:
    for side, name in enumerate(names):
        (root / name).mkdir(parents=True)
        for index, pair in enumerate(drive.pairs):
            cv2.imwrite(str(root / name / f"{index + 8}.png"), pair[side])  # natural order: 9 before 10
    (root / "camera.toml").write_text(camera_toml(drive.rig, **more))
    return root


def write_video(path: Path, images: list[Image], codec: str = "MJPG", rate: float = RATE) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, SIZE)
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


BAGS = {"ros1": ".bag", "sqlite3": "", "mcap": ""}
TOPICS = ("/stereo/left/image_raw", "/stereo/right/image_raw")


@dataclass(frozen=True)
class BagStyle:
    """How a bag is written: storage in BAGS, encoding or "png" for compressed, and whether cameras are described."""

    storage: str = "ros1"
    encoding: str = "mono8"
    infos: bool = True
    topics: tuple[str, ...] = TOPICS


def write_bag(root: Path, drive: Taken, style: BagStyle) -> Path:
    """A bag as `rosbags` itself writes it. Right images come 1 ms late, and all arrive 30 ms after they were taken."""
    store = get_typestore(Stores.ROS1_NOETIC if style.storage == "ros1" else Stores.ROS2_HUMBLE)
    path = root / f"drive{BAGS[style.storage]}"
    root.mkdir(parents=True, exist_ok=True)
    plugin = StoragePlugin.MCAP if style.storage == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if style.storage == "ros1" else Writer2(path, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/CompressedImage" if style.encoding == "png" else "sensor_msgs/msg/Image"
        images = [writer.add_connection(topic, kind, typestore=store) for topic in style.topics]
        names = [topic.rsplit("/", 1)[0] + "/camera_info" for topic in style.topics] if style.infos else []
        infos = [writer.add_connection(name, "sensor_msgs/msg/CameraInfo", typestore=store) for name in names]
        for time, pair in zip(drive.times, drive.pairs, strict=True):
            for side, connection in enumerate(images):
                header, arrived = _header(store, time + 0.001 * side), round((time + 0.03 + 0.001 * side) * 1e9)
                if infos:
                    writer.write(infos[side], arrived, _raw(store, style, _info(store, drive, side, header)))
                message = _image(store, pair[side], style.encoding, header)
                writer.write(connection, arrived, _raw(store, style, message))
    return path


def _raw(store: Any, style: BagStyle, message: Any) -> Any:
    if style.storage == "ros1":
        return store.serialize_ros1(message, message.__msgtype__)
    return store.serialize_cdr(message, message.__msgtype__)


def _header(store: Any, time: float) -> Any:
    nanoseconds = round(time * 1e9)
    stamp = store.types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return kind(stamp=stamp, frame_id="camera") if "seq" not in kind.__annotations__ else kind(0, stamp, "camera")


def _image(store: Any, grey: Image, encoding: str, header: Any) -> Any:
    if encoding == "png":
        data = np.frombuffer(cv2.imencode(".png", grey)[1].tobytes(), np.uint8)
        return store.types["sensor_msgs/msg/CompressedImage"](header, "png", data)
    values = ENCODED[encoding](grey)
    height, width = grey.shape
    row = values.nbytes // height
    padded = np.zeros((height, row + 4), np.uint8)  # rows may be longer than the image
    padded[:, :row] = np.frombuffer(values.tobytes(), np.uint8).reshape(height, row)
    return store.types["sensor_msgs/msg/Image"](header, height, width, encoding, 0, row + 4, padded.ravel())


ENCODED = {
    "mono8": lambda grey: grey,
    "mono16": lambda grey: grey.astype("<u2") << 8,
    "bgr8": lambda grey: cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR),
    "rgba8": lambda grey: cv2.cvtColor(grey, cv2.COLOR_GRAY2RGBA),
    "yuv422_yuy2": lambda grey: np.dstack([grey, np.full_like(grey, 128)]),
    "uyvy": lambda grey: np.dstack([np.full_like(grey, 128), grey]),
}


def _info(store: Any, drive: Taken, side: int, header: Any) -> Any:
    """CameraInfo as a calibration of the pair leaves it."""
    lens, ideal = (drive.rig.left, drive.rig.right)[side], drive.ideal
    R_view_left = ideal.T_camera_view[:3, :3].T
    R = (R_view_left, R_view_left @ drive.rig.T_left_right[:3, :3])[side]
    P = np.hstack([ideal.camera.K, np.zeros((3, 1))])
    P[0, 3] = -side * ideal.camera.fx * ideal.camera.baseline
    roi = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    model = {"radtan": "plumb_bob", "none": "plumb_bob"}.get(lens.distortion_model, lens.distortion_model)
    D = np.array(
        [*lens.coefficients, 0.0] if len(lens.coefficients) == 4 and model == "plumb_bob" else lens.coefficients
    )
    arrays = [np.asarray(a, np.float64).ravel() for a in (D, lens.K, R, P)]
    return store.types["sensor_msgs/msg/CameraInfo"](header, SIZE[1], SIZE[0], model, *arrays, 0, 0, roi)
