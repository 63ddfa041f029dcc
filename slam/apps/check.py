"""`revisit check`: prints the findings about a dataset or a map, and its possible uses, as a table or JSON."""

import json
from enum import StrEnum

from rich.console import Console, Group
from rich.markup import escape
from rich.table import Table

from slam.datasets.dataset import DatasetSpec
from slam.diagnostics.dataset_checks import inspect_dataset
from slam.diagnostics.findings import Inspection, Status
from slam.pipeline.progress import progress_bar

_COLOURS = {Status.OK: "green", Status.WARNING: "yellow", Status.FAULT: "red"}


def check_recording(spec: DatasetSpec, messages: Console) -> Inspection:
    """Inspect a dataset with a progress bar.

    Raises:
        RevisitError: the path is no dataset of any format, or the requested format does not exist.
    """
    with progress_bar(messages, "Looking") as progress:
        return inspect_dataset(spec, progress)


def format_table(inspection: Inspection) -> Group:
    """Format the findings, one per line, and the possible uses."""
    table = Table(title=escape(f"{inspection.source}: {inspection.format}"), show_header=False, title_justify="left")
    for finding in inspection.findings:
        colour = _COLOURS[finding.status]
        table.add_row(f"[{colour}]{finding.status}[/{colour}]", finding.topic, escape(finding.text))
    return Group(table, *(_format_use(inspection, use) for use in inspection.uses))


def _format_use(inspection: Inspection, use: StrEnum) -> str:
    topics = dict.fromkeys(finding.topic for finding in inspection.findings if use in finding.forbids)
    return f"{use}: will not work: see {escape(', '.join(topics))} above" if topics else f"{use}: will work"


def format_json(inspection: Inspection) -> str:
    """Format the same as JSON, for scripts."""
    table = {
        "source": inspection.source,
        "format": inspection.format,
        "findings": [
            {"topic": f.topic, "status": f.status, "text": f.text, "figures": f.figures} for f in inspection.findings
        ],
        "works": {use.name.lower(): not inspection.reasons_against(use) for use in inspection.uses},
        "reasons": {use.name.lower(): inspection.reasons_against(use) for use in inspection.uses},
    }
    return json.dumps(table, indent=2)
