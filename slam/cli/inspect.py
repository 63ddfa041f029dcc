"""Commands that inspect recordings, runs, saved maps and the installation."""

from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from slam.cli.options import EXIT_FAILED, Format, FrameRate, ImageTopic, Json, Sequence

if TYPE_CHECKING:
    from slam.apps.doctor import Check


def locate(
    map: Annotated[Path, typer.Argument(help="Saved map: a map.db, or a run folder that has one.")],
    images: Annotated[Path, typer.Argument(help="Query images: a file, a folder of images, a video or a recording.")],
    sequence: Sequence = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="CSV file for the poses.", show_default="none is written")
    ] = None,
    json: Json = False,
) -> None:
    """Localise single images in a saved map of the same camera: the pose of each, or the reason why there is none.

    Example: revisit locate runs/kitti05 photo.png
    """
    from slam.apps.localize import LocateOptions, as_json, as_table
    from slam.apps.localize import locate as place
    from slam.datasets.dataset import DatasetSpec

    answers = place(LocateOptions(map, DatasetSpec(images, sequence), out), Console(stderr=True))
    shown = as_json(answers) if json else as_table(answers)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


def info(
    map: Annotated[Path, typer.Argument(help="Saved map: a map.db, or a run folder that has one.")],
    json: Json = False,
) -> None:
    """List what a saved map holds: drives, loops and landmarks, and the size of each part.

    Example: revisit info runs/kitti05
    """
    from slam.map_database.summary import as_json, as_table, summarize

    summary = summarize(map)
    shown = as_json(summary) if json else as_table(summary)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


def check(
    source: Annotated[Path, typer.Argument(help="Recording (a folder, a video or a bag), or a saved map.")],
    sequence: Sequence = None,
    dataset_format: Format = None,
    fps: FrameRate = None,
    image_topic: ImageTopic = None,
    json: Json = False,
) -> None:
    """Check a recording before a run, or a saved map: which commands will work with it, and what is wrong.

    Example: revisit check data/kitti --sequence 05
    """
    from slam.apps.check import check_recording, format_json, format_table
    from slam.datasets.dataset import DatasetSpec
    from slam.diagnostics.map_checks import inspect_map, is_map

    if is_map(source):
        inspection = inspect_map(source)
    else:
        recording = DatasetSpec(source, sequence, dataset_format, fps, tuple(image_topic or ()))
        inspection = check_recording(recording, Console(stderr=True))
    shown = format_json(inspection) if json else format_table(inspection)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)
    raise typer.Exit(0 if inspection.possible_uses else EXIT_FAILED)


def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    format: Annotated[
        str,
        typer.Option(
            help="Output format: tum or kitti (trajectory), g2o (pose graph), ply (landmarks), colmap (text model)."
        ),
    ],
    state: Annotated[
        str,
        typer.Option(help="Trajectory to write: odometry, online (as estimated at each moment) or corrected."),
    ] = "corrected",
    out: Annotated[
        Path | None,
        typer.Option(help="Output file; with colmap an output folder.", show_default="in the folder of the run"),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Write one result of a run in a format that other programs read.

    Example: revisit export runs/kitti05 --format tum --out kitti05.tum
    """
    from slam.apps.export import ExportOptions, export_result

    written = export_result(ExportOptions(run, format, state, out, overwrite))
    Console().print(str(written), markup=False, highlight=False, soft_wrap=True)


def view(
    run: Annotated[Path, typer.Argument(help="Folder of a run that has a recording.rrd.")],
    web: Annotated[
        bool, typer.Option("--web", help="Print the address of a page for a browser instead of opening a window.")
    ] = False,
) -> None:
    """Open the recording of a run, and its dense map if there is one, in the rerun viewer.

    The viewer listens on 127.0.0.1 alone. Its web page, which is rerun's own, asks the internet for a font, for news of
    releases and for examples, and reports its use to rerun's makers; the window does not.

    Example: revisit view runs/demo
    """
    from slam.viewer.viewer_process import open_recording

    open_recording(run, web).wait()


def doctor(
    licences: Annotated[
        bool, typer.Option("--licences", help="List the installed dependencies with their licences instead.")
    ] = False,
    json: Json = False,
) -> None:
    """Check Python, the installed packages and the system libraries, and print how to install what is missing.

    Example: revisit doctor
    """
    if licences:
        _print_licences(json)
        return
    from slam.apps.doctor import check_machine

    checks = check_machine()
    (_print_json if json else _print_checks)(checks)
    raise typer.Exit(EXIT_FAILED if any(check.problem for check in checks) else 0)


def _print_checks(checks: list["Check"]) -> None:
    from rich.markup import escape

    for check in checks:
        mark = "[red]missing[/red]" if check.problem else "[green]ok[/green]"
        words = escape(f"{check.name} {check.found}{check.problem}")
        Console().print(f"{mark:>8}  {words}", highlight=False, soft_wrap=True)
        if check.remedy:
            Console().print(f"          type: {check.remedy}", markup=False, highlight=False, soft_wrap=True)


def _print_json(rows: list[Any]) -> None:
    """Print dataclasses as a list of objects."""
    Console().print(dumps([asdict(row) for row in rows], indent=2), markup=False, highlight=False, soft_wrap=True)


def _print_licences(as_json: bool) -> None:
    from rich.table import Table

    from slam.apps.doctor import licences

    if as_json:
        _print_json(licences())
        return
    table = Table("package", "version", "licence", "needed by", title="What Revisit is installed with", box=None)
    for one in licences():
        table.add_row(one.package, one.version, one.licence, "Revisit" if one.direct else "another package")
    Console().print(table)
