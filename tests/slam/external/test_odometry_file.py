"""The trajectory of another program gives the motions, or is refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from odometry.motion import Motion
from slam.datasets.dataset import Frame
from slam.errors import ConfigError, DataError
from slam.external.odometry_file import (
    EstimatedUncertainty,
    FileOdometry,
    FileTrajectory,
    StatedUncertainty,
    check_odometry_file,
    read_uncertainty,
)
from slam.io.trajectory_files import write_kitti, write_tum

TIMES = 0.1 * np.arange(30)
IMAGE = np.zeros((8, 8), np.uint8)


def trajectory(steps: int = 30, seed: int = 1) -> np.ndarray:
    """Poses of a curved way, the first the identity."""
    rng = np.random.default_rng(seed)
    poses = [np.eye(4)]
    for _ in range(steps - 1):
        poses.append(poses[-1] @ se3.exp(np.array([0.0, 0.03, 0.0, 0.0, 0.0, 0.8]) + 0.01 * rng.normal(size=6)))
    return np.array(poses)


class MeasuredMotions:
    """An odometry that measures given motions (a VisualOdometry)."""

    calibration = None

    def __init__(self, poses: np.ndarray, has_metric_scale: bool = True, lost: tuple[int, ...] = ()) -> None:
        self.poses, self.has_metric_scale, self.lost = poses, has_metric_scale, lost

    def track(self, frame: Frame) -> Motion:
        k = frame.index
        T = np.eye(4) if k == 0 else se3.inverse(self.poses[k - 1]) @ self.poses[k]
        lost = k in self.lost
        return Motion(T, (1e-2 if lost else 1e-6) * np.eye(6), lost, "lost" if lost else "")

    def disparity(self, left, right, pixels):
        return np.full(len(pixels), 8.0)

    def array_bytes(self) -> int:
        return 0

    def state(self) -> dict:
        return {}

    def restore(self, state: dict) -> None:
        pass


def frame(k: int, times: np.ndarray = TIMES) -> Frame:
    return Frame(k, float(times[k]), IMAGE, IMAGE)


def track_all(odometry: FileOdometry, times: np.ndarray = TIMES) -> list[Motion]:
    return [odometry.track(frame(k, times)) for k in range(len(times))]


def chain(motions: list[Motion]) -> np.ndarray:
    poses = [np.eye(4)]
    for motion in motions[1:]:
        poses.append(poses[-1] @ motion.T_previous_current)
    return np.array(poses)


@pytest.mark.parametrize("kind", ["tum", "kitti"])
def test_the_motions_are_those_of_the_file(tmp_path: Path, kind: str):
    poses, path = trajectory(), tmp_path / "poses.txt"
    write_tum(path, TIMES, poses) if kind == "tum" else write_kitti(path, poses)
    odometry = FileOdometry(FileTrajectory(path), MeasuredMotions(trajectory(seed=2)), EstimatedUncertainty())
    motions = track_all(odometry)
    assert not any(motion.predicted for motion in motions)
    np.testing.assert_allclose(chain(motions), poses, atol=1e-9)


def test_a_file_of_key_frames_is_interpolated_at_the_times_of_the_frames(tmp_path: Path):
    twist = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 1.0])
    poses, path = np.array([se3.exp(k * twist) for k in range(30)]), tmp_path / "keys.tum"
    write_tum(path, TIMES[::4], poses[::4])
    found = FileTrajectory(path)
    placed = [found.place(k, float(TIMES[k])) for k in range(29)]
    assert not any(place.reason for place in placed)
    np.testing.assert_allclose([place.T_world_camera for place in placed], poses[:29], atol=1e-9)


def test_frames_that_the_file_lost_are_bridged_and_flagged(tmp_path: Path):
    poses, path = trajectory(), tmp_path / "poses.tum"
    kept = np.r_[0:10, 18:28]  # nothing for 0.8 s, and nothing for the last two
    write_tum(path, TIMES[kept], poses[kept])
    motions = track_all(FileOdometry(FileTrajectory(path), MeasuredMotions(poses), EstimatedUncertainty()))
    assert [k for k, motion in enumerate(motions) if motion.predicted] == [*range(10, 18), 28, 29]
    assert "poses.tum has no pose for 0.9 s" in motions[12].reason
    assert np.trace(motions[17].covariance) > 50 * np.trace(motions[9].covariance)
    bridged = chain(motions)
    np.testing.assert_allclose(bridged[18:28], poses[18:28], atol=1e-9)  # a gap costs nothing behind it
    assert np.all(np.diff(bridged[9:19, 2, 3]) > 0.5)  # at constant velocity, not standing still


def test_without_differences_the_covariance_is_the_measured_one_and_it_grows_with_them():
    measured = Motion(np.eye(4), 1e-6 * np.eye(6), False, "")
    equal, differing, rng = EstimatedUncertainty(), EstimatedUncertainty(), np.random.default_rng(0)
    for k in range(200):
        same = equal.covariance(k, measured, np.eye(4))
        noise = np.repeat([0.002, 0.05], 3) * rng.normal(size=6) * (100.0 if k % 10 == 0 else 1.0)
        found = differing.covariance(k, measured, se3.exp(noise))
    np.testing.assert_array_equal(same, measured.covariance)
    sigmas = np.sqrt(np.diag(found))
    np.testing.assert_allclose(sigmas, np.repeat([0.002, 0.05], 3), rtol=0.4)  # whatever the tenth of outliers is


def test_where_the_odometry_here_is_lost_the_file_keeps_the_last_covariance():
    odometry = EstimatedUncertainty()
    known = Motion(np.eye(4), 1e-6 * np.eye(6), False, "")
    lost = Motion(np.eye(4), np.eye(6), True, "lost")
    odometry.covariance(1, known, np.eye(4))
    np.testing.assert_array_equal(odometry.covariance(2, lost, np.eye(4)), known.covariance)


def test_with_one_camera_depths_are_in_the_unit_of_the_file(tmp_path: Path):
    poses, path = trajectory(), tmp_path / "poses.txt"
    write_kitti(path, poses)
    halved = poses.copy()
    halved[:, :3, 3] *= 0.5
    odometry = FileOdometry(
        FileTrajectory(path), MeasuredMotions(halved, has_metric_scale=False), EstimatedUncertainty()
    )
    assert np.isnan(odometry.disparity(IMAGE, None, np.zeros((1, 2))))
    motions = track_all(odometry)
    # The file's metre is half a unit here: a disparity of 8 at depth z stands for 4 at depth 2 z.
    np.testing.assert_allclose(odometry.disparity(IMAGE, None, np.zeros((1, 2))), 4.0)
    np.testing.assert_allclose(motions[-1].covariance[3, 3], 4e-6, rtol=0.01)


def test_a_state_continues_with_the_same_bits(tmp_path: Path):
    path = tmp_path / "poses.tum"
    write_tum(path, TIMES, trajectory())
    whole, first, second = (
        FileOdometry(FileTrajectory(path), MeasuredMotions(trajectory(seed=2)), EstimatedUncertainty())
        for _ in range(3)
    )
    motions = track_all(whole)
    for k in range(15):
        first.track(frame(k))
    second.restore(first.state())
    for k in range(15, 30):
        motion = second.track(frame(k))
        np.testing.assert_array_equal(motion.T_previous_current, motions[k].T_previous_current)
        np.testing.assert_array_equal(motion.covariance, motions[k].covariance)


class FewFrames:
    """A dataset of which only the times matter."""

    def __init__(self, times: np.ndarray) -> None:
        self.timestamps = times

    def __len__(self) -> int:
        return len(self.timestamps)


def test_a_trajectory_of_another_length_or_another_time_is_refused(tmp_path: Path):
    path = tmp_path / "poses.txt"
    write_kitti(path, trajectory(29))
    with pytest.raises(DataError, match=r"poses\.txt: expected 30 poses, one for each frame, found 29; export"):
        check_odometry_file(path, "", FewFrames(TIMES))
    write_tum(path, TIMES + 5000.0, trajectory())
    with pytest.raises(DataError, match=r"expected poses between 0\.00 and 2\.90 s.*found 5000\.00 to 5002\.90 s"):
        check_odometry_file(path, "", FewFrames(TIMES))
    write_tum(path, TIMES, trajectory())
    assert check_odometry_file(path, "", FewFrames(TIMES)) == ()


def test_unsorted_and_unmeasured_lines_are_named_and_used(tmp_path: Path):
    path = tmp_path / "poses.tum"
    write_tum(path, TIMES, trajectory())
    lines = path.read_text().splitlines()
    lines[3], lines[20] = lines[20], lines[3]
    lines[10] = f"{TIMES[10]} nan nan nan nan nan nan nan"
    path.write_text("\n".join(lines) + "\n")
    remarks = check_odometry_file(path, "", FewFrames(TIMES))
    assert any("sorted by time" in remark for remark in remarks)
    assert any("without a pose" in remark for remark in remarks)


def test_covariances_are_stated_by_two_numbers_or_a_file(tmp_path: Path):
    stated = read_uncertainty("0.001,0.02")
    assert isinstance(stated, StatedUncertainty)
    motion = Motion(np.eye(4), np.eye(6), False, "")
    np.testing.assert_allclose(np.diag(stated.covariance(7, motion, np.eye(4))), [1e-6] * 3 + [4e-4] * 3)
    path = tmp_path / "sigmas.txt"
    path.write_text("# rotation first\n" + "".join(f"0.001 0.001 0.001 0.0{k} 0.02 0.02\n" for k in range(1, 4)))
    found = read_uncertainty(str(path))
    np.testing.assert_allclose(found.covariance(2, motion, np.eye(4))[3, 3], 0.03**2)
    matrix = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    path.write_text(",".join(map(str, matrix.ravel())))
    np.testing.assert_allclose(read_uncertainty(str(path)).covariance(0, motion, np.eye(4)), matrix)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3", r"line 1: expected 6 standard deviations or the 36 numbers .* found '1 2 3'"),
        ("0 0 0 1 1 1", r"line 1: expected a symmetric covariance of positive variances"),
        ("1 1 1 1 1 nan", r"line 1: expected 6 standard deviations"),
        ("# nothing", r"expected a line of 6 or 36 numbers for each frame, found none"),
    ],
)
def test_a_damaged_file_of_covariances_is_one_line(tmp_path: Path, text: str, message: str):
    path = tmp_path / "covariances.txt"
    path.write_text(text + "\n")
    with pytest.raises(DataError, match=message):
        read_uncertainty(str(path))


def test_covariances_of_another_drive_and_other_texts_are_refused(tmp_path: Path):
    poses, path = tmp_path / "poses.tum", tmp_path / "sigmas.txt"
    write_tum(poses, TIMES, trajectory())
    path.write_text("1 1 1 1 1 1\n" * 7)
    with pytest.raises(DataError, match="expected 30 covariances, one for each frame, found 7"):
        check_odometry_file(poses, str(path), FewFrames(TIMES))
    with pytest.raises(ConfigError, match=r"expected SIGMA_RAD,SIGMA_M .* found '0\.1;2'"):
        read_uncertainty("0.1;2")
