"""The true surfaces of a simulated drive: what its maps are measured against."""

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.simulation.routes import plan_drive
from slam.simulation.spec import DriveSpec
from slam.simulation.town import TownBuilder


def true_surfaces(spec: DriveSpec) -> NDArray[np.float64]:
    """Triangles (T, 3, 3) of all that stands still, metres, in the world frame: the drive's first camera."""
    drive = plan_drive(spec)
    corners = np.concatenate([part.placed().corners for part in TownBuilder(spec, drive).build()])
    return se3.transform(se3.inverse(drive.T_town_camera[0]), corners.reshape(-1, 3)).reshape(-1, 3, 3)
