"""Cars that move: met in the other lane, and driven behind for a while."""

import numpy as np
from numpy.typing import NDArray

from slam.simulation.mesh import Mesh
from slam.simulation.routes import LANE, Drive
from slam.simulation.spec import DriveSpec

Array = NDArray[np.float64]
_SIGHT = 140.0  # metres along the way within which cars are drawn
_LAP = 360.0  # metres for which `moving_cars` is meant
_LEAD = 120.0  # metres of way on which, of twice as many, a car drives ahead


class Traffic:
    """All moving cars of a drive, as functions of time."""

    def __init__(self, spec: DriveSpec, drive: Drive, cars: list[Mesh]) -> None:
        """Draw where each car is met and how fast it drives."""
        rng = spec.rng(13)
        count = round(spec.moving_cars * drive.way.length / _LAP)
        self.drive, self.spec, self.cars = drive, spec, cars
        self.met_at = rng.uniform(0.0, max(drive.way.length, _LAP), count)
        self.speeds = spec.speed * rng.uniform(0.6, 1.3, count)
        self.kinds = rng.integers(0, len(cars), count + 1)

    def at(self, frame: int) -> list[Mesh]:
        """Return the cars to be seen around one frame, placed in the town."""
        along = float(self.drive.along[frame])
        time = along / self.spec.speed
        # A car met at s is at s when we are there, and comes towards us before.
        places = self.met_at - self.speeds * (time - self.met_at / self.spec.speed)
        seen = np.flatnonzero(np.abs(places - along) < _SIGHT)
        out = [self._placed(self.kinds[i], float(places[i]), 2 * LANE + 0.1, np.pi) for i in seen]
        if len(self.met_at) and along % (2 * _LEAD) < _LEAD:
            ahead = 16.0 + 9.0 * np.sin(along / 25.0) + 30.0 * max(0.0, along % (2 * _LEAD) - 0.7 * _LEAD) / _LEAD
            out.append(self._placed(self.kinds[-1], along + ahead, 0.1, 0.0))
        return out

    def _placed(self, kind: int, along: float, left: float, turned: float) -> Mesh:
        position, heading = self.drive.way.at(np.array([along]))
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])])
        return self.cars[kind].moved(heading[0] + turned, np.array([*(position[0] + left * side), 0.01]))
