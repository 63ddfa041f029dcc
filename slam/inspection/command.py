"""`revisit check`: a recording in, a table or JSON of findings out, and what can be done with it."""

import json
from enum import StrEnum

from rich.console import Console, Group
from rich.markup import escape
from rich.table import Table

from slam.datasets.source import DatasetSpec
from slam.inspection.finding import Inspection, Status
from slam.inspection.recording import inspect
from slam.progress import progress_bar

_COLOURS = {Status.GOOD: "green", Status.DOUBTFUL: "yellow", Status.BAD: "red"}


def check_recording(source: DatasetSpec, messages: Console) -> Inspection:
    """Inspect a recording with a progress bar.

    Raises:
        RevisitError: there is nothing that can be recognised as a recording, or a kind that does not exist.
    """
    with progress_bar(messages, "Looking") as progress:
        return inspect(source, progress)


def as_table(inspection: Inspection) -> Group:
    """Findings, one a line, and what the recording serves for."""
    table = Table(title=escape(f"{inspection.source}: {inspection.kind}"), show_header=False, title_justify="left")
    for finding in inspection.findings:
        colour = _COLOURS[finding.status]
        table.add_row(f"[{colour}]{finding.status}[/{colour}]", finding.topic, escape(finding.text))
    return Group(table, *(_verdict(inspection, use) for use in inspection.uses))


def _verdict(inspection: Inspection, use: StrEnum) -> str:
    reasons = inspection.hindrances(use)
    return f"{use}: will not work: {escape('; '.join(reasons))}" if reasons else f"{use}: will work"


def as_json(inspection: Inspection) -> str:
    """The same for scripts."""
    table = {
        "source": inspection.source,
        "kind": inspection.kind,
        "findings": [
            {"topic": f.topic, "status": f.status, "text": f.text, "figures": f.figures} for f in inspection.findings
        ],
        "works": {use.name.lower(): not inspection.hindrances(use) for use in inspection.uses},
        "reasons": {use.name.lower(): inspection.hindrances(use) for use in inspection.uses},
    }
    return json.dumps(table, indent=2)
