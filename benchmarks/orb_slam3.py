"""ORB-SLAM3 on a stereo drive, by the wheel `pyorbslam3`: a peer to measure, GPL-3, in an environment of its own.

    python benchmarks/orb_slam3.py LEFT RIGHT CALIB TIMES OUT --vocabulary FILE

The first arguments are those of every program that `peers.py` runs; it makes the environment and the vocabulary. The
settings are those that ORB-SLAM3 gives for KITTI and, for images of less than half a megapixel, for EuRoC. Images are
given at the rate of TIMES, as in ORB-SLAM3's own examples: its mapping runs beside the tracking and must keep up.
`odometry.txt` chains the motions as they were tracked, without the jumps of closed loops: near a change of the map they
are those of the final map (this build crashes with loop closing switched off). `corrected.txt` holds the final map. A
frame that was not tracked has the pose of the one before it.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from peer_contract import StereoDrive, make_parser, take_drive

Array = NDArray[np.float64]

# A loop moves the map in another thread, and ORB-SLAM3 says so when it has ended: the jump was seen up to two frames
# before that. Motions in the final map have no jump, and of a few frames hardly anything else of the loop.
CHANGE_REACH_FRAMES = 5
MIN_LARGE_IMAGE = 400_000  # pixels; KITTI's images have 467,000, EuRoC's 361,000
SETTINGS = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: {fx}
Camera.fy: {fy}
Camera.cx: {cx}
Camera.cy: {cy}
Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}
Camera.bf: {bf}
Camera.RGB: 1
ThDepth: 35.0
ORBextractor.nFeatures: {features}
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def write_settings(path: Path, drive: StereoDrive, frame_s: float) -> None:
    """Write ORB-SLAM3's settings of a drive whose pairs are some seconds apart."""
    P_left, P_right = drive.read_projections()
    left, _ = next(drive.read_pairs())
    (height, width), features = left.shape, 2000 if left.size > MIN_LARGE_IMAGE else 1200
    intrinsics = {"fx": P_left[0, 0], "fy": P_left[1, 1], "cx": P_left[0, 2], "cy": P_left[1, 2]}
    numbers = intrinsics | {"bf": P_left[0, 3] - P_right[0, 3], "fps": 1 / frame_s}
    texts = {name: repr(float(value)) for name, value in numbers.items()}  # reals must have a point
    path.write_text(SETTINGS.format(width=width, height=height, features=features, **texts))


@dataclass(frozen=True)
class TrackedFrame:
    """What ORB-SLAM3 answered about a frame.

    Attributes:
        pose: T_first_camera (4, 4); None where it was lost.
        map_changed: whether a loop, or the adjustment after one, has moved the map since the frame before.
        spent_ms: time of the call.
    """

    pose: Array | None
    map_changed: bool
    spent_ms: float


def track(slam: Any, drive: StereoDrive) -> list[TrackedFrame]:
    """Track all pairs at the rate of the drive."""
    times, frames = drive.read_times(), []
    pauses_s = np.diff(times, append=times[-1])
    for (left, right), seconds, pause_s in zip(drive.read_pairs(), times, pauses_s, strict=True):
        start = time.perf_counter()
        result = slam.track_stereo(left, right, float(seconds))
        spent_s = time.perf_counter() - start
        pose = np.array(result.pose_wc) if result.pose_valid else None
        frames.append(TrackedFrame(pose, bool(slam.map_changed()), 1e3 * spent_s))
        time.sleep(max(0.0, pause_s - spent_s))
    return frames


def chain(frames: list[TrackedFrame], final: list[Array]) -> list[Array]:
    """Chain the motions as they were tracked; near a change of the map, those of the final poses."""
    changed = np.flatnonzero([frame.map_changed for frame in frames])
    tracked = fill([frame.pose for frame in frames])
    chained = tracked[:1]
    for index in range(1, len(frames)):
        is_near = np.any(np.abs(changed - index) <= CHANGE_REACH_FRAMES)
        poses = final if is_near else tracked
        chained.append(chained[-1] @ np.linalg.inv(poses[index - 1]) @ poses[index])
    return chained


def fill(poses: list[Array | None]) -> list[Array]:
    """Give each missing pose that of the frame before it."""
    filled = [np.eye(4)]
    for pose in poses:
        filled.append(filled[-1] if pose is None else pose)
    return filled[1:]


def read_final(path: Path, times: Array) -> list[Array | None]:
    """Read the trajectory of the map (TUM format): the pose at each time, None where there is none."""
    rows = np.loadtxt(path, ndmin=2)
    found: list[Array | None] = []
    for seconds in times:
        near = np.flatnonzero(np.abs(rows[:, 0] - seconds) < 1e-3) if rows.size else ()
        found.append(_matrix(rows[near[0], 1:]) if len(near) else None)
    return found


def _matrix(row: Array) -> Array:
    """Return the pose (4, 4) of a position and a quaternion (x, y, z, w)."""
    x, y, z, w = row[3:] / np.linalg.norm(row[3:])
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = row[:3]
    return pose


def run(drive: StereoDrive, vocabulary: Path) -> None:
    """Run ORB-SLAM3 and write its results."""
    import pyorbslam3

    times, settings = drive.read_times(), drive.out / "settings.yaml"
    write_settings(settings, drive, float(np.median(np.diff(times))) if len(times) > 1 else 0.1)
    slam = pyorbslam3.Slam(vocabulary, settings, pyorbslam3.Sensor.STEREO)
    frames = track(slam, drive)
    slam.shutdown()
    slam.save_trajectory_tum(str(drive.out / "final.tum"))
    final = fill(read_final(drive.out / "final.tum", times))
    drive.write_poses("odometry.txt", chain(frames, final))
    drive.write_poses("corrected.txt", final)
    np.savetxt(drive.out / "milliseconds.txt", [frame.spent_ms for frame in frames], fmt="%.3f")
    lost = sum(frame.pose is None for frame in frames)
    if lost:
        (drive.out / "remark.txt").write_text(f"{lost} of {len(frames)} frames were not tracked\n")


if __name__ == "__main__":
    parser = make_parser(__doc__)
    parser.add_argument("--vocabulary", type=Path, required=True)
    given = parser.parse_args()
    run(take_drive(given), given.vocabulary)
