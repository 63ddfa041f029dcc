"""The pipeline: one dataset from its images to its results, with the viewer, the map database and the files.

`run_pipeline` chooses how the run begins, `Pipeline.run` opens and closes what it needs, and `process_dataset` is the
loop over the frames.
"""

import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from rich.console import Console

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.recognizer import takes_color
from slam.components import build_components, check_files, exclude_by_preset, override_config, read_checked_config
from slam.config import RunConfig
from slam.datasets.dataset import Dataset, DatasetSpec, Frame, thumbnail
from slam.datasets.formats.registry import open_for_odometry
from slam.datasets.prefetch import ColorFrames, has_color, prefetch, work_ahead
from slam.diagnostics.dataset_checks import inspect_opened
from slam.diagnostics.findings import Use, remarks_for
from slam.errors import ConfigError, DataError, UnmeasuredError
from slam.evaluation.trajectory_errors import Alignment
from slam.external.matches_file import path_of
from slam.io.folder_lock import check_no_writer
from slam.io.run_folder import RunFolder
from slam.map_database.replay import Build, read_session, replay_components
from slam.map_database.resume import (
    ResumableRun,
    check_dataset,
    check_fits,
    check_same,
    check_unfinished,
    find_resumable_run,
    is_complete,
    read_prior_map,
    reopen_run_folder,
)
from slam.map_database.session_writer import NullSessionRecorder, SessionInfo, SessionRecorder, open_session_recorder
from slam.pipeline.finishing import finish_session
from slam.pipeline.progress import announce_compilation, progress_bar, run_progress, stop_on_interrupt
from slam.pipeline.provenance import provenance
from slam.pipeline.run_warnings import RunWarnings
from slam.pipeline.visualization import VIEWS, RunVisualizer, open_viewer
from slam.report.formatting import describe_motions, metric_value, summary_table
from slam.run_log import RunLog, log_frame, log_to_file
from slam.run_result import RunRecord
from slam.system import Slam
from slam.timing import timed
from slam.viewer.viewer import Viewer

if TYPE_CHECKING:
    from slam.pipeline.result_files import PipelineResult

_WARM_UP_FRAMES = 3  # the first frame with a motion, and one after it
# Of the motions between frames. Drives that work measure 92 % and more, also one camera in the hand that turns away;
# images at 1 Hz, and a right camera that has stopped, leave 10 to 13 %.
_MIN_MEASURED_SHARE = 0.2
_MAX_MATRIX_ROWS = 1500  # of the recogniser's similarity matrix, for a picture of it: 9 MB

log = logging.getLogger("revisit")


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Where a run reads and writes.

    Attributes:
        source: folder or file of the dataset.
        out: folder for the results.
        sequence: name of the sequence in it; None where there is only one.
        view: how to watch the run: none, native or web.
        overwrite: replace the results of an earlier run.
        resume: resume the run into the same folder that has stopped, if there is one.
        map_file: map of earlier sessions to which this one is added, or a run's folder with one; None for none.
        config: settings file; None for the defaults.
        format: format of the source; None to detect it.
        fps: images a second, where no file has their times.
        topics: left and right image topic of a bag; empty to find them.
        command: command line to record for this run; empty for the one that was typed.
        reuse_map: map of the same dataset whose motions and landmarks are replayed; None to measure them.
    """

    source: Path
    out: Path
    sequence: str | None = None
    view: str = "none"
    overwrite: bool = False
    resume: bool = False
    map_file: Path | None = None
    config: Path | None = None
    format: str | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    reuse_map: Path | None = None

    @property
    def recording(self) -> DatasetSpec:
        """What to read."""
        return DatasetSpec(self.source, self.sequence, self.format, self.fps, self.topics)


def run_pipeline(options: RunOptions, settings: Mapping[str, object], messages: Console, results: Console) -> bool:
    """Run the pipeline on a dataset and write every result into `options.out`.

    Args:
        options: where to read and write.
        settings: settings that the command line changes, name to value.
        messages: console for progress and warnings.
        results: console for the summary.

    Returns:
        Whether the run was interrupted from the keyboard; its results so far are written all the same.

    Raises:
        RevisitError: the dataset, the settings or the output folder cannot be used; earlier results stay untouched.
            Also where hardly any motion was measured; then all results are written.
    """
    check_no_writer(options.out)
    stopped = find_resumable_run(options.out) if options.resume else None
    if stopped is not None:
        return Pipeline.resumed(options, settings, stopped).run(messages, results)
    if options.resume and is_complete(options.out):
        messages.print(f"{options.out}: this run is complete, nothing is left to resume", markup=False)
        return False
    if options.map_file is not None:
        return Pipeline.on_map(options, settings, options.map_file).run(messages, results)
    if options.reuse_map is not None:
        return Pipeline.replayed(options, settings, options.reuse_map).run(messages, results)
    return Pipeline.fresh(options, settings).run(messages, results)


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A run that is ready to begin; made by one of `fresh`, `resumed`, `on_map` and `replayed`.

    Attributes:
        options: where to read and write.
        dataset: dataset to process.
        config: the settings.
        run_id: globally unique id (UUID) of the run.
        open_folder: function that opens the folder for the results.
        prior_map: map of earlier sessions to which this one is added; None for none.
        build: function that builds the components.
    """

    options: RunOptions
    dataset: Dataset
    config: RunConfig
    run_id: str
    open_folder: Callable[[], RunFolder]
    prior_map: Path | None = None
    build: Build = build_components

    @classmethod
    def fresh(cls, options: RunOptions, settings: Mapping[str, object]) -> "Pipeline":
        """A run that begins with the first frame and no map."""
        return cls._new(options, resolve_config(options, settings))

    @classmethod
    def resumed(cls, options: RunOptions, settings: Mapping[str, object], stopped: ResumableRun) -> "Pipeline":
        """A run that continues where it stopped.

        Raises:
            RevisitError: the dataset or the settings differ from those of the run.
        """
        config = resolve_config(options, settings, stopped.config)
        dataset = open_for_odometry(options.recording, config.mono)
        config = config.with_depth_of(dataset.has_depth)
        check_same(stopped, dataset, config)
        open_folder = partial(reopen_run_folder, stopped, options.out)
        return cls(options=options, dataset=dataset, config=config, run_id=stopped.run_id, open_folder=open_folder)

    @classmethod
    def on_map(cls, options: RunOptions, settings: Mapping[str, object], map_file: Path) -> "Pipeline":
        """A run that adds a session to a map of earlier sessions.

        Raises:
            RevisitError: the map is damaged, or made with another camera or recogniser.
        """
        prior = read_prior_map(map_file)
        pipeline = cls._new(options, resolve_config(options, settings, prior.config))
        if path_of(pipeline.config.paradigm) is not None:
            raise ConfigError("--map: a file of matches knows no places of earlier drives; leave out one of the two")
        check_fits(prior, pipeline.dataset, pipeline.config)
        return replace(pipeline, prior_map=prior.map_file)

    @classmethod
    def replayed(cls, options: RunOptions, settings: Mapping[str, object], map_file: Path) -> "Pipeline":
        """A run that takes motions and landmarks from a map of the same dataset, and finds the loops again.

        Raises:
            RevisitError: the map is damaged, or of another dataset.
        """
        if not options.source.exists():
            raise DataError(
                f"{options.source}: expected the recording of {map_file}, found nothing; if it was moved, name its "
                "place with --source"
            )
        session = read_session(map_file)
        pipeline = cls._new(options, resolve_config(options, settings, session.config))
        check_dataset(session, pipeline.dataset)
        return replace(pipeline, build=replay_components(map_file))

    @classmethod
    def _new(cls, options: RunOptions, config: RunConfig) -> "Pipeline":
        def open_folder() -> RunFolder:
            if not options.overwrite:
                check_unfinished(options.out)
            return RunFolder.create(options.out, options.overwrite)

        dataset = open_for_odometry(options.recording, config.mono)
        config = config.with_depth_of(dataset.has_depth)
        return cls(options=options, dataset=dataset, config=config, run_id=uuid4().hex, open_folder=open_folder)

    def run(self, messages: Console, results: Console) -> bool:
        """Process the dataset and write the results; whether the run was interrupted.

        Raises:
            DataError: `revisit check` calls something a fault, or a frame cannot be read; those before it are kept.
            UnmeasuredError: hardly any motion was measured; the results are written.
            OutputError: some results could not be written; the others are.
        """
        remarks = check_files(self.config, self.dataset)
        # A part of a run does not take the place of earlier results. (A name that is no path is refused next.)
        replaces = os.access(self.options.out, os.F_OK)
        with self.open_folder() as folder, log_to_file(folder.path / "run.log"), announce_compilation(messages):
            warnings = RunWarnings(messages, folder.path)
            warnings.extend((*remarks, *self._inspect(messages)))
            record, unreadable = self._process(folder, warnings, keep_partial=not replaces)
            folder.commit()
        if unreadable is not None:
            kept = f"the results of the {len(record.timestamps)} frames before it are in {self.options.out}"
            raise DataError(f"{unreadable}; {kept}") from unreadable
        results.print(summary_table(record))
        results.print(f"Report: {self.options.out / 'report.html'}", highlight=False, markup=False)
        if not record.metrics["interrupted"]:
            check_motions(record.metrics, self.options)
        warnings.check_written(self.options.out)
        return bool(record.metrics["interrupted"])

    def _process(
        self, folder: RunFolder, warnings: RunWarnings, keep_partial: bool
    ) -> tuple[RunRecord, DataError | None]:
        """Process the frames and write the results; the record, and the error of a frame that cannot be read."""
        origin = self._provenance()
        info = SessionInfo(self.dataset.name, self.dataset.camera, origin | {"run": self.run_id}, self.prior_map)
        recording = folder.path / "recording.rrd" if self.config.save_recording else None
        with open_session_recorder(folder, self.config, info) as recorder:
            with open_viewer(self.options.view, recording, self.dataset, self.run_id, warnings) as viewer:
                result = process_dataset(
                    self.dataset, self.config, viewer, warnings, recorder, self.build, keep_partial
                )
                # Late: matplotlib, which draws the pictures, takes a third of the time that a command needs to start.
                from slam.pipeline.result_files import make_record, write_results

                with stop_on_interrupt(warnings.messages):
                    record = make_record(result, origin)
                    warnings.attempt_to("end of the recording", lambda: viewer.finish(record))
            log.info("%d frames in %.1f s", len(record.timestamps), result.wall_seconds)
            with stop_on_interrupt(warnings.messages):
                write_results(folder.path, record, result)
        return record, result.unreadable

    def _inspect(self, messages: Console) -> tuple[str, ...]:
        """What `revisit check` says about the dataset; its faults are errors."""
        use = Use.MONO if self.config.mono else Use.STEREO
        with progress_bar(messages, "Checking") as progress:
            findings = inspect_opened(self.dataset, progress, use)
        # An image that cannot be read is said in the same words where it is reached: the frames before it are kept.
        known = [finding for finding in findings if finding.topic != "images"]
        return remarks_for(use, self.options.source, known)

    def _provenance(self) -> dict[str, object]:
        recording = replace(self.options.recording, path=self.options.source.absolute())
        origin = provenance(recording.path, self.dataset.name, self.options.command)
        return origin | {"recording": recording.as_metrics(), "first_image": thumbnail(self.dataset.read_left(0))}


def check_motions(metrics: Mapping[str, object], options: RunOptions) -> None:
    """Check that the trajectory of a run is more than a guess.

    Raises:
        UnmeasuredError: hardly any motion was measured.
    """
    measured, predicted = (int(str(metric_value(metrics, f"motions.{name}"))) for name in ("measured", "predicted"))
    if measured < _MIN_MEASURED_SHARE * (measured + predicted):
        raise UnmeasuredError(
            f"{options.source}: expected motions that the images show, found {describe_motions(metrics)}; the results "
            f"are in {options.out}, but the trajectory is a guess; see: revisit check {options.source}"
        )


def resolve_config(options: RunOptions, settings: Mapping[str, object], base: RunConfig | None = None) -> RunConfig:
    """Configuration of a run: the command line overrides the settings file, which overrides the base or the defaults.

    Args:
        options: where to read and write; they name the settings file.
        settings: settings that the command line changes, name to value.
        base: settings of the run or map that is continued; not used where there is a settings file.

    Raises:
        ConfigError: a setting cannot work.
    """
    if options.view not in VIEWS:
        raise ConfigError(f"--view: expected one of {', '.join(VIEWS)}, found {options.view!r}")
    base = read_checked_config(options.config) if options.config else base or RunConfig()
    return override_config(base, settings)


def process_dataset(
    dataset: Dataset,
    config: RunConfig,
    viewer: Viewer,
    warnings: RunWarnings,
    recorder: SessionRecorder | None = None,
    build: Build = build_components,
    keep_partial: bool = False,
) -> "PipelineResult":
    """Process the frames one by one, from where the recorder's session stopped to the end or an interruption.

    A frame that cannot be read is an interruption if `keep_partial`, unless the recorder keeps the frames before it.

    Raises:
        DataError: otherwise.
    """
    import cv2

    settings = exclude_by_preset(config, dataset.timestamps)
    warm_up(dataset, settings, build)
    cv2.setRNGSeed(config.seed)
    recorder, matrix, run_log = recorder or NullSessionRecorder(), MatrixRecorder(_MAX_MATRIX_ROWS), RunLog()
    components = build(dataset.camera, settings, matrix)
    slam = Slam(recorder.components_in_session(components))
    visualizer, start = RunVisualizer(slam, viewer, dataset, matrix), time.perf_counter()
    num_restored = recorder.restore(slam, matrix, run_log)
    visualizer.restore(run_log)
    unreadable: list[DataError] = []
    shown = ColorFrames(dataset) if takes_color(components.recognizer) and has_color(dataset) else dataset
    read = _until_unreadable(prefetch(shown, begin=num_restored, prepare=slam.describe), unreadable)
    alignment: Alignment = "sim3" if config.mono else "se3"
    watched = run_progress(warnings.messages, len(dataset), dataset.ground_truth, alignment)
    with watched as progress, stop_on_interrupt() as stop:
        frames = takewhile(lambda _: not stop.requested, timed(read, slam.measurement_timer))
        # The odometry of a frame overlaps all else about the frame before it, except where a checkpoint comes: there
        # both stand at the same frame.
        for measured in work_ahead(frames, slam.measure, lambda: not recorder.announce_checkpoint()):
            result = slam.update(measured)
            log_frame(result)
            run_log.add(result, visualizer.show(result))
            recorder.add(result, run_log.stage_ms[-1])
            is_closed = any(candidate.closed for candidate in result.candidates)
            progress.show(result.frame.index, is_closed, slam.components.graph.poses)
        if stop.requested:
            warnings.messages.print(f"Interrupted: finishing with the {len(run_log.timestamps)} frames seen so far.")
    is_cut = stop.requested or bool(unreadable)
    if unreadable and (recorder.frames or not keep_partial or not run_log.timestamps):
        raise unreadable[0]
    with stop_on_interrupt(warnings.messages):
        session = finish_session(slam, config.robust, run_log, recorder, warnings, ended=not is_cut)
    from slam.pipeline.result_files import PipelineResult

    return PipelineResult(
        dataset=dataset,
        config=config,
        components=components,
        run_log=run_log,
        matrix=matrix,
        optimized=session.optimized,
        interrupted=is_cut,
        unreadable=unreadable[0] if unreadable else None,
        warnings=warnings,
        wall_seconds=time.perf_counter() - start,
        num_restored=num_restored,
        merge=session.merge,
    )


def _until_unreadable(frames: Iterator[Frame], unreadable: list[DataError]) -> Iterator[Frame]:
    """Yield frames up to the first that cannot be read, and append its error."""
    try:
        yield from frames
    except DataError as error:
        unreadable.append(error)


def warm_up(dataset: Dataset, config: RunConfig, build: Build = build_components) -> None:
    """Process the first frames with other components, so that no compilation is counted in the timing of the run."""
    slam = Slam(build(dataset.camera, config, None))
    for index in range(min(_WARM_UP_FRAMES, len(dataset))):
        slam.process(dataset[index])
