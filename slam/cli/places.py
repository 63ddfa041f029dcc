"""Commands for place recognition: on its own, and the training of vocabularies and matrix filters."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.cli import options as option
from slam.cli.options import EXIT_INTERRUPTED, FEATURE_NAMES


def places(
    source: Annotated[Path, typer.Argument(help="Recording: a drive, a folder of images, a video or a bag.")],
    out: option.Out,
    reference: option.Reference = None,
    paradigm: option.PlacesParadigm = None,
    matches: option.MatchesFile = None,
    sequence: option.Sequence = None,
    dataset_format: option.Format = None,
    fps: option.FrameRate = None,
    image_topic: option.ImageTopic = None,
    mask: option.Mask = None,
    ground_truth: option.PlacesTruth = None,
    reference_sequence: option.ReferenceSequence = None,
    reference_truth: option.ReferenceTruth = None,
    tolerance: option.EqualNumbers = None,
    max_distance: option.SamePlace = None,
    soft: option.Soft = None,
    preset: option.PlacesPreset = "default",
    features: option.PlacesFeatures = "surf",
    vocabulary: option.Vocabulary = None,
    descriptor: option.PlacesDescriptor = "hog",
    exclude: option.Exclude = None,
    temporal: option.Temporal = True,
    seed: option.PlacesSeed = 0,
    json: option.Json = False,
    overwrite: option.Overwrite = False,
) -> None:
    """Recognise places with one camera, without odometry or mapping: which images show a place seen before?

    With --reference, which images of another recording show the places of this one?

    Example: revisit places ~/kitti/dataset --sequence 05 --paradigm tracked-words --out runs/places05
    """
    from slam.apps.places import PlacesOptions, recognize_places
    from slam.evaluation.traverse_truth_files import TraverseTruthOptions

    options = PlacesOptions(
        source=source,
        paradigm=option.require_paradigm(paradigm, matches),
        out=out,
        sequence=sequence,
        ground_truth=ground_truth,
        features=features,
        vocabulary=vocabulary,
        descriptor=descriptor,
        exclude=exclude,
        fps=fps,
        seed=seed,
        overwrite=overwrite,
        format=dataset_format,
        topics=tuple(image_topic or ()),
        mask=mask,
        preset=preset,
        reference=reference,
        reference_sequence=reference_sequence,
        truth=TraverseTruthOptions(None, reference_truth, tolerance, max_distance, soft),
        temporal=temporal,
    )
    interrupted = recognize_places(options, Console(stderr=True), Console(), json)
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def train_vocabulary(
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="Folders of images, or KITTI roots.")],
    out: Annotated[Path, typer.Option("--out", help="Vocabulary file to write.")],
    features: Annotated[str, typer.Option(help=f"Local features: {FEATURE_NAMES}.")] = "surf",
    words: Annotated[int, typer.Option(help="Number of visual words.")] = 10000,
    sample: Annotated[int, typer.Option(help="Maximum number of descriptors to train on.")] = 1000000,
    seed: Annotated[int, typer.Option(help="Seed of every random generator.")] = 0,
) -> None:
    """Train a vocabulary of visual words on images of your own. Do not use the images that will be recognised.

    Example: revisit vocabulary train ~/photos ~/drive --out town.vocabulary
    """
    from slam.apps.train import TrainingOptions, train_from_images
    from slam.pipeline.progress import progress_bar

    options = TrainingOptions(tuple(sources), out, features)
    with progress_bar(Console(stderr=True), "Describing images") as progress:
        message = train_from_images(options, {"words": words, "sample": sample, "seed": seed}, progress)
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


def filter_train(
    matrix: Annotated[
        Path, typer.Argument(help="Similarity matrix: the matrix.npz of `revisit places` with a sequence paradigm.")
    ],
    truth: Annotated[
        Path, typer.Argument(help="Ground truth of the same drive: a matrix of revisits (.mat, or .npz with `truth`).")
    ],
    out: Annotated[Path, typer.Option("--out", help="TOML file of settings to write.")],
    paradigm: Annotated[
        str, typer.Option(help="Paradigm that uses the filter: sequence-histograms or dynamic-sequences.")
    ] = "dynamic-sequences",
) -> None:
    """Train the 3x3 filter of the similarity matrix by logistic regression.

    Example: revisit filter train runs/places05/matrix.npz loops_05.npz --out filter.toml
    """
    from slam.apps.train import train_filter_file

    Console().print(train_filter_file(matrix, truth, out, paradigm), markup=False, highlight=False, soft_wrap=True)
