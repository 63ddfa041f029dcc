"""The summary of a run as a table for the terminal."""

from rich.markup import escape
from rich.table import Table

from slam.record import RunRecord
from slam.report.reading import MISSING, alignment_name, format_value, metric_value, stage_times

ESTIMATES = ("odometry", "online", "corrected")
ERRORS = {
    "t_rel_percent": "t_rel [%]",
    "r_rel_deg_per_100m": "r_rel [deg/100 m]",
    "end_error_m": "end error [m]",
    "end_error_percent": "end error [%]",
}


def summary_table(record: RunRecord) -> Table:
    """Summarise a run: errors of the three estimates, loops, speed. Unknown values are dashes."""
    table = Table(title=escape(record.name), caption=_caption(record), caption_justify="left")
    table.add_column("")
    for heading in ("ATE [m]", *ERRORS.values()):
        table.add_column(escape(heading), justify="right")
    for name in ESTIMATES:
        ate = format_value(metric_value(record.metrics, f"{name}.ate_m"))
        errors = [format_value(metric_value(record.metrics, f"{name}.{key}")) for key in ERRORS]
        table.add_row(name, ate, *errors)
    return table


def _caption(record: RunRecord) -> str:
    def text(key: str, digits: int = 2) -> str:
        return format_value(metric_value(record.metrics, key), digits)

    known = [name for name in ESTIMATES if metric_value(record.metrics, f"{name}.ate_m") is not None]
    alignments = sorted({alignment_name(record.metrics, name) for name in known})
    loops = ", ".join(f"{text(f'loops.{key}')} {key}" for key in ("proposed", "verified", "kept"))
    truth = ", ".join(f"{text(f'loops.{key}')} {key}" for key in ("true", "false"))
    recall = text("places.recall_at_100_precision", 3)
    stages = ", ".join(f"{stage.name} {stage.median:.1f}" for stage in stage_times(record))
    lines = [
        f"ATE after {' and '.join(alignments)} alignment of all poses" if known else "no ground truth",
        f"loops: {loops}; by ground truth {truth}",
        f"places: R@P100 {recall}" if recall != MISSING else "",
        f"{len(record.timestamps)} frames, {text('frames_per_second', 1)} per second",
        f"median ms per frame: {stages}" if stages else "",
    ]
    return escape("\n".join(line for line in lines if line))
