import numpy as np

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import plan_trajectory
from slam.simulation.simulator import loop_truth


def truth_of(**config):
    return loop_truth(plan_trajectory(SimulationConfig(**config)).T_town_camera)


def test_only_earlier_images_can_be_matched():
    truth = truth_of(length_m=300)
    assert not np.triu(truth).any()
    assert set(np.unique(truth)) == {0, 1}


def test_the_second_lap_revisits_the_first_at_the_same_place():
    truth = truth_of(length_m=300)
    assert all(truth[300 + i, i] for i in range(0, 300, 10))
    assert not truth[:280].any()


def test_the_images_just_before_are_no_revisits():
    truth = truth_of(speed_m_per_s=1.0, length_m=200, laps=1)
    queries, matches = np.nonzero(truth)
    assert len(queries) == 0 or (queries - matches).min() >= 500


def test_the_opposite_direction_is_not_the_same_place():
    truth = truth_of(length_m=300, reverse=True)
    lap = plan_trajectory(SimulationConfig(length_m=300, reverse=True)).lap
    assert not truth[np.flatnonzero(lap == 1)[60:-60]].any()


def test_the_rule_does_not_depend_on_the_frame_of_the_poses():
    poses = plan_trajectory(SimulationConfig(length_m=300)).T_town_camera
    np.testing.assert_array_equal(loop_truth(poses), loop_truth(np.linalg.inv(poses[0]) @ poses))


def test_crossing_streets_are_not_the_same_place():
    truth = truth_of(shape="figure-eight", length_m=400, laps=1)
    queries, matches = np.nonzero(truth)
    assert len(queries) == 0 or (queries - matches).min() > 350
