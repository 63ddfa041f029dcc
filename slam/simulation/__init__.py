"""A simulated drive through a procedural town: the data source that needs no download."""

from slam.simulation.drive import simulate
from slam.simulation.spec import DriveSpec
from slam.simulation.truth import loop_truth

__all__ = ["DriveSpec", "loop_truth", "simulate"]
