"""Moving cars: oncoming ones in the other lane, and one that drives ahead for a while."""

import numpy as np
from numpy.typing import NDArray

from slam.simulation.mesh import Mesh
from slam.simulation.routes import LANE, SimulatedTrajectory
from slam.simulation.spec import SimulationConfig

Array = NDArray[np.float64]
_MAX_DISTANCE_M = 140.0  # along the path: cars farther away are not drawn
_LAP_M = 360.0  # path length that `cars_per_360m` refers to
_LEAD_M = 120.0  # a car drives ahead on every second stretch of this length


class Traffic:
    """All moving cars of a dataset as functions of time."""

    def __init__(self, config: SimulationConfig, trajectory: SimulatedTrajectory, cars: list[Mesh]) -> None:
        """Draw where each car is met and how fast it drives, at random."""
        rng = config.rng(13)
        count = round(config.cars_per_360m * trajectory.path.length_m / _LAP_M)
        self.trajectory, self.config, self.cars = trajectory, config, cars
        self.met_at = rng.uniform(0.0, max(trajectory.path.length_m, _LAP_M), count)
        self.speeds = config.speed * rng.uniform(0.6, 1.3, count)
        self.kinds = rng.integers(0, len(cars), count + 1)

    def meshes_at(self, frame: int) -> list[Mesh]:
        """Return the cars around the camera at a frame, in the town frame."""
        distance_m = float(self.trajectory.distance_m[frame])
        time = distance_m / self.config.speed
        # A car that is met at s is at s when the camera is there, and approaches it before.
        places = self.met_at - self.speeds * (time - self.met_at / self.config.speed)
        seen = np.flatnonzero(np.abs(places - distance_m) < _MAX_DISTANCE_M)
        out = [self._car_at(self.kinds[i], float(places[i]), 2 * LANE + 0.1, np.pi) for i in seen]
        if len(self.met_at) and distance_m % (2 * _LEAD_M) < _LEAD_M:
            ahead = (
                16.0
                + 9.0 * np.sin(distance_m / 25.0)
                + 30.0 * max(0.0, distance_m % (2 * _LEAD_M) - 0.7 * _LEAD_M) / _LEAD_M
            )
            out.append(self._car_at(self.kinds[-1], distance_m + ahead, 0.1, 0.0))
        return out

    def _car_at(self, car: int, distance_m: float, left_m: float, yaw: float) -> Mesh:
        position, heading = self.trajectory.path.interpolate(np.array([distance_m]))
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])])
        return self.cars[car].transform(heading[0] + yaw, np.array([*(position[0] + left_m * side), 0.01]))
