"""A run that stopped before its end: where its map is, and whether this is still the same run."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.config import RunConfig, parse_config
from slam.datasets.dataset import Dataset
from slam.errors import ConfigError, DataError, OutputError
from slam.map_store.store import MAP_FILE, MapStore, Session
from slam.storage.run_folder import STAGING, RunFolder, unfinished


@dataclass(frozen=True)
class Stopped:
    """A run that can go on.

    Attributes:
        map_file: its map store.
        session: the drive that stopped.
        frames: that it has behind it.
    """

    map_file: Path
    session: Session
    frames: int

    @property
    def run(self) -> str:
        """Name of the run, of which there is one in the world."""
        return str(self.session.provenance.get("run"))

    @property
    def config(self) -> RunConfig:
        """The settings it was made with."""
        return parse_config(self.session.config, f"{self.map_file}: settings")


def find_stopped(out: Path) -> Stopped | None:
    """The run into a folder that has come furthest without coming to its end; None where there is none.

    Raises:
        DataError: the only map there is damaged.
    """
    files = [folder / MAP_FILE for folder in (*unfinished(out), out) if (folder / MAP_FILE).is_file()]
    runs = [stopped for stopped in map(_stopped, files) if stopped is not None]
    return max(runs, key=lambda run: run.frames, default=None)


def is_complete(out: Path) -> bool:
    """Whether a folder holds a run that came to its end."""
    if not (out / "metrics.json").is_file() or not (out / MAP_FILE).is_file():
        return False
    with MapStore.open(out / MAP_FILE) as store:
        return all(session.finished for session in store.sessions())


def check_unfinished(out: Path) -> None:
    """Refuse to begin anew where a run can go on.

    Raises:
        OutputError: there is one.
    """
    stopped = find_stopped(out) if unfinished(out) else None
    if stopped is not None:
        raise OutputError(
            f"{out}: expected a new or empty folder, found a run that stopped after {stopped.frames} frames; "
            "go on with --resume, or begin anew with --overwrite"
        )


def take_over(stopped: Stopped, out: Path) -> RunFolder:
    """The folder in which a stopped run goes on. Where that run has left results, they stay until the new ones come.

    Raises:
        OutputError: the map cannot be copied.
    """
    if stopped.map_file.parent != out:
        return RunFolder.reopen(out, stopped.map_file.parent)
    folder = RunFolder.create(out, overwrite=True)
    folder.keep()
    _copy(stopped.map_file, folder.path / MAP_FILE)
    return folder


def check_same(stopped: Stopped, drive: Dataset, config: RunConfig) -> None:
    """Check that what is asked for is the run that stopped.

    Raises:
        ConfigError: other settings.
        DataError: another drive.
    """
    if config != stopped.config:
        raise ConfigError(
            f"{stopped.map_file}: the run was made with other settings than these; leave them out with --resume, "
            "or begin anew with --overwrite"
        )
    check_drive(stopped, drive)


def check_drive(stopped: Stopped, drive: Dataset) -> None:
    """Check that a recording is the one of which a map was made.

    Raises:
        DataError: it is another one.
    """
    with MapStore.open(stopped.map_file) as store:
        times = store.timestamps(stopped.session.number)
    same_times = np.array_equal(drive.timestamps[: stopped.frames], times)  # false, too, where there are fewer
    if drive.camera != stopped.session.camera or not same_times:
        raise DataError(
            f"{stopped.map_file}: expected the drive that it was made of ({stopped.session.provenance.get('source')}, "
            f"{stopped.frames} frames so far), found another; give that one, or begin anew with --overwrite"
        )


def _stopped(file: Path) -> Stopped | None:
    with MapStore.open(file) as store:
        sessions = store.sessions()
        if not sessions:
            return None
        last = sessions[-1]
        complete = last.finished and not file.parent.name.startswith(STAGING)
        return None if complete else Stopped(file, last, store.images(last.number))


def _copy(source: Path, target: Path) -> None:
    with MapStore.open(source) as store:
        store.copy(target)
