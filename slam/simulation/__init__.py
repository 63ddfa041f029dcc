"""A simulated drive through a procedural town: the data source that needs no download.

`DriveSpec` says what to drive; `simulate` renders it; `loop_truth` says which images show the same place.
"""

from typing import TYPE_CHECKING

from slam.simulation.spec import DriveSpec

if TYPE_CHECKING:
    from slam.simulation.drive import simulate
    from slam.simulation.truth import loop_truth

__all__ = ["DriveSpec", "loop_truth", "simulate"]


def __getattr__(name: str) -> object:
    """Import the renderer, with its compiler, when it is first asked for."""
    if name == "simulate":
        from slam.simulation.drive import simulate

        return simulate
    if name == "loop_truth":
        from slam.simulation.truth import loop_truth

        return loop_truth
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
