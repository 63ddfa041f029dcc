"""`revisit places`: recognise places in a recording, and write matches, precision-recall curves and matrices."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from place_recognition.paradigms.registry import ParadigmsConfig, exclusion_s, with_preset
from place_recognition.recognizer import Belief
from slam.components import (
    check_features,
    check_matches_settings,
    check_paradigm,
    check_preset,
    exclude_time,
    read_mask,
)
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.recording import ImageDataset
from slam.datasets.formats.registry import open_images
from slam.diagnostics.dataset_checks import inspect_images
from slam.diagnostics.findings import Use, remarks_for
from slam.errors import ConfigError
from slam.evaluation.place_metrics import DriveData
from slam.evaluation.revisit_truth_files import (
    RevisitTruth,
    check_truth_size,
    read_revisit_truth,
    revisit_truth_from_poses,
)
from slam.evaluation.trajectory_errors import distances_along
from slam.evaluation.traverse_truth_files import TraverseTruthOptions, resolve_traverse_truth
from slam.external.matches_file import check_matches_file, path_of
from slam.io.metrics import metrics_text
from slam.io.run_folder import RunFolder
from slam.pipeline.place_recognition import (
    PlaceRecognitionRun,
    PlacesRecord,
    RecognizerFactory,
    make_record,
    run_recognizer,
    write_results,
)
from slam.pipeline.places_summary import make_summary
from slam.pipeline.progress import announce_compilation, progress_bar, stop_on_interrupt
from slam.pipeline.provenance import provenance
from slam.pipeline.run_warnings import RunWarnings

# They use no features, so there is nothing that a mask could leave out.
WHOLE_IMAGE_PARADIGMS = ("pixel-sequences", "global-descriptor", "seq-slam")


@dataclass(frozen=True)
class PlacesOptions:
    """Input, output and settings of `revisit places`; the names are those of the command line.

    Attributes:
        source: recording of any supported format.
        paradigm: name of the recogniser.
        out: folder for the results.
        sequence: name of the sequence; None where the source has only one.
        ground_truth: file with a matrix (.mat, .npz) or with poses; None to use the poses of the source.
        features: name of the local features.
        vocabulary: vocabulary file; None for the general vocabulary.
        descriptor: descriptor of `global-descriptor`.
        exclude: minimum age of a match, seconds; None to leave it to the preset.
        fps: images per second, where the source has no timestamps.
        seed: seed of every random generator.
        overwrite: whether to replace earlier results.
        format: format of the source; None to detect it.
        topics: topics of the left camera in a bag; empty to detect them.
        mask: image of the camera's size, black where features are left out; None for none.
        preset: "default", or "published" for the methods as the papers state them.
        reference: another recording, with whose images alone those of `source` are matched; None to match the images
            of `source` with earlier ones of their own.
        reference_sequence: name of its sequence; None where it has only one.
        truth: ground truth of the two, besides `ground_truth`.
        temporal: whether the images around an image have a say in its answer.
    """

    source: Path
    paradigm: str
    out: Path
    sequence: str | None = None
    ground_truth: Path | None = None
    features: str = "surf"
    vocabulary: Path | None = None
    descriptor: str = "hog"
    exclude: float | None = None
    fps: float | None = None
    seed: int = 0
    overwrite: bool = False
    format: str | None = None
    topics: tuple[str, ...] = ()
    mask: Path | None = None
    preset: str = "default"
    reference: Path | None = None
    reference_sequence: str | None = None
    truth: TraverseTruthOptions = field(default_factory=TraverseTruthOptions)
    temporal: bool = True

    @property
    def traverse_truth(self) -> TraverseTruthOptions:
        """How the ground truth of the two recordings is found."""
        return replace(self.truth, ground_truth=self.ground_truth)

    @property
    def reference_recording(self) -> DatasetSpec | None:
        """The reference with the options of how to read it; None without one."""
        if self.reference is None:
            return None
        return DatasetSpec(self.reference, self.reference_sequence, self.format, self.fps, self.topics)

    @property
    def recording(self) -> DatasetSpec:
        """The source with the options of how to read it."""
        return DatasetSpec(self.source, self.sequence, self.format, self.fps, self.topics)


def check_options(options: PlacesOptions) -> None:
    """Raise ConfigError for an unknown name or a number out of range."""
    check_paradigm(options.paradigm)
    check_features(options.features)
    check_preset(options.preset)
    check_matches_settings(options.paradigm, options.preset, trust_poses=False)
    if options.exclude is not None and not 0 <= options.exclude < np.inf:
        raise ConfigError(f"--exclude: expected seconds from 0, found {options.exclude}")
    if options.mask is not None and options.paradigm in WHOLE_IMAGE_PARADIGMS:
        raise ConfigError(
            f"--mask: expected a paradigm of local features, found {options.paradigm}, which compares whole images;"
            " leave the option out or choose another paradigm"
        )
    if options.reference is None:
        _check_no_reference(options)
        return
    options.traverse_truth.check()
    if path_of(options.paradigm) is not None:
        raise ConfigError("--matches: a file matches the images of one recording; leave it out with --reference")
    if options.exclude is not None:
        raise ConfigError("--exclude: no image is matched with one of its own recording; leave it out with --reference")


def _check_no_reference(options: PlacesOptions) -> None:
    given = replace(options.truth, ground_truth=None)
    others = {f"--{f.name.removesuffix('_m').replace('_', '-')}": getattr(given, f.name) for f in fields(given)}
    others["--reference-sequence"] = options.reference_sequence
    name = next((name for name, value in others.items() if value is not None), None)
    if name is not None:
        raise ConfigError(f"{name}: belongs to two recordings; give the other one with --reference")


def recognize_places(options: PlacesOptions, messages: Console, results: Console, json: bool = False) -> bool:
    """Recognise the places of a recording and write every result into `options.out`.

    Args:
        options: input, output and settings.
        messages: console for progress and warnings.
        results: console for the summary.
        json: whether to print the metrics as JSON instead of a table.

    Returns:
        Whether the user interrupted the run; the results so far are written nevertheless.

    Raises:
        RevisitError: the images, the settings or the output folder cannot be used; earlier results stay untouched.
    """
    check_options(options)
    images = open_images(options.recording)
    if options.reference_recording is None:
        record = recognize_images(options, images, resolve_ground_truth(options, images), messages)
    else:
        reference = open_images(options.reference_recording)
        truth = resolve_traverse_truth(options.traverse_truth, images, reference)
        record = recognize_images(options, images, truth, messages, reference)
    _print(record, options.out, results, json)
    return bool(record.metrics["interrupted"])


def recognize_images(
    options: PlacesOptions,
    images: ImageDataset,
    truth: RevisitTruth,
    messages: Console,
    reference: ImageDataset | None = None,
) -> PlacesRecord:
    """Recognise the places of opened images and write every result into `options.out`.

    Args:
        options: input, output and settings.
        images: the recording.
        truth: its ground truth.
        messages: console for progress and warnings.
        reference: images with which alone those of the recording are matched; None for its own earlier ones.

    Raises:
        RevisitError: the images, the settings or the output folder cannot be used; earlier results stay untouched.
    """
    config, matches = _config(options, images), path_of(options.paradigm)
    remarks = () if matches is None else check_matches_file(matches, len(images))
    with RunFolder.create(options.out, options.overwrite) as folder, announce_compilation(messages):
        warnings = RunWarnings(messages, folder.path)
        warnings.extend((*truth.remarks, *remarks, *_inspect(options.source, images, messages)))
        if reference is not None and options.reference is not None:
            warnings.extend(_inspect(options.reference, reference, messages))
        run = _run(options, config, images, truth, messages, reference)
        origin = provenance(options.source.absolute(), images.name) | _settings(options, config)
        pictures = None if reference is None else (images, reference)
        with stop_on_interrupt(messages):
            record = make_record(run, truth, _drive_data(images, truth), origin | {"warnings": warnings.texts})
            write_results(folder.path, record, warnings, pictures)
        folder.commit()
    warnings.check_written(options.out)
    return record


def _inspect(source: Path, images: ImageDataset, messages: Console) -> tuple[str, ...]:
    """What `revisit check` says about the images; its faults are errors."""
    with progress_bar(messages, "Checking") as progress:
        findings = inspect_images(images, progress)
    return remarks_for(Use.PLACES, source, findings)


def resolve_ground_truth(options: PlacesOptions, images: ImageDataset) -> RevisitTruth:
    """Return the ground truth of the option, else that of the recording's own poses, else an unknown truth.

    Raises:
        DataError: the file is missing or damaged, or its size differs from the number of images.
    """
    if options.ground_truth is not None:
        truth = read_revisit_truth(options.ground_truth, image_times=images.timestamps)
    elif images.ground_truth is not None:
        truth = revisit_truth_from_poses(images.ground_truth, f"poses of {options.source}")
    else:
        truth = RevisitTruth(None, "none")
    check_truth_size(truth, len(images), options.source)
    return truth


def drop_recent_matches(beliefs: Sequence[Belief], images: ImageDataset, min_age_s: float | None) -> list[Belief]:
    """Replace beliefs whose match is less than `min_age_s` older than the query by beliefs without match.

    Candidates that are too recent are left out as well.
    """
    times = images.timestamps
    if min_age_s is None or times is None:
        return list(beliefs)

    def is_old_enough(query: int, match: int) -> bool:
        return bool(times[query] - times[match] >= min_age_s)

    return [belief.keep_images(partial(is_old_enough, belief.query)) for belief in beliefs]


def _drive_data(images: ImageDataset, truth: RevisitTruth) -> DriveData:
    path_lengths_m = truth.path_lengths_m
    if path_lengths_m is None and images.ground_truth is not None:
        path_lengths_m = distances_along(images.ground_truth)
    return DriveData(images.timestamps, path_lengths_m)


def _run(
    options: PlacesOptions,
    config: ParadigmsConfig,
    images: ImageDataset,
    truth: RevisitTruth,
    messages: Console,
    reference: ImageDataset | None,
) -> PlaceRecognitionRun:
    import cv2

    first = images if reference is None else reference
    mask = None if options.mask is None else read_mask(options.mask, first[0].shape)
    # Without truth the control can be compared with nothing.
    control_seed = None if truth.matrix is None else options.seed
    factory = RecognizerFactory(options.paradigm, config, control_seed, mask=mask)
    cv2.setRNGSeed(options.seed)
    with progress_bar(messages, "Recognising places") as progress, stop_on_interrupt() as stop:
        run = run_recognizer(images, factory, progress, lambda: stop.requested, reference)
    if run.interrupted:
        messages.print(f"Interrupted: finishing with the {run.images} images seen so far.")
    if reference is not None:
        return run
    exclude = _exclude_s(options)
    control = None if run.control is None else drop_recent_matches(run.control, images, exclude)
    return replace(run, beliefs=drop_recent_matches(run.beliefs, images, exclude), control=control)


def _config(options: PlacesOptions, images: ImageDataset) -> ParadigmsConfig:
    """Return the settings of the paradigm: those of the preset, changed by the options.

    Raises:
        ConfigError: images are excluded by time and have no timestamps.
    """
    vocabulary = "" if options.vocabulary is None else str(options.vocabulary)
    chosen = ParadigmsConfig(
        options.features,
        vocabulary=vocabulary,
        descriptor=options.descriptor,
        seed=options.seed,
        temporal=options.temporal,
        reference=options.reference is not None,
    )
    config, exclude = with_preset(options.paradigm, replace(chosen, preset=options.preset)), _exclude_s(options)
    if not exclude or len(images) < 2 or options.reference is not None:
        return config
    if images.timestamps is None:
        rule = f"--preset {options.preset}, which excludes {exclude:g} s"
        rule = rule if options.exclude is None else f"--exclude {exclude:g}"
        raise ConfigError(f"{rule}: expected times.txt beside the images, found none; give --fps")
    return exclude_time(config, exclude, images.timestamps)


def _exclude_s(options: PlacesOptions) -> float | None:
    """Return the minimum age of a match, seconds: that of the option, else of the preset; None to have no such rule."""
    if options.exclude is not None:
        return options.exclude
    return exclusion_s(options.paradigm, ParadigmsConfig(preset=options.preset)) or None


def _settings(options: PlacesOptions, config: ParadigmsConfig) -> dict[str, object]:
    return {
        "paradigm": options.paradigm,
        "preset": options.preset,
        "features": config.features,
        "seed": options.seed,
        "exclude_seconds": None if options.reference is not None else _exclude_s(options),
        "temporal": options.temporal,
        **({} if options.reference is None else {"reference_source": str(options.reference.absolute())}),
    }


def _print(record: PlacesRecord, out: Path, results: Console, json: bool) -> None:
    if json:
        results.print(metrics_text(record.metrics), markup=False, highlight=False, soft_wrap=True)
        return
    results.print(make_summary(record))
    is_two = "reference" in record.metrics
    names = ("precision_recall.png", "stages.png", "matrix.png", *(("matches.png",) if is_two else ()))
    pictures = ", ".join(str(out / name) for name in names)
    results.print(f"Pictures: {pictures}", markup=False, highlight=False)
