"""Ground truth of place recognition: which images of a dataset show the same place.

Ground truth of mapping: the surfaces of a simulated town.
"""

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.evaluation.ground_truth import RevisitRule, truth_from_poses
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.trajectory import plan_trajectory
from slam.simulation.world.town import TownBuilder

Array = NDArray[np.float64]

# The rule by which runs are evaluated, with a longer minimum distance along the path.
RULE = RevisitRule(min_path_length_m=50.0)


def loop_truth(T_world_camera: Array) -> NDArray[np.uint8]:
    """Matrix (N, N) of poses (N, 4, 4), metres: row = query image, column = earlier image, 1 = the same place.

    The same place: within 10 m, looking within 45 degrees of each other, with at least 50 m of path in between.
    """
    return truth_from_poses(T_world_camera, rule=RULE).astype(np.uint8)


def ground_truth_surfaces(config: SimulationConfig) -> NDArray[np.float64]:
    """Return the triangles (T, 3, 3) of all static objects, metres, in the world frame (the first camera)."""
    trajectory = plan_trajectory(config)
    corners = np.concatenate([mesh.to_town_frame().corners for mesh in TownBuilder(config, trajectory).build()])
    return se3.transform(se3.inverse(trajectory.T_town_camera[0]), corners.reshape(-1, 3)).reshape(-1, 3, 3)
