"""One recorded drive from its images to its results: the system, the clock, the viewer and the files."""

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

from rich.console import Console

from place_recognition.evaluation.matrix import MatrixRows
from slam.clock import timed
from slam.config import RunConfig
from slam.datasets.dataset import Dataset
from slam.datasets.described import Described
from slam.datasets.open import open_dataset
from slam.datasets.prefetch import prefetch
from slam.datasets.source import DatasetSpec
from slam.drive_log import DriveLog
from slam.errors import ConfigError, DataError, OutputError
from slam.map_store.keeping import Keeper, NewDrive, NullKeeper, open_keeper
from slam.map_store.known import Known, check_fits, read_known
from slam.map_store.remembered import Build, read_drive, remembering
from slam.map_store.resuming import (
    Stopped,
    check_drive,
    check_same,
    check_unfinished,
    find_stopped,
    is_complete,
    take_over,
)
from slam.parts import build_parts, check_names, read_checked
from slam.progress import progress_bar
from slam.provenance import provenance
from slam.report.tables import summary
from slam.results import Finished, make_record, write_results
from slam.stopping import stop_on_interrupt
from slam.storage.run_folder import RunFolder
from slam.system import LoopAttempt, Processed, Slam
from slam.viewer.viewer import NullViewer, Viewer
from slam.watching import Watcher

log = logging.getLogger("revisit")

_WARM_UP_FRAMES = 3  # the first with a motion, and one after it
_MATRIX_ROWS = 1500  # of the recogniser's matrix, for a picture of it: 9 MB
_OF_PLACES = ("features", "vocabulary", "descriptor")  # settings that belong to place recognition
_HEIGHT = "camera_height"  # of the one camera
VIEWS = ("none", "native", "web")


@dataclass(frozen=True)
class RunOptions:
    """Where a run reads and writes.

    Attributes:
        source: root of the recorded drive.
        sequence: which of its sequences; None where there is only one.
        out: folder for the results.
        view: how to watch: none, native or web.
        overwrite: replace an earlier run.
        resume: go on where a run into the same folder has stopped, if there is one.
        map_file: map of other drives that this one may meet, or a run's folder with one; None for none.
        config: settings file, or None for the defaults.
        kind: of the source; None to recognise it.
        fps: images a second, where no file says when they were taken.
        topics: of a bag, left and right; empty to find them.
        command: that makes this run, where it is not what was typed.
        again: map of the same drive, whose motions and landmarks are taken over; None to measure them.
    """

    source: Path
    sequence: str | None
    out: Path
    view: str = "none"
    overwrite: bool = False
    resume: bool = False
    map_file: Path | None = None
    config: Path | None = None
    kind: str | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    again: Path | None = None

    @property
    def recording(self) -> DatasetSpec:
        """What to read."""
        return DatasetSpec(self.source, self.sequence, self.kind, self.fps, self.topics)


def run_recorded(options: RunOptions, settings: Mapping[str, object], messages: Console, results: Console) -> bool:
    """Run the chain on a recorded drive and write every result into `options.out`.

    Args:
        options: where to read and write.
        settings: what the command line changes in the configuration, field to value.
        messages: for progress and warnings.
        results: for the summary.

    Returns:
        Whether the run was interrupted from the keyboard; its results so far are written all the same.

    Raises:
        RevisitError: the drive, the settings or the output folder cannot be used; earlier results stay untouched.
    """
    stopped = find_stopped(options.out) if options.resume else None
    if options.resume and stopped is None and is_complete(options.out):
        messages.print(f"{options.out}: this run is complete, there is nothing to go on with", markup=False)
        return False
    known = read_known(options.map_file) if options.map_file and not stopped else None
    config = configure(options, settings, _settings_so_far(options, stopped, known))
    drive = open_dataset(options.recording)
    if not drive.has_right and not config.mono:
        raise DataError(
            f"{options.source}: expected left and right images, found left ones only; use one camera with --mono"
        )
    if known:
        check_fits(known, drive, config)
    if options.again:
        check_drive(read_drive(options.again), drive)
    origin = provenance(options.source, drive.name, options.command) | {"recording": options.recording.as_metrics()}
    run = stopped.run if stopped else uuid4().hex
    new = NewDrive(drive.name, drive.camera, origin | {"run": run}, known.map_file if known else None)
    with _folder(options, stopped, drive, config) as folder, run_log(folder.path / "run.log"):
        with (
            open_keeper(folder, config, new) as keeper,
            shown(open_viewer(options, config, drive, folder.path, run), messages) as viewer,
        ):
            build = remembering(options.again) if options.again else build_parts
            finished = drive_through(drive, config, viewer, messages, keeper, build)
            record = make_record(finished, origin)
            viewer.finish(record)
        log.info("%d frames in %.1f s", len(record.timestamps), finished.wall_seconds)
        write_results(folder.path, record, finished)
        folder.commit()
    results.print(summary(record))
    results.print(f"Report: {options.out / 'report.html'}", highlight=False, markup=False)
    return finished.interrupted


def _settings_so_far(options: RunOptions, stopped: Stopped | None, known: Known | None) -> RunConfig | None:
    """Settings of what the run goes on with; None where it begins anew."""
    if stopped or known:
        return (stopped or known).config  # type: ignore[union-attr]
    return read_drive(options.again).config if options.again else None


def _folder(options: RunOptions, stopped: Stopped | None, drive: Dataset, config: RunConfig) -> RunFolder:
    """Where to write: into a new folder, or on into that of a run that stopped."""
    if stopped is not None:
        check_same(stopped, drive, config)
        return take_over(stopped, options.out)
    if not options.overwrite:
        check_unfinished(options.out)
    return RunFolder.create(options.out, options.overwrite)


def configure(options: RunOptions, settings: Mapping[str, object], base: RunConfig | None = None) -> RunConfig:
    """Settings of the file, then of the command line, over the defaults, or over those of a run or map that goes on.

    Raises:
        ConfigError: one of them cannot work.
    """
    if options.view not in VIEWS:
        raise ConfigError(f"--view: expected one of {', '.join(VIEWS)}, found {options.view!r}")
    base = read_checked(options.config) if options.config else base or RunConfig()
    own = {name: value for name, value in settings.items() if name not in (*_OF_PLACES, _HEIGHT)}
    places = {name: value for name, value in settings.items() if name in _OF_PLACES}
    changed = replace(base, **own, places=replace(base.places, **places))  # type: ignore[arg-type]
    return check_names(_with_height(changed, settings[_HEIGHT]) if _HEIGHT in settings else changed)


def _with_height(config: RunConfig, height: object) -> RunConfig:
    """Give the one camera's height above the road, metres."""
    if not config.mono:
        raise ConfigError("--camera-height: gives the scale that one camera lacks; add --mono")
    try:
        odometry = replace(config.one_camera.odometry, height_m=float(height))  # type: ignore[arg-type]
    except ValueError as error:
        raise ConfigError(f"--camera-height: {error}") from error
    return replace(config, one_camera=replace(config.one_camera, odometry=odometry))


def open_viewer(options: RunOptions, config: RunConfig, drive: Dataset, folder: Path, run: str) -> Viewer:
    """Open what shows or records the run of this name."""
    if options.view == "none" and not config.record:
        return NullViewer()
    from slam.viewer.rerun_viewer import RerunViewer

    path = folder / "recording.rrd" if config.record else None
    mode = "record" if options.view == "none" else options.view
    return RerunViewer(path, drive.camera, drive.ground_truth, mode, run)  # type: ignore[arg-type]


@contextmanager
def shown(viewer: Viewer, messages: Console) -> Iterator[Viewer]:
    """Close what shows or records the run in the end. No run loses its results to a recording without room."""
    try:
        yield viewer
    finally:
        try:
            viewer.close()
        except OutputError as error:
            log.warning("%s", error)
            messages.print(str(error), markup=False, highlight=False)


def drive_through(
    drive: Dataset,
    config: RunConfig,
    viewer: Viewer,
    messages: Console,
    keeper: Keeper | None = None,
    build: Build = build_parts,
) -> Finished:
    """Take the frames one by one; what is known when the drive ends, or when the user stops it.

    Begins where the keeper's drive has stopped.
    """
    import cv2

    warm_up(drive, config, build)
    cv2.setRNGSeed(config.seed)
    rows = MatrixRows(_MATRIX_ROWS)
    keeper = keeper or NullKeeper()
    slam = Slam(build(drive.camera, config, rows), keeper.beginning)
    watcher, drive_log, start = Watcher(slam, viewer, drive, rows), DriveLog(), time.perf_counter()
    behind = keeper.recall(slam, rows, drive_log)
    watcher.recall(drive_log)
    with progress_bar(messages, "Driving") as progress, stop_on_interrupt() as stop:
        described = Described(drive, slam.parts.features.extractor)
        for frame, features in timed(prefetch(described, begin=behind), slam.clock):
            processed = slam.process(frame, features)
            note(processed)
            drive_log.add(processed, watcher.show(processed))
            keeper.add(processed, drive_log.stage_ms[-1])
            progress(frame.index + 1, len(drive))
            if stop.made:
                messages.print(f"Interrupted: finishing with the {frame.index + 1} frames seen so far.")
                break
    keeper.pause()
    late, optimized = slam.finish(config.robust)
    note_loops(late)
    drive_log.conclude(late)
    ended = keeper.finish(late, optimized, ended=not stop.made)
    seconds = time.perf_counter() - start
    return Finished(drive, config, slam, drive_log, rows, ended.optimized, stop.made, seconds, behind, ended.met)


def warm_up(drive: Dataset, config: RunConfig, build: Build = build_parts) -> None:
    """Have everything compiled by driving the first frames once, so that the clock counts driving alone."""
    slam = Slam(build(drive.camera, config, None))
    for index in range(min(_WARM_UP_FRAMES, len(drive))):
        slam.process(drive[index])


def note(processed: Processed) -> None:
    """Log what is out of the ordinary about a frame."""
    if processed.motion.predicted:
        log.warning("frame %d: motion predicted, %s", processed.frame.index, processed.motion.reason)
    note_loops(processed.attempts)


def note_loops(attempts: Sequence[LoopAttempt]) -> None:
    """Log what became of each loop that was proposed."""
    for attempt in attempts:
        if attempt.reason:
            verdict = "closed" if attempt.closed else "not closed"
            log.info("loop %d -> %s %s: %s", attempt.belief.query, attempt.belief.match, verdict, attempt.reason)


@contextmanager
def run_log(path: Path) -> Iterator[None]:
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
