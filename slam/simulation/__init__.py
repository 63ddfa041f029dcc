"""Simulated datasets: a stereo camera drives through a procedural town; the ground truth is exact.

`SimulationConfig` describes a dataset, `simulate` renders it, and `loop_truth` returns the pairs of images that show
the same place.
"""

from typing import TYPE_CHECKING

from slam.simulation.scenario.config import SimulationConfig

if TYPE_CHECKING:
    from slam.simulation.simulator import loop_truth, simulate

__all__ = ["SimulationConfig", "loop_truth", "simulate"]


def __getattr__(name: str) -> object:
    """Import the renderer and its compiler on first use: the command line needs the configuration alone."""
    if name == "simulate":
        from slam.simulation.simulator import simulate

        return simulate
    if name == "loop_truth":
        from slam.simulation.simulator import loop_truth

        return loop_truth
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
