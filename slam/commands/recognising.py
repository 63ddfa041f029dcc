"""Commands about places: recognising them, and learning what that takes."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.commands.options import EXIT_INTERRUPTED, FEATURE_NAMES, PARADIGM_NAMES, Kind, Out, Overwrite, Topic


def places(
    source: Annotated[Path, typer.Argument(help="A recorded drive, a folder of images, a video or a bag.")],
    paradigm: Annotated[str, typer.Option(help=f"One of: {PARADIGM_NAMES}.")],
    out: Out,
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(help="Matrix of revisits (.mat, or .npz with truth), or poses (KITTI, TUM).")
    ] = None,
    features: Annotated[str, typer.Option(help=f"Local features: {FEATURE_NAMES}.")] = "surf",
    vocabulary: Annotated[Path | None, typer.Option(help="Vocabulary file; without it one for surf.")] = None,
    descriptor: Annotated[str, typer.Option(help="Of global-descriptor: hog, or onnx:FILE.")] = "hog",
    exclude: Annotated[float | None, typer.Option(help="Match no image less than so many seconds old.")] = None,
    fps: Annotated[float | None, typer.Option(help="Images a second, where there is no times.txt.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of every random generator.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the metrics as JSON.")] = False,
    kind: Kind = None,
    topic: Topic = None,
    overwrite: Overwrite = False,
) -> None:
    """Place recognition alone, with one camera: which images show a place that was seen before?

    Example: revisit places ~/kitti/dataset --sequence 05 --paradigm tracked-words --out runs/places05
    """
    settings = {name: value for name, value in locals().items() if name not in ("json", "topic")}
    from slam.places.command import recognize_places
    from slam.places.options import PlacesOptions

    options = PlacesOptions(**settings, topics=tuple(topic or ()))
    interrupted = recognize_places(options, Console(stderr=True), Console(), json)
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def train_vocabulary(
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="Folders of images, or KITTI roots.")],
    out: Annotated[Path, typer.Option("--out", help="File for the words.")],
    features: Annotated[str, typer.Option(help=f"What the words are made of: {FEATURE_NAMES}.")] = "surf",
    words: Annotated[int, typer.Option(help="How many.")] = 10000,
    sample: Annotated[int, typer.Option(help="Descriptors to train on, at most.")] = 1000000,
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine; else this one alone, which needs no extra.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Of dask, instead: tcp://HOST:PORT; same files there.")] = None,
) -> None:
    """Train visual words on images of your own. Never on those that will be recognised.

    Several processes give the same words sooner, and need: pip install 'revisit-slam[cluster]'

    Example: revisit vocabulary train ~/photos ~/drive --out town.vocabulary
    """
    from slam.progress import progress_bar
    from slam.vocabulary import TrainingOptions, train_from_images

    options = TrainingOptions(tuple(sources), out, features, workers, scheduler)
    with progress_bar(Console(stderr=True), "Describing images") as progress:
        message = train_from_images(options, {"words": words, "sample": sample, "seed": seed}, progress)
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


def filter_train(
    matrix: Annotated[Path, typer.Argument(help="matrix.npz of revisit places with a paradigm of sequences.")],
    truth: Annotated[Path, typer.Argument(help="Matrix of its revisits: .mat, or .npz with truth.")],
    out: Annotated[Path, typer.Option("--out", help="Settings to write, a TOML file.")],
    paradigm: Annotated[
        str, typer.Option(help="Whose filter: sequence-histograms or dynamic-sequences.")
    ] = "dynamic-sequences",
) -> None:
    """Learn the 3x3 filter of the similarity matrix by logistic regression.

    Example: revisit filter train runs/places05/matrix.npz loops_05.npz --out filter.toml
    """
    from slam.filter_training import train_filter_file

    Console().print(train_filter_file(matrix, truth, out, paradigm), markup=False, highlight=False, soft_wrap=True)
