"""Commands that look into recordings, runs and saved maps."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.commands.options import EXIT_FAILED, Kind, Topic


def locate(
    map: Annotated[Path, typer.Argument(help="Folder of a run, or its map.db.")],
    images: Annotated[Path, typer.Argument(help="An image, a folder of images, a video, or a recorded drive.")],
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV file for the poses.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Tell where single images of the map's camera were taken, or that the map does not show it.

    Example: revisit locate runs/kitti05 photo.png
    """
    from slam.datasets.source import DatasetSpec
    from slam.localisation.command import LocateOptions, as_json, as_table
    from slam.localisation.command import locate as place

    answers = place(LocateOptions(map, DatasetSpec(images, sequence), out), Console(stderr=True))
    shown = as_json(answers) if json else as_table(answers)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


def info(
    map: Annotated[Path, typer.Argument(help="Folder of a run, or its map.db.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Tell what a saved map holds: its drives, loops and landmarks, and where its bytes are.

    Example: revisit info runs/kitti05
    """
    from slam.map_store.summary import as_json, as_table, summarise

    summary = summarise(map)
    shown = as_json(summary) if json else as_table(summary)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


def check(
    source: Annotated[
        Path,
        typer.Argument(help="A recorded drive, a folder of images, a video, a bag, or a map that a run has saved."),
    ],
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    kind: Kind = None,
    fps: Annotated[float | None, typer.Option(help="Images a second, where nothing else says.")] = None,
    topic: Topic = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Look at a recording before a run, or at a saved map: what will and what will not work with it, and why.

    Example: revisit check data/kitti --sequence 05
    """
    from slam.datasets.source import DatasetSpec
    from slam.inspection.command import check_recording, format_json, format_table
    from slam.inspection.map import inspect_map, is_map

    if is_map(source):
        inspection = inspect_map(source)
    else:
        inspection = check_recording(DatasetSpec(source, sequence, kind, fps, tuple(topic or ())), Console(stderr=True))
    shown = format_json(inspection) if json else format_table(inspection)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)
    raise typer.Exit(0 if inspection.possible_uses else EXIT_FAILED)


def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    format: Annotated[
        str, typer.Option(help="tum or kitti (trajectories), g2o (graph), ply (landmarks), colmap (its text model).")
    ],
    state: Annotated[
        str, typer.Option(help="odometry, online (trajectories only: as known at each moment) or corrected.")
    ] = "corrected",
    out: Annotated[Path | None, typer.Option(help="File, or colmap's folder; without it beside the run.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")] = False,
) -> None:
    """Write one result of a run in the format that another program reads.

    Example: revisit export runs/kitti05 --format tum --out kitti05.tum
    """
    from slam.export import ExportOptions
    from slam.export import export as write

    written = write(ExportOptions(run, format, state, out, overwrite))
    Console().print(str(written), markup=False, highlight=False, soft_wrap=True)


def view(
    run: Annotated[Path, typer.Argument(help="Folder of a run with a recording.")],
    web: Annotated[bool, typer.Option("--web", help="Name a page for a browser of this machine instead.")] = False,
) -> None:
    """Open the recording of a run, and its dense map where it has one, in the rerun viewer.

    The viewer listens on 127.0.0.1 alone and reports to nobody.

    Example: revisit view runs/demo
    """
    from slam.viewer.listener import open_recording

    open_recording(run, web).wait()
