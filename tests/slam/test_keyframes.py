"""Key frames come after a metre or ten degrees."""

import numpy as np
import pytest

from odometry import se3
from slam.keyframes import KeyFrameConfig, KeyFrameSelector


def moved(z: float, degrees: float = 0.0) -> np.ndarray:
    return se3.pose(se3.exp(np.array([0, np.radians(degrees), 0, 0, 0, 0]))[:3, :3], np.array([0.0, 0.0, z]))


def test_the_first_frame_is_a_key_frame() -> None:
    assert KeyFrameSelector().accepts(moved(7.0))


@pytest.mark.parametrize(
    ("pose", "accepted"),
    [
        (moved(0.0), False),
        (moved(0.99), False),
        (moved(1.01), True),
        (moved(0, 9.9), False),
        (moved(0, 10.1), True),
    ],
)
def test_moving_or_turning_enough_makes_a_key_frame(pose: np.ndarray, accepted: bool) -> None:
    selector = KeyFrameSelector()
    selector.accepts(np.eye(4))
    assert selector.accepts(pose) is accepted


def test_distance_counts_from_the_last_key_frame() -> None:
    selector = KeyFrameSelector()
    accepted = [z for z in np.arange(0.0, 5.0, 0.3) if selector.accepts(moved(z))]
    np.testing.assert_allclose(accepted, [0.0, 1.2, 2.4, 3.6, 4.8])


def test_the_world_frame_does_not_matter() -> None:
    drive = [moved(z, 3 * z) for z in np.arange(0.0, 20.0, 0.3)]
    T = se3.exp(np.array([0.3, 0.2, 0.9, 4.0, 5.0, 6.0]))
    one, other = KeyFrameSelector(), KeyFrameSelector()
    assert [one.accepts(pose) for pose in drive] == [other.accepts(T @ pose) for pose in drive]


def test_a_pose_changed_later_by_the_caller_has_no_effect() -> None:
    selector, pose = KeyFrameSelector(), np.eye(4)
    selector.accepts(pose)
    pose[2, 3] = 5.0
    assert selector.accepts(pose)


def test_the_distances_are_settings() -> None:
    selector = KeyFrameSelector(KeyFrameConfig(min_distance_m=3.0))
    assert [selector.accepts(moved(z)) for z in (0.0, 2.0, 3.5)] == [True, False, True]
