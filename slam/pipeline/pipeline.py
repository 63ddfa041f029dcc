"""The pipeline: one dataset from its images to its results, with the viewer, the map database and the files.

The event log of a run, `run.log`: what is out of the ordinary about frames, and what became of each loop.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

from rich.console import Console

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.components import build_components, check_names, read_checked_config
from slam.config import RunConfig
from slam.datasets.dataset import Dataset, DatasetSpec
from slam.datasets.formats.registry import open_dataset
from slam.datasets.prefetch import prefetch
from slam.errors import ConfigError, DataError, OutputError
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
from slam.pipeline.progress import progress_bar, stop_on_interrupt
from slam.pipeline.provenance import provenance
from slam.pipeline.results import PipelineResult, make_record, write_results
from slam.pipeline.visualization import RunVisualizer
from slam.report.formatting import summary_table
from slam.run_log import RunLog
from slam.system import FrameResult, LoopCandidate, Slam
from slam.timing import timed
from slam.viewer.viewer import NullViewer, Viewer

log = logging.getLogger("revisit")


def log_frame(result: FrameResult) -> None:
    """Log what is out of the ordinary about a frame."""
    if result.motion.predicted:
        log.warning("frame %d: motion predicted, %s", result.frame.index, result.motion.reason)
    log_loops(result.candidates)


def log_loops(candidates: Sequence[LoopCandidate]) -> None:
    """Log what became of each loop that was proposed."""
    for candidate in candidates:
        if candidate.reason:
            outcome = "closed" if candidate.closed else "not closed"
            log.info("loop %d -> %s %s: %s", candidate.belief.query, candidate.belief.match, outcome, candidate.reason)


@contextmanager
def log_to_file(path: Path) -> Iterator[None]:
    """Send the log to a file while the block runs."""
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log that a full disk cuts short, and nothing else: the results, which need room too, will say so."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Go on."""


_WARM_UP_FRAMES = 3  # the first frame with a motion, and one after it
_MATRIX_ROWS = 1500  # of the recogniser's similarity matrix, for a picture of it: 9 MB
_PLACE_RECOGNITION_SETTINGS = ("features", "vocabulary", "descriptor")
_CAMERA_HEIGHT = "camera_height"  # setting of the odometry of one camera
VIEWS = ("none", "native", "web")


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Where a run reads and writes.

    Attributes:
        source: root of the dataset.
        out: folder for the results.
        sequence: name of the sequence in it; None where there is only one.
        view: how to watch the run: none, native or web.
        overwrite: replace the results of an earlier run.
        resume: resume the run into the same folder that has stopped, if there is one.
        map_file: map of earlier sessions that this one is added to, or a run's folder with one; None for none.
        config: settings file; None for the defaults.
        format: format of the source; None to detect it.
        fps: images a second, where no file has their times.
        topics: left and right image topic of a bag; empty to find them.
        command: command line of this run, where it is not what was typed.
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
        settings: what the command line changes in the configuration, field to value.
        messages: for progress and warnings.
        results: for the summary.

    Returns:
        Whether the run was interrupted from the keyboard; its results so far are written all the same.

    Raises:
        RevisitError: the dataset, the settings or the output folder cannot be used; earlier results stay untouched.
    """
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
        dataset: what is read.
        config: the settings.
        run_id: globally unique id (UUID) of the run.
        open_folder: opens the folder of the results.
        prior_map: map of earlier sessions that this one is added to; None for none.
        build: builds the components.
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
            RevisitError: the dataset or the settings are others than those of the run.
        """
        config = resolve_config(options, settings, stopped.config)
        dataset = open_dataset_of_run(options, config)

        def open_folder() -> RunFolder:
            check_same(stopped, dataset, config)
            return reopen_run_folder(stopped, options.out)

        return cls(options=options, dataset=dataset, config=config, run_id=stopped.run_id, open_folder=open_folder)

    @classmethod
    def on_map(cls, options: RunOptions, settings: Mapping[str, object], map_file: Path) -> "Pipeline":
        """A run that adds a session to a map of earlier sessions.

        Raises:
            RevisitError: the map is damaged, or made with another camera or recogniser.
        """
        prior = read_prior_map(map_file)
        pipeline = cls._new(options, resolve_config(options, settings, prior.config))
        check_fits(prior, pipeline.dataset, pipeline.config)
        return replace(pipeline, prior_map=prior.map_file)

    @classmethod
    def replayed(cls, options: RunOptions, settings: Mapping[str, object], map_file: Path) -> "Pipeline":
        """A run that takes motions and landmarks from a map of the same dataset, and finds the loops again.

        Raises:
            RevisitError: the map is damaged, or of another dataset.
        """
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

        dataset = open_dataset_of_run(options, config)
        return cls(options=options, dataset=dataset, config=config, run_id=uuid4().hex, open_folder=open_folder)

    def run(self, messages: Console, results: Console) -> bool:
        """Process the dataset and write the results; whether the run was interrupted."""
        options, dataset = self.options, self.dataset
        origin = provenance(options.source, dataset.name, options.command)
        origin |= {"recording": options.recording.as_metrics()}
        info = SessionInfo(dataset.name, dataset.camera, origin | {"run": self.run_id}, self.prior_map)
        with self.open_folder() as folder, log_to_file(folder.path / "run.log"):
            with (
                open_session_recorder(folder, self.config, info) as recorder,
                closing_viewer(self._open_viewer(folder.path), messages) as viewer,
            ):
                result = process_dataset(dataset, self.config, viewer, messages, recorder, self.build)
                record = make_record(result, origin)
                viewer.finish(record)
            log.info("%d frames in %.1f s", len(record.timestamps), result.wall_seconds)
            write_results(folder.path, record, result)
            folder.commit()
        results.print(summary_table(record))
        results.print(f"Report: {options.out / 'report.html'}", highlight=False, markup=False)
        return result.interrupted

    def _open_viewer(self, folder: Path) -> Viewer:
        """Open what shows or records the run."""
        view, dataset = self.options.view, self.dataset
        if view == "none" and not self.config.save_recording:
            return NullViewer()
        from slam.viewer.rerun_viewer import RerunViewer

        path = folder / "recording.rrd" if self.config.save_recording else None
        mode = "record" if view == "none" else view
        return RerunViewer(path, dataset.camera, dataset.ground_truth, mode, self.run_id)  # type: ignore[arg-type]


def open_dataset_of_run(options: RunOptions, config: RunConfig) -> Dataset:
    """Open the dataset of a run.

    Raises:
        DataError: it cannot be read, or has no right images and two cameras are asked for.
    """
    dataset = open_dataset(options.recording)
    if not dataset.has_right and not config.mono:
        raise DataError(
            f"{options.source}: expected left and right images, found left ones only; use one camera with --mono"
        )
    return dataset


def resolve_config(options: RunOptions, settings: Mapping[str, object], base: RunConfig | None = None) -> RunConfig:
    """Settings of the command line over those of the settings file, over the base or else the defaults.

    Args:
        options: with the settings file.
        settings: what the command line changes, field to value.
        base: settings of the run or map that is continued; a settings file takes its place.

    Raises:
        ConfigError: one of them cannot work.
    """
    if options.view not in VIEWS:
        raise ConfigError(f"--view: expected one of {', '.join(VIEWS)}, found {options.view!r}")
    base = read_checked_config(options.config) if options.config else base or RunConfig()
    own = {k: v for k, v in settings.items() if k not in (*_PLACE_RECOGNITION_SETTINGS, _CAMERA_HEIGHT)}
    places = {k: v for k, v in settings.items() if k in _PLACE_RECOGNITION_SETTINGS}
    changed = replace(base, **own, place_recognition=replace(base.place_recognition, **places))  # type: ignore[arg-type]
    return check_names(_with_height(changed, settings[_CAMERA_HEIGHT]) if _CAMERA_HEIGHT in settings else changed)


def _with_height(config: RunConfig, height: object) -> RunConfig:
    """Give the one camera's height above the road, metres."""
    if not config.mono:
        raise ConfigError("--camera-height: gives the scale that one camera lacks; add --mono")
    try:
        odometry = replace(config.mono_odometry.odometry, camera_height_m=float(height))  # type: ignore[arg-type]
    except ValueError as error:
        raise ConfigError(f"--camera-height: {error}") from error
    return replace(config, mono_odometry=replace(config.mono_odometry, odometry=odometry))


@contextmanager
def closing_viewer(viewer: Viewer, messages: Console) -> Iterator[Viewer]:
    """Close the viewer in the end. A recording that cannot be written is a warning: the run keeps its results."""
    try:
        yield viewer
    finally:
        try:
            viewer.close()
        except OutputError as error:
            log.warning("%s", error)
            messages.print(str(error), markup=False, highlight=False)


def process_dataset(
    dataset: Dataset,
    config: RunConfig,
    viewer: Viewer,
    messages: Console,
    recorder: SessionRecorder | None = None,
    build: Build = build_components,
) -> PipelineResult:
    """Process the frames one by one, from where the recorder's session stopped to the end or an interruption."""
    import cv2

    warm_up(dataset, config, build)
    cv2.setRNGSeed(config.seed)
    recorder, matrix, run_log = recorder or NullSessionRecorder(), MatrixRecorder(_MATRIX_ROWS), RunLog()
    components = build(dataset.camera, config, matrix)
    slam = Slam(recorder.components_in_session(components))
    visualizer, start = RunVisualizer(slam, viewer, dataset, matrix), time.perf_counter()
    num_restored = recorder.restore(slam, matrix, run_log)
    visualizer.restore(run_log)

    def handle(result: FrameResult) -> None:
        log_frame(result)
        run_log.add(result, visualizer.show(result))
        recorder.add(result, run_log.stage_ms[-1])

    interrupted = _process_frames(slam, dataset, num_restored, handle, messages)
    recorder.write_checkpoint()
    late, optimized = slam.finish(config.robust)
    log_loops(late)
    run_log.add_loops(late)
    session = recorder.finish(late, optimized, ended=not interrupted)
    return PipelineResult(
        dataset=dataset,
        config=config,
        components=components,
        run_log=run_log,
        matrix=matrix,
        optimized=session.optimized,
        interrupted=interrupted,
        wall_seconds=time.perf_counter() - start,
        num_restored=num_restored,
        merge=session.merge,
    )


def _process_frames(
    slam: Slam, dataset: Dataset, begin: int, handle: Callable[[FrameResult], None], messages: Console
) -> bool:
    """Process the frames from an index on, and hand on each result; whether the user interrupted."""
    with progress_bar(messages, "Driving") as progress, stop_on_interrupt() as stop:
        for frame in timed(prefetch(dataset, begin=begin, prepare=slam.describe), slam.timer):
            handle(slam.process(frame))
            progress(frame.index + 1, len(dataset))
            if stop.requested:
                messages.print(f"Interrupted: finishing with the {frame.index + 1} frames seen so far.")
                return True
    return False


def warm_up(dataset: Dataset, config: RunConfig, build: Build = build_components) -> None:
    """Compile everything by processing the first frames with other components, so that the timing leaves it out."""
    slam = Slam(build(dataset.camera, config, None))
    for index in range(min(_WARM_UP_FRAMES, len(dataset))):
        slam.process(dataset[index])
