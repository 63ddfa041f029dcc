"""Every reader of a file that somebody else may have written; a new one is a line in `READERS`."""

import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from place_recognition.vocabulary.vocabulary import load_vocabulary
from slam.apps.train import read_similarities
from slam.benchmark.sweep_config import read_sweep
from slam.components import read_checked_config
from slam.datasets.dataset import Dataset
from slam.datasets.formats.image_sequence import read_grey, read_times
from slam.datasets.formats.registry import open_dataset
from slam.datasets.video import open_video
from slam.errors import DataError
from slam.evaluation.revisit_truth_files import read_revisit_truth
from slam.evaluation.traverse_truth_files import read_matrix
from slam.io.calibration import read_calibration
from slam.io.frames_and_loops_csv import read_events, read_frames, read_loops, read_stages
from slam.io.g2o import Graph, read_g2o
from slam.io.landmarks import read_cloud, read_landmark_observers
from slam.io.matches import read_matches
from slam.io.metrics import read_metrics
from slam.io.trajectory_reader import read_trajectory
from slam.simulation.scenario.vehicle_path import read_plan

from . import generation as made
from . import valid_files as valid
from . import valid_media as media
from .valid_maps import map_stores, read_map

Read = Callable[[Path], object]


def _nothing(root: Path) -> None:
    """No other file is needed."""


def _as_it_is(data: bytes) -> bytes:
    return data


@dataclass(frozen=True)
class Reader:
    """A reader, and what it is tried on.

    Attributes:
        file: path of the damaged file in the folder.
        read: reads the folder.
        seeds: valid files.
        generated: files that are put together from what such files hold.
        beside: writes what belongs beside the file.
        dressed: what becomes of an input before it is written, such as a checksum that is right.
        share: of all inputs, relative to the others.
    """

    file: str
    read: Read
    seeds: Callable[[], Sequence[bytes]]
    generated: st.SearchStrategy[bytes]
    beside: Callable[[Path], None] = _nothing
    dressed: Callable[[bytes], bytes] = _as_it_is
    share: float = 1.0


def _drive(root: Path) -> None:
    """Open a recording as a run does, and read what opening alone does not."""
    _check_drive(open_dataset(root))


def _check_drive(drive: Dataset) -> None:
    times, truth, camera = drive.timestamps, drive.ground_truth, drive.camera
    assert np.isfinite(times).all(), "accepted times that are not finite"
    assert (np.diff(times) > 0).all(), "accepted times that do not increase"
    assert truth is None or (np.isfinite(truth).all() and truth.shape == (len(drive), 4, 4)), "accepted a wrong truth"
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline)
    assert np.isfinite(numbers).all(), f"accepted a camera of {numbers}"
    assert min(camera.fx, camera.fy, camera.baseline) > 0, f"accepted a camera of {numbers}"
    frame = drive[0]
    assert frame.left.shape == (camera.height, camera.width), "gave an image of another size"
    assert (frame.depth is not None) == drive.has_depth, "depth is not what was promised"
    assert frame.depth is None or frame.depth.shape == frame.left.shape, "gave depth of another size"
    assert frame.depth is None or not (frame.depth <= 0).any(), "gave a depth that is none"
    assert frame.depth is None or not np.isinf(frame.depth).any(), "gave an infinite depth"


def _image(root: Path) -> None:
    image = read_grey(root / "a.png")
    assert image.ndim == 2, f"gave an image of shape {image.shape}"
    assert image.dtype == np.uint8, f"gave an image of {image.dtype}"


def _video(name: str) -> Read:
    def read(root: Path) -> None:
        video = open_video(root / name)
        assert np.isfinite(video.timestamps).all(), "accepted times that are not finite"
        assert (np.diff(video.timestamps) > 0).all(), "accepted times that do not increase"
        assert video[0].ndim == 2
        assert video[len(video) - 1].ndim == 2

    return read


def _trajectory(root: Path) -> None:
    trajectory = read_trajectory(root / "poses.txt")
    times, poses = trajectory.times, trajectory.poses
    assert np.isfinite(poses).all(), "accepted poses that are not finite"
    assert times is None or (np.isfinite(times).all() and (np.diff(times) > 0).all()), "accepted times out of order"


def _graph(root: Path) -> None:
    graph: Graph = read_g2o(root / "a.g2o")
    for name in ("poses", "motions", "information"):
        assert np.isfinite(getattr(graph, name)).all(), f"accepted {name} that are not finite"
    assert len(graph.information) == len(graph.motions) == len(graph.first)
    assert np.isin([graph.first, graph.second], graph.ids).all(), "accepted an edge to nowhere"


def _configuration(root: Path) -> None:
    read_checked_config(root / "a.toml")


def _vocabulary(root: Path) -> None:
    try:
        vocabulary = load_vocabulary(root / "a.vocabulary")
    except ValueError as error:  # place_recognition knows nothing of the family
        raise DataError(str(error)) from error
    assert np.isfinite(vocabulary.words).all(), "accepted words that are not finite"
    assert np.isfinite(vocabulary.weights).all(), "accepted weights that are not finite"


def _with_checksum(data: bytes) -> bytes:
    body = data[: -sha256().digest_size]
    return body + sha256(body).digest()


def _zipped(name: str) -> Callable[[bytes], bytes]:
    """An input as the array of a name in a sound `.npz`."""

    def dressed(data: bytes) -> bytes:
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(f"{name}.npy", data)
        return file.getvalue()

    return dressed


def _truth(name: str) -> Read:
    def read(root: Path) -> None:
        matrix = read_revisit_truth(root / name).required_matrix
        assert matrix.dtype == bool, f"gave a truth of {matrix.dtype}"
        assert matrix.shape == matrix.shape[::-1]

    return read


def _truth_of_two(name: str) -> Read:
    def read(root: Path) -> None:
        truth = read_matrix(root / name, (4, 4))
        assert truth.hard.dtype == bool, f"gave a truth of {truth.hard.dtype}"
        assert truth.hard.shape == (4, 4), f"gave a truth of {truth.hard.shape}"

    return read


def _bag(suffix: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [media.bags()[suffix]]


def _beside_ros2(suffix: str) -> Callable[[Path], None]:
    """A ROS 2 bag as a folder: the file of messages, and what describes it."""

    def beside(root: Path) -> None:
        (root / f"drive{suffix}").write_bytes(media.bags()[suffix])
        (root / "metadata.yaml").write_bytes(media.bags()[f"{suffix}.yaml"])

    return beside


def _table(name: str, read: Callable[[Path], object]) -> Reader:
    rows = made.tables(valid_header(name))
    return Reader(name, lambda root: read(root / name), lambda: [valid.tables()[name]], rows, share=2)


@cache
def valid_header(name: str) -> str:
    return valid.tables()[name].decode().splitlines()[0]


def _at(name: str, read: Callable[[Path], object]) -> Read:
    return lambda root: read(root / name)


_STATE = "mav0/state_groundtruth_estimate0/data.csv"
_MESSAGES = st.binary(max_size=300)

READERS: dict[str, Reader] = {
    "KITTI calibration": Reader(
        "sequences/07/calib.txt", _drive, lambda: [valid.CALIB], made.calibrations(), valid.kitti, share=2
    ),
    "KITTI times": Reader("times.txt", lambda root: read_times(root / "times.txt", 3), lambda: [b"0\n0.1\n2e-1\n"],
        made.tables("", " ", 1), share=3),
    "KITTI poses": Reader("poses/07.txt", _drive, lambda: [valid.poses_kitti()], made.tables("", " ", 12), valid.kitti,
        share=2),
    "trajectories, KITTI or TUM": Reader("poses.txt", _trajectory, lambda: [valid.poses_kitti(), valid.poses_tum()],
        made.tables("# t tx ty tz qx qy qz qw", " ", 8), share=4),
    "TUM rgb.txt": Reader("rgb.txt", _drive, lambda: [valid.RGB], made.tables("# t file", " ", 2, ("rgb/0.png",)),
        valid.tum_rgbd),
    "TUM depth.txt": Reader("depth.txt", _drive, lambda: [valid.DEPTH],
        made.tables("# t file", " ", 2, ("depth/0.png",)), valid.depth_camera),
    "associations.txt": Reader("associations.txt", _drive, lambda: [valid.ASSOCIATIONS],
        made.tables("#", " ", 4, ("depth/0.png", "rgb/0.png")), valid.icl_nuim),
    "ICL-NUIM poses": Reader("traj0.gt.freiburg", _drive, lambda: [valid.poses_tum()], made.tables("#", " ", 8),
        valid.icl_nuim_with_list),
    "depth images": Reader("depth/0.png", _drive, media.depth_files, made.files_of(*made.IMAGE_MARKS),
        valid.depth_camera, share=2),
    "depth as .npy": Reader("depth/0.npy", _drive, lambda: valid.array_files(valid.METRES), made.array_files(),
        valid.depth_arrays),
    "bag, depth": Reader("d.bag", _at("d.bag", lambda p: _check_drive(open_dataset(p))), lambda: [media.depth_bag()],
        _MESSAGES, share=0.3),
    "TUM groundtruth.txt": Reader("groundtruth.txt", _drive, lambda: [valid.poses_tum()], made.tables("#", " ", 8),
        valid.tum_rgbd),
    "EuRoC data.csv": Reader("mav0/cam0/data.csv", _drive, lambda: [valid.EUROC_LIST],
        made.tables("#timestamp [ns],filename", ",", 2, ("0.png", "1.png")), valid.euroc),
    "EuRoC ground truth": Reader(_STATE, _drive, lambda: [valid.EUROC_TRUTH], made.tables("#", ",", 8), valid.euroc),
    "EuRoC sensor.yaml": Reader("mav0/cam1/sensor.yaml", _drive,
        lambda: [valid.SENSOR.format(x=0.1).replace("1, 0, 0, 0, 0", "1, 0, 0, 0.1, 0").encode()],
        made.sensors(), valid.euroc),
    "camera.toml": Reader("camera.toml", _drive, valid.camera_files, made.camera_files(), valid.own_camera, share=2),
    "calibration in YAML": Reader("calibration.yaml", _drive, valid.yaml_calibrations,
        made.files_of(b"%YAML:1.0\n---\n", b"cam0:\n"), valid.own_camera_without_calibration, share=3),
    "KITTI raw calibration": Reader("2011_09_30/calib_cam_to_cam.txt", _drive, lambda: [valid.RAW_CALIB],
        made.calibrations(), valid.kitti_raw, share=2),
    "KITTI raw times": Reader("2011_09_30/2011_09_30_drive_0001_sync/image_00/timestamps.txt", _drive,
        lambda: [valid.RAW_TIMES], made.tables("", " ", 2), valid.kitti_raw),
    "images": Reader("a.png", _image, media.image_files, made.files_of(*made.IMAGE_MARKS), share=6),
    "video, AVI": Reader("v.avi", _video("v.avi"), lambda: media.video_files()[:1], _MESSAGES, share=0.15),
    "video, MP4": Reader("v.mp4", _video("v.mp4"), lambda: media.video_files()[1:2], _MESSAGES, share=0.15),
    "video, Matroska": Reader("v.mkv", _video("v.mkv"), lambda: media.video_files()[2:], _MESSAGES, share=0.15),
    "bag, ROS 1": Reader("d.bag", _at("d.bag", lambda p: _check_drive(open_dataset(p))), _bag(".bag"), _MESSAGES,
        share=0.3),
    "bag, ROS 2": Reader("drive.db3", _drive, _bag(".db3"), _MESSAGES, _beside_ros2(".db3"), share=0.15),
    "bag, MCAP": Reader("drive.mcap", _drive, _bag(".mcap"), _MESSAGES, _beside_ros2(".mcap"), share=0.3),
    "bag, metadata.yaml": Reader("metadata.yaml", _drive, _bag(".mcap.yaml"), _MESSAGES, _beside_ros2(".mcap"),
        share=0.15),
    "g2o": Reader("a.g2o", _graph, valid.graphs, made.graphs(), share=5),
    "configuration": Reader("a.toml", _configuration, valid.configurations, made.configurations(), share=1.5),
    "benchmark": Reader("b.toml", _at("b.toml", read_sweep), lambda: [valid.SWEEP], made.sweeps(), share=3),
    "vocabulary": Reader("a.vocabulary", _vocabulary, valid.vocabularies, made.vocabularies(), share=2),
    "vocabulary, checksum right": Reader("a.vocabulary", _vocabulary, valid.vocabularies, made.vocabularies(),
        dressed=_with_checksum, share=3),
    "truth, MATLAB": Reader("t.mat", _truth("t.mat"), valid.matlab_files, made.files_of(b"MATLAB 5.0 MAT-file"),
        share=0.05),  # each costs the start of a process
    "truth, .npz": Reader("t.npz", _truth("t.npz"), lambda: valid.arrays("truth", valid.TRUTH),
        made.files_of(b"PK\x03\x04"), share=2),
    "truth, array in .npz": Reader("t.npz", _truth("t.npz"), lambda: valid.array_files(valid.TRUTH, valid.TRUTH > 0),
        made.array_files(), dressed=_zipped("truth"), share=3),
    "truth of two, MATLAB": Reader("t.mat", _truth_of_two("t.mat"), valid.matlab_files,
        made.files_of(b"MATLAB 5.0 MAT-file"), share=0.05),
    "truth of two, .npz": Reader("t.npz", _truth_of_two("t.npz"), lambda: valid.arrays("truth", valid.TRUTH),
        made.files_of(b"PK\x03\x04"), share=2),
    "truth of two, array in .npz": Reader("t.npz", _truth_of_two("t.npz"),
        lambda: valid.array_files(valid.TRUTH, valid.TRUTH > 0), made.array_files(), dressed=_zipped("GThard"),
        share=3),
    "matrix.npz": Reader("m.npz", _at("m.npz", read_similarities), lambda: valid.arrays("similarity", valid.TRUTH / 2),
        made.files_of(b"PK\x03\x04"), share=2),
    "array in matrix.npz": Reader("m.npz", _at("m.npz", read_similarities), lambda: valid.array_files(valid.TRUTH / 2),
        made.array_files(), dressed=_zipped("similarity"), share=2),
    "landmarks.npz": Reader("l.npz", _at("l.npz", read_landmark_observers), valid.observers,
        made.files_of(b"PK\x03\x04")),
    "frames.csv": _table("frames.csv", read_frames),
    "loops.csv": _table("loops.csv", read_loops),
    "loop_events.csv": _table("loop_events.csv", read_events),
    "loop_stages.csv": _table("loop_stages.csv", read_stages),
    "matches.csv": _table("matches.csv", read_matches),
    "metrics.json": Reader("metrics.json", _at("metrics.json", read_metrics),
        lambda: [valid.tables()["metrics.json"]], made.json_texts(), share=3),
    "calibration.toml": Reader("calibration.toml", _at("calibration.toml", read_calibration),
        lambda: [valid.calibration()], made.calibration_files(), share=1.5),
    "PLY": Reader("a.ply", _at("a.ply", read_cloud), valid.clouds, made.files_of(b"ply\nformat "), share=2),
    "map database": Reader("map.db", _at("map.db", read_map), map_stores,
        made.files_of(b"SQLite format 3\x00"), share=3),
    "path to simulate": Reader("plan.txt", _at("plan.txt", read_plan), lambda: [valid.poses_kitti()],
        made.tables("", " ", 12), share=2),
}  # fmt: skip
