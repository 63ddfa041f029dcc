"""The result of a run as a table for the terminal."""

from rich.markup import escape
from rich.table import Table

from slam.record import RunRecord
from slam.report.reading import MISSING, alignment, stage_times, text, value

ESTIMATES = ("odometry", "online", "corrected")
ERRORS = {
    "t_rel_percent": "t_rel [%]",
    "r_rel_deg_per_100m": "r_rel [deg/100 m]",
    "end_error_m": "end error [m]",
    "end_error_percent": "end error [%]",
}


def summary(record: RunRecord) -> Table:
    """Sum up a run: errors of the three estimates, loops, speed. What is not known is a dash."""
    table = Table(title=escape(record.name), caption=_caption(record), caption_justify="left")
    table.add_column("")
    for heading in ("ATE [m]", *ERRORS.values()):
        table.add_column(escape(heading), justify="right")
    for name in ESTIMATES:
        ate = text(value(record.metrics, f"{name}.ate_m"))
        errors = [text(value(record.metrics, f"{name}.{key}")) for key in ERRORS]
        table.add_row(name, ate, *errors)
    return table


def _caption(record: RunRecord) -> str:
    get = record.metrics
    aligned = {alignment(get, name) for name in ESTIMATES if value(get, f"{name}.ate_m") is not None}
    loops = ", ".join(f"{text(value(get, f'loops.{key}'))} {key}" for key in ("proposed", "verified", "kept"))
    truth = ", ".join(f"{text(value(get, f'loops.{key}'))} {key}" for key in ("true", "false"))
    recall = text(value(get, "places.recall_at_100_precision"), 3)
    speed = f"{len(record.timestamps)} frames, {text(value(get, 'frames_per_second'), 1)} a second"
    stages = ", ".join(f"{stage.name} {stage.median:.1f}" for stage in stage_times(record))
    lines = [
        f"ATE after {' and '.join(sorted(aligned))} alignment of all poses" if aligned else "no ground truth",
        f"loops: {loops}; by ground truth {truth}",
        f"places: R@P100 {recall}" if recall != MISSING else "",
        speed,
        f"median ms a frame: {stages}" if stages else "",
    ]
    return escape("\n".join(line for line in lines if line))
