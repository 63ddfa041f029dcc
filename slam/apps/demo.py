"""The demo: a simulated dataset through the whole pipeline, with no download."""

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from slam.environment import cache_folder
from slam.pipeline.progress import announce_compilation, progress_bar
from slam.simulation import SimulationConfig, simulate
from slam.simulation.scenario.config import FORMAT

# Two laps round two blocks, 600 m each, seen by one camera of 621 x 188 pixels at 43 km/h: its unit of length drifts so
# far that anybody sees it, and rendering takes three minutes. What else was tried: docs/decisions/demo.md.
_DRIVE = SimulationConfig(
    shape="blocks", laps=2, length_m=600.0, speed_m_per_s=12.0, width=621, height=188, difficulty="standard"
)


def demo_dataset(seed: int, messages: Console) -> Path:
    """Render the dataset of the demo, or find it in the cache; its root, in KITTI layout.

    What an earlier version of the simulation has rendered stays in the cache, in a folder of its own.
    """
    config = replace(_DRIVE, seed=seed)
    with announce_compilation(messages), progress_bar(messages, "Rendering the town") as progress:
        return simulate(config, cache_folder() / f"demo-blocks-{seed}-v{FORMAT}", progress)


def run_demo(out: Path, seed: int, messages: Console, results: Console) -> bool:
    """Simulate, run with the left camera alone and report into `out`. Returns whether the run was interrupted."""
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    source = demo_dataset(seed, messages)
    options = RunOptions(source=source, out=out, overwrite=True)
    return run_pipeline(options, {"seed": seed, "mono": True}, messages, results)
