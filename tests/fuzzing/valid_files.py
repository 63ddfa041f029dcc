"""Small valid files of every kind that is read, and the recordings that they belong to."""

import io
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from scipy.io import savemat

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.vocabulary.vocabulary import FlatVocabulary, Vocabulary, save_vocabulary
from place_recognition.vocabulary.vocabulary_tree import VocabularyTree
from slam.config import RunConfig, to_toml
from slam.io.calibration import write_calibration
from slam.io.frames_and_loops_csv import FrameTable, write_events, write_frames, write_loops, write_stages
from slam.io.landmarks import write_cloud, write_landmark_observers
from slam.io.trajectory_files import write_kitti, write_tum
from slam.run_result import PointCloud

from ..slam.report import fabricate
from .valid_media import IMAGE, SIZE, written

TIMES = np.array([0.0, 0.1, 0.2])
POSES = np.stack([se3.exp(np.array([0.01, 0.02 * k, 0.0, 0.1, 0.0, 1.0 * k])) for k in range(3)])
CALIB = "".join(f"P{k}: 10 0 8 {-5.0 * (k % 2)} 0 10 6 0 0 0 1 0\n" for k in range(4)).encode()
RAW_CALIB = "".join(f"S_rect_0{k}: 16 12\nP_rect_0{k}: 10 0 8 {-5.0 * k} 0 10 6 0 0 0 1 0\n" for k in range(2)).encode()
RAW_TIMES = b"".join(b"2011-09-30 12:40:25.%d00000000\n" % k for k in range(3))
CAMERA = "fx = 10\nfy = 10\ncx = 7.5\ncy = 5.5\n"
SENSOR = """T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, {x}, 1, 0, 0, 0, 0, 0, 1, 0.5, 0, 0, 0, 1]
resolution: [16, 12]
intrinsics: [20, 20.5, 7.5, 5.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.02, 0.01, 0.0002, 0.00002]
"""


def images(folder: Path, names: tuple[str, ...]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / name), IMAGE)


def kitti(root: Path) -> None:
    """`sequences/07` with its times and poses; the calibration is left to be written."""
    sequence = root / "sequences" / "07"
    for camera in (0, 1):
        images(sequence / f"image_{camera}", tuple(f"{k:06d}.png" for k in range(3)))
    (sequence / "calib.txt").write_bytes(CALIB)
    (sequence / "times.txt").write_text("0\n0.1\n0.2\n")
    (root / "poses").mkdir(exist_ok=True)
    write_kitti(root / "poses" / "07.txt", POSES)


def tum_rgbd(root: Path) -> None:
    images(root / "rgb", ("0.png", "1.png", "2.png"))
    (root / "rgb.txt").write_bytes(RGB)
    (root / "camera.toml").write_text(CAMERA)
    write_tum(root / "groundtruth.txt", TIMES, POSES)


def depth_camera(root: Path) -> None:
    """A sequence of TUM RGB-D whose depth images have no list."""
    tum_rgbd(root)
    (root / "depth").mkdir(exist_ok=True)
    for k in range(3):
        cv2.imwrite(str(root / f"depth/{k}.png"), IMAGE.astype(np.uint16) * 40)


def icl_nuim(root: Path) -> None:
    """A sequence of ICL-NUIM; the list is left to be written."""
    depth_camera(root)
    for name in ("rgb.txt", "camera.toml", "groundtruth.txt"):
        (root / name).unlink()
    write_tum(root / "traj0.gt.freiburg", np.arange(3.0), POSES)


def icl_nuim_with_list(root: Path) -> None:
    icl_nuim(root)
    (root / "associations.txt").write_bytes(ASSOCIATIONS)


def depth_arrays(root: Path) -> None:
    """A camera.toml that names a folder of arrays."""
    images(root / "rgb", ("0.png", "1.png", "2.png"))
    (root / "depth").mkdir(exist_ok=True)
    for k, data in enumerate(array_files(*[METRES] * 3)):
        (root / f"depth/{k}.npy").write_bytes(data)
    (root / "camera.toml").write_text(f'{CAMERA}fps = 10\nleft = "rgb"\ndepth = "depth"\n')


METRES = IMAGE.astype(np.float32) / 100
DEPTH = b"# timestamp filename\n0.0 depth/0.png\n0.1 depth/1.png\n0.2 depth/2.png\n"
ASSOCIATIONS = b"".join(b"%d depth/%d.png %d rgb/%d.png\n" % (k, k, k, k) for k in range(3))
RGB = b"# timestamp filename\n0.0 rgb/0.png\n0.1 rgb/1.png\n0.2 rgb/2.png\n"
EUROC_LIST = b"#timestamp [ns],filename\n100000000,0.png\r\n200000000,1.png\r\n300000000,2.png\r\n"


def euroc(root: Path) -> None:
    for side in (0, 1):
        camera = root / "mav0" / f"cam{side}"
        images(camera / "data", ("0.png", "1.png", "2.png"))
        (camera / "data.csv").write_bytes(EUROC_LIST)
        (camera / "sensor.yaml").write_text(SENSOR.format(x=0.1))
    # the right camera sits along the left one's x axis, which is the body's y
    (root / "mav0" / "cam1" / "sensor.yaml").write_text(
        SENSOR.format(x=0.1).replace("1, 0, 0, 0, 0", "1, 0, 0, 0.1, 0")
    )
    truth = root / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir(exist_ok=True)
    (truth / "data.csv").write_bytes(EUROC_TRUTH)


EUROC_TRUTH = "\n".join(
    ["#timestamp, p_RS_R_x [m], ..."] + [f"{k}00000000,{k}.5,0,0,1,0,0.01,0" for k in range(5)]
).encode()


def own_camera(root: Path) -> None:
    images(root / "left", ("1.png", "2.png", "3.png"))
    images(root / "right", ("1.png", "2.png", "3.png"))
    write_tum(root / "poses.tum", TIMES, POSES)


def kitti_raw(root: Path) -> None:
    """A drive of KITTI's raw data; the calibration is left to be written."""
    day = root / "2011_09_30"
    for camera in ("00", "01"):
        folder = day / "2011_09_30_drive_0001_sync" / f"image_{camera}"
        images(folder / "data", tuple(f"{k:010d}.png" for k in range(3)))
        (folder / "timestamps.txt").write_bytes(RAW_TIMES)
    (day / "calib_cam_to_cam.txt").write_bytes(RAW_CALIB)


def own_camera_without_calibration(root: Path) -> None:
    own_camera(root)
    (root / "camera.toml").write_text("fps = 10\n")


def yaml_calibrations() -> list[bytes]:
    """Calibrations of Kalibr, OpenCV and ORB-SLAM for the images of `own_camera`."""
    cameras = (
        f"cam{k}:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0.01, 0.0, 0.0, 0.0]\n"
        "  intrinsics: [10, 10, 7.5, 5.5]\n  resolution: [16, 12]\n"
        for k in range(2)
    )
    motion = "  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n"
    K = "!!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n  data: [10, 0, 7.5, 0, 10, 5.5, 0, 0, 1]\n"
    D = "!!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n  data: [0.01, 0, 0, 0, 0]\n"
    R = "!!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    T = "!!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n  data: [-0.1, 0, 0]\n"
    opencv = f"%YAML:1.0\n---\nM1: {K}D1: {D}M2: {K}D2: {D}R: {R}T: {T}"
    intrinsics = "Camera.fx: 10\nCamera.fy: 10\nCamera.cx: 7.5\nCamera.cy: 5.5\nCamera.bf: 5.0\n"
    orb = f"%YAML:1.0\n---\n{intrinsics}Camera.fps: 10\n"
    return [text.encode() for text in ("".join(cameras) + motion, opencv, orb)]


def camera_files() -> list[bytes]:
    lens = 'model = "radtan"\ndistortion = [-0.02, 0.01, 0.0002, 0.00002]\n'
    right = f"[right_camera]\n{CAMERA}T_left_right = [[1,0,0,0.1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n"
    rest = 'left = "left"\nright = "right"\nground_truth = "poses.tum"\n'
    fisheye = 'model = "equidistant"\ndistortion = [0.01, 0.002, 0, 0]\n'
    texts = (
        f"{CAMERA}fps = 10\n",
        f"{CAMERA}baseline = 0.5\nfps = 10\n{lens}{rest}",
        f"{CAMERA}fps = 10\n{fisheye}",
        f"{CAMERA}fps = 10\n{lens}{right}{lens}",
        f'{CAMERA}fps = 10\nleft = "left"\ndepth = "right"\ndepth_scale = 1000\n',
    )
    return [text.encode() for text in texts]


def graphs() -> list[bytes]:
    space = " ".join(str(float(i == j)) for i in range(6) for j in range(i, 6))
    return [
        b"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nEDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\nFIX 0\n",
        f"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {space}\n"
        f"EDGE_SE3:QUAT 1 0 -1 0 0 0 0 0 1 {space}\nFIX 0\n".encode(),
        b"# only edges\nEDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0.1 2 0 0 2 0 0\n",
    ]


def poses_kitti() -> bytes:
    return written("a.txt", lambda path: write_kitti(path, POSES))


def poses_tum() -> bytes:
    return b"# t tx ty tz qx qy qz qw\n" + written("a.tum", lambda path: write_tum(path, TIMES, POSES))


@cache
def tables() -> dict[str, bytes]:
    record = fabricate.record(4)
    few = FrameTable(
        TIMES, np.array([False, True, False]), ("", "too few", ""), np.array([9, 0, 8]), np.array([10, 2, 10]),
        np.array([0.3, np.nan, 0.4]), {"track": np.array([1.0, 2.0, np.nan])},
    )  # fmt: skip
    return {
        "frames.csv": written("a.csv", lambda path: write_frames(path, few)),
        "loops.csv": written("a.csv", lambda path: write_loops(path, record.loops[:3])),
        "loop_events.csv": written("a.csv", lambda path: write_events(path, record.events[:3])),
        "loop_stages.csv": written("a.csv", lambda path: write_stages(path, record.stages[:3])),
        "matches.csv": b"query,match,score,accepted,inliers,verified,probability,candidates,own_score,geometry_match,"
        b"geometry_score,answered_at\n5,,0.0,false,,true,,,,,,\n6,1,0.75,true,30,true,0.5,1 0,2.5,1,9.5,8\n",
        "metrics.json": b'{"schema": 1, "frames": 4, "odometry": {"ate_m": 0.5, "t_rel": null}, "notes": {"a": "b"}}',
    }


def calibration() -> bytes:
    from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig

    learned = Calibration.unknown(StereoCamera(10, 10, 8, 6, 0.5, *SIZE), CalibrationConfig())
    return written("a.toml", lambda path: write_calibration(path, learned))


def configurations() -> list[bytes]:
    return [to_toml(RunConfig()).encode(), b'seed = 7\nparadigm = "dynamic-sequences"\n[pose_graph]\n']


SWEEP = b"""paradigms = ["tracked-words", "dynamic-sequences"]
robust = ["pcm+gnc"]
seeds = [0, 1]
[[sources]]
path = "data/kitti"
sequence = "05"
[[sources]]
simulate = "blocks"
laps = 2
length_m = 300
"""


def vocabularies() -> list[bytes]:
    words = np.array([[0.6, 0.8, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]], np.float32)
    signs = np.where(words > 0, 0.5, -0.5).astype(np.float32)
    kinds = (("surf-upright-64", words), ("orb", signs))
    made: list[Vocabulary] = [FlatVocabulary(kind, rows, rows[:, 0] + 1) for kind, rows in kinds]
    centers, children = np.array([[0], [15], [240]], np.uint8), np.array([2, 0, 0], np.uint8)
    made.append(VocabularyTree("brief", 8, centers, children, np.ones(2, np.float32)))
    return [written("a.vocabulary", lambda path, v=vocabulary: save_vocabulary(path, v)) for vocabulary in made]


TRUTH = np.tril(np.ones((4, 4), np.uint8), -2)


def matlab_files() -> list[bytes]:
    from scipy.sparse import csc_matrix

    out = []
    for value in (TRUTH, TRUTH.astype(float), csc_matrix(TRUTH.astype(float))):
        for compressed in (False, True):
            file = io.BytesIO()
            savemat(file, {"truth": value}, do_compression=compressed)
            out.append(file.getvalue())
    return out


def arrays(name: str, value: np.ndarray) -> list[bytes]:
    """`.npz` files with one array."""
    plain, small = io.BytesIO(), io.BytesIO()
    np.savez(plain, **{name: value})
    np.savez_compressed(small, **{name: value})
    return [plain.getvalue(), small.getvalue()]


def observers() -> list[bytes]:
    camera = StereoCamera(10, 10, 8, 6, 0.5, *SIZE)
    return [written("a.npz", lambda path: write_landmark_observers(path, np.array([0, 0, 2], np.int32), camera))]


def array_files(*values: np.ndarray) -> list[bytes]:
    """`.npy` files, as they lie within `.npz` ones."""
    out = []
    for value in values:
        file = io.BytesIO()
        np.save(file, value)
        out.append(file.getvalue())
    return out


def clouds() -> list[bytes]:
    cloud = PointCloud(np.array([[0.0, 1, 2], [3, 4, 5]]), np.array([10, 200], np.uint8))
    text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"
    return [written("a.ply", lambda path: write_cloud(path, cloud)), text]


def toml(values: dict[str, object]) -> bytes:
    return tomli_w.dumps(values).encode("utf-8", "surrogatepass")
