import numpy as np
import pytest
import rerun as rr

from odometry import se3
from slam.viewer.rerun_archetypes import GrowingEntity, MovableLandmarks


class Log:
    """Stands for a recording: remembers what is shown now, and how many rows were ever sent."""

    def __init__(self):
        self.shown, self.sent = {}, 0

    def log(self, path, what):
        if isinstance(what, rr.Clear):
            self.shown.pop(path, None)
        else:
            self.shown[path] = what
            self.sent += len(what)

    def rows(self):
        return {tuple(row) for what in self.shown.values() for row in what}


def line(frames):
    return np.stack([np.arange(frames), np.zeros(frames), np.zeros(frames)], axis=1).astype(float)


@pytest.fixture
def log():
    return Log()


@pytest.fixture
def growing(log):
    return GrowingEntity(log, "line", lambda rows: rows, max_rows=10)


def test_all_rows_are_shown_at_any_time(log, growing):
    for count, row in enumerate(line(57), start=1):
        growing.append(row[None])
        assert len(log.rows()) == count


def test_parts_share_their_ends_so_that_a_line_has_no_gap(log, growing):
    for row in line(25):
        growing.append(row[None])
    np.testing.assert_array_equal(log.shown["line/part_000"][-1], log.shown["line/part_001"][0])


def test_what_is_sent_grows_with_the_rows_and_not_with_their_square(log, growing):
    for row in line(1000):
        growing.append(row[None])
    assert log.sent < 1000 * 10


def test_a_replaced_line_is_shown_instead_and_grows_on(log, growing):
    for row in line(35):
        growing.append(row[None])
    growing.replace(line(35) + 100.0)
    growing.append(np.array([[135.0, 100.0, 100.0]]))
    assert min(row[0] for row in log.rows()) == 100.0
    assert len(log.rows()) == 36


def test_a_long_replaced_line_is_thinned_but_keeps_its_ends(log, growing):
    growing.replace(line(5000))
    shown = log.shown["line/part_000"]
    assert len(shown) <= 1001
    assert shown[0, 0] == 0
    assert shown[-1, 0] == 4999


def test_a_concluded_line_is_whole_under_its_own_path(log, growing):
    for row in line(35):
        growing.append(row[None])
    growing.conclude(line(40))
    assert list(log.shown) == ["line"]
    assert len(log.shown["line"]) == 40


def drive(frames):
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 2, 3] = np.arange(frames)
    return poses


def test_landmarks_move_with_their_key_frames_once_a_loop_moves_these_noticeably(log, growing):
    poses, seen = drive(101), np.array([[2.0, 0.0, 5.0]])  # in the camera frame
    landmarks = MovableLandmarks(growing)
    for frame in (10, 60):
        landmarks.append(frame, poses[frame], se3.transform(poses[frame], seen))
    assert log.rows() == {(2.0, 0.0, 15.0), (2.0, 0.0, 65.0)}
    turned = poses @ se3.exp(np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0]))
    turned[60, 0, 3] = 1.9  # less than a fiftieth of the 100 m
    landmarks.correct(turned)
    assert log.rows() == {(2.0, 0.0, 15.0), (2.0, 0.0, 65.0)}
    turned[60, 0, 3] = 2.1
    landmarks.correct(turned)
    corrected = np.concatenate([se3.transform(turned[frame], seen) for frame in (10, 60)])
    assert {tuple(np.round(row, 9)) for row in log.rows()} == {tuple(np.round(row, 9)) for row in corrected}
