"""Ground truth of mapping: the surfaces of a simulated town."""

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.simulation.routes import plan_trajectory
from slam.simulation.spec import SimulationConfig
from slam.simulation.town import TownBuilder


def ground_truth_surfaces(config: SimulationConfig) -> NDArray[np.float64]:
    """Return the triangles (T, 3, 3) of all static objects, metres, in the world frame (the first camera)."""
    trajectory = plan_trajectory(config)
    corners = np.concatenate([mesh.to_town_frame().corners for mesh in TownBuilder(config, trajectory).build()])
    return se3.transform(se3.inverse(trajectory.T_town_camera[0]), corners.reshape(-1, 3)).reshape(-1, 3, 3)
