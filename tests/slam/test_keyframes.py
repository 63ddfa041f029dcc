"""Key frames come after a metre or ten degrees."""

import numpy as np
import pytest

from odometry import se3
from slam.keyframes import KeyFrameConfig, KeyFrameSelector, RevisitCounter


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


def test_of_each_place_the_map_keeps_so_many_later_frames() -> None:
    places = RevisitCounter(max_revisits=2)
    first_lap = range(10)
    redundant = [[places.add(10 * lap + frame, frame) for frame in first_lap] for lap in range(1, 6)]
    assert redundant == [[False] * 10, [False] * 10, [True] * 10, [True] * 10, [True] * 10]


def test_a_match_with_a_later_visit_counts_for_the_first_one() -> None:
    places = RevisitCounter(max_revisits=1)
    assert not places.add(10, 0)
    assert places.add(20, 10)
    assert places.add(21, 0)
    assert not places.add(22, 1)


def test_the_first_visit_alone_may_be_kept() -> None:
    assert RevisitCounter(max_revisits=0).add(10, 0)


@pytest.mark.parametrize("max_revisits", [0, 1, 3])
def test_a_map_does_not_grow_with_the_number_of_laps(max_revisits: int) -> None:
    rng, lap = np.random.default_rng(0), 50
    places, kept = RevisitCounter(max_revisits), list(range(lap))
    for frame in range(lap, 100 * lap):  # matched with any frame that the map has of the place, or of one beside it
        place = (frame + rng.integers(-1, 2)) % lap
        if not places.add(frame, int(rng.choice([k for k in kept if k % lap == place]))):
            kept.append(frame)
    assert len(kept) == (max_revisits + 1) * lap
