"""The demo: a simulated dataset through the whole pipeline, with no download."""

from pathlib import Path

from rich.console import Console

from slam.environment import cache_folder
from slam.pipeline.progress import progress_bar
from slam.simulation import SimulationConfig, simulate
from slam.simulation.scenario.config import FORMAT

# Three laps at 43 km/h: long enough for odometry's own drift to show, short enough to render in minutes.
DEMO_LAPS, DEMO_LENGTH_M, DEMO_SPEED_M_S = 3, 360.0, 12.0


def demo_dataset(seed: int, messages: Console) -> Path:
    """Render the dataset of the demo, or find it in the cache; its root, in KITTI layout.

    What an earlier version of the simulation has rendered stays in the cache, in a folder of its own.
    """
    config = SimulationConfig(
        shape="circle", laps=DEMO_LAPS, length_m=DEMO_LENGTH_M, speed_m_per_s=DEMO_SPEED_M_S, seed=seed
    )
    with progress_bar(messages, "Rendering the town") as progress:
        return simulate(config, cache_folder() / f"demo-{seed}-v{FORMAT}", progress)


def run_demo(out: Path, seed: int, messages: Console, results: Console) -> bool:
    """Simulate, run and report into `out`. Returns whether the run was interrupted."""
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    source = demo_dataset(seed, messages)
    options = RunOptions(source=source, out=out, overwrite=True)
    return run_pipeline(options, {"seed": seed}, messages, results)
