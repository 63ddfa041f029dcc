"""Simulated datasets with exact ground truth: a drive through a procedural town, or a camera in a procedural room.

`SimulationConfig` describes a drive and `simulate` renders it; `RoomConfig` and `simulate_room` do so for a room.
`loop_truth` returns the pairs of images of a drive that show the same place.
"""

from typing import TYPE_CHECKING

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.room_config import RoomConfig

if TYPE_CHECKING:
    from slam.simulation.room_simulator import simulate_room
    from slam.simulation.simulator import loop_truth, simulate

__all__ = ["RoomConfig", "SimulationConfig", "loop_truth", "simulate", "simulate_room"]


def __getattr__(name: str) -> object:
    """Import the renderer and its compiler on first use: the command line needs the configuration alone."""
    if name == "simulate":
        from slam.simulation.simulator import simulate

        return simulate
    if name == "simulate_room":
        from slam.simulation.room_simulator import simulate_room

        return simulate_room
    if name == "loop_truth":
        from slam.simulation.simulator import loop_truth

        return loop_truth
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
