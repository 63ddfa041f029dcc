"""`revisit places`: images in; matches, curves, matrices and their pictures out."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from place_recognition.paradigms.catalogue import ParadigmsConfig, excluding
from place_recognition.recognizer import Belief
from slam.datasets.left_images import ImageDataset
from slam.datasets.open import open_images
from slam.errors import ConfigError
from slam.evaluation.truth import KnownTruth, check_size, read_truth, truth_of_poses
from slam.places.drive import Bench, Recognised, recognise
from slam.places.options import PlacesOptions, check
from slam.places.results import PlacesRecord, make_record, summary, write_results
from slam.progress import progress_bar
from slam.provenance import provenance
from slam.stopping import stop_on_interrupt
from slam.storage.metrics import metrics_text
from slam.storage.run_folder import RunFolder


def recognise_places(options: PlacesOptions, messages: Console, results: Console, json: bool = False) -> bool:
    """Recognise the places of a drive and write every result into `options.out`.

    Args:
        options: where to read and write, and how to recognise.
        messages: for progress and warnings.
        results: for the summary.
        json: print the metrics as JSON instead of a table.

    Returns:
        Whether the drive was interrupted from the keyboard; its results so far are written all the same.

    Raises:
        RevisitError: the images, the settings or the output folder cannot be used; earlier results stay untouched.
    """
    check(options)
    images = open_images(options.recording)
    record = recognise_images(options, images, find_truth(options, images), messages)
    _print(record, options.out, results, json)
    return bool(record.metrics["interrupted"])


def recognise_images(
    options: PlacesOptions, images: ImageDataset, truth: KnownTruth, messages: Console
) -> PlacesRecord:
    """Recognise the places of images that are open already, and write every result into `options.out`.

    Raises:
        RevisitError: the images, the settings or the output folder cannot be used; earlier results stay untouched.
    """
    config = _config(options, images)
    with RunFolder.create(options.out, options.overwrite) as folder:
        done = _recognised(options, config, images, messages)
        record = make_record(done, truth, provenance(options.source, images.name) | _settings(options))
        write_results(folder.path, record)
        folder.commit()
    return record


def find_truth(options: PlacesOptions, images: ImageDataset) -> KnownTruth:
    """The truth that was named, else that of the poses which the recording brings along, else none.

    Raises:
        DataError: the file is missing, damaged or of another size than the drive.
    """
    if options.ground_truth is not None:
        truth = read_truth(options.ground_truth)
    elif images.ground_truth is not None:
        truth = truth_of_poses(images.ground_truth, f"poses of {options.source}")
    else:
        truth = KnownTruth(None, "none")
    check_size(truth, len(images), options.source)
    return truth


def without_recent(beliefs: Sequence[Belief], images: ImageDataset, seconds: float | None) -> list[Belief]:
    """Take matches less than so many seconds old for no detection."""
    times = images.timestamps
    if seconds is None or times is None:
        return list(beliefs)
    recent = [b.match is not None and times[b.query] - times[b.match] < seconds for b in beliefs]
    return [Belief(b.query, None, 0.0, accepted=False) if r else b for b, r in zip(beliefs, recent, strict=True)]


def _recognised(
    options: PlacesOptions, config: ParadigmsConfig, images: ImageDataset, messages: Console
) -> Recognised:
    import cv2

    bench = Bench(options.paradigm, config)
    cv2.setRNGSeed(options.seed)
    with progress_bar(messages, "Recognising places") as progress, stop_on_interrupt() as stop:
        done = recognise(images, bench, progress, lambda: stop.made)
    if done.interrupted:
        messages.print(f"Interrupted: finishing with the {done.images} images seen so far.")
    return replace(done, beliefs=without_recent(done.beliefs, images, options.exclude))


def _config(options: PlacesOptions, images: ImageDataset) -> ParadigmsConfig:
    """Settings of the command line over the defaults.

    Raises:
        ConfigError: a time is to be excluded of images without times.
    """
    vocabulary = "" if options.vocabulary is None else str(options.vocabulary)
    config = ParadigmsConfig(options.features, vocabulary=vocabulary, descriptor=options.descriptor)
    if not options.exclude or len(images) < 2:
        return config
    if images.timestamps is None:
        raise ConfigError(
            f"--exclude {options.exclude:g}: expected times.txt beside the images, found none; give --fps"
        )
    step = float(np.median(np.diff(images.timestamps)))
    return excluding(config, math.ceil(options.exclude / step - 1e-9))


def _settings(options: PlacesOptions) -> dict[str, object]:
    return {
        "paradigm": options.paradigm,
        "features": options.features,
        "seed": options.seed,
        "exclude_seconds": options.exclude,
    }


def _print(record: PlacesRecord, out: Path, results: Console, json: bool) -> None:
    if json:
        results.print(metrics_text(record.metrics), markup=False, highlight=False, soft_wrap=True)
        return
    results.print(summary(record))
    results.print(f"Pictures: {out / 'precision_recall.png'}, {out / 'matrix.png'}", markup=False, highlight=False)
