"""The result folder of a run: results appear all at once, and an earlier run is kept until then."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self
from uuid import uuid4

from slam.errors import OutputError
from slam.io.folder_lock import LOCK_FILE, FolderLock, check_no_writer

STAGING = ".unfinished-"
_EARLIER = ".earlier-"

# All files that the commands write. Only these are removed when a run is overwritten; others belong to the user.
_RESULTS = """
metrics.json config.toml run.log report.html recording.rrd before_after.png
map.db trajectory_map.txt trajectory_map.tum frames.csv loops.csv loop_stages.csv loop_events.csv
covariances.npz calibration.toml
trajectory_odometry.txt trajectory_online.txt trajectory_corrected.txt
trajectory_odometry.tum trajectory_online.tum trajectory_corrected.tum
pose_graph_before.g2o pose_graph_after.g2o map_before.ply map_after.ply landmarks.npz
dense_before.ply dense_after.ply mesh_before.ply mesh_after.ply occupancy.png occupancy.yaml
matches.csv matrix.npz matrix.png precision_recall.csv precision_recall.png stages.png optimized.g2o edges.csv
dense.html dense.rrd
"""
RESULTS = frozenset(_RESULTS.split())


@dataclass
class RunFolder:
    """Staging folder of a run's results, a context manager.

    Results are written into `path`, a hidden folder inside `final`, and moved up by `commit`. It is inside and not
    beside, as `final` may be a mounted volume that can neither be renamed nor have siblings. A block that ends without
    commit leaves `final` as it was. A caller that catches KeyboardInterrupt inside the block can still commit. From
    its creation to the end of the block no other process can have one for the same folder.

    Attributes:
        final: the folder that the user named.
        path: the folder to write into; the same as `final` after commit.
    """

    final: Path
    path: Path
    _created: bool
    _lock: FolderLock
    _kept: bool = False

    @classmethod
    def create(cls, path: Path, overwrite: bool) -> Self:
        """Prepare `path` for the results of one run.

        Raises:
            OutputError: `path` is a file, cannot be written, holds anything while overwrite is False, or another
                process writes there.
        """
        check_no_writer(path)
        try:
            if path.exists() and not path.is_dir():
                raise OutputError(f"{path}: expected a folder, found a file; choose another name with --out")
            created = not path.exists()
            held = [] if created else [item.name for item in sorted(path.iterdir()) if not _is_ours(item)]
        except OSError as error:  # a name that is too long, a folder without read permission
            raise OutputError(f"{path}: expected a folder, found: {error.strerror}; choose another") from error
        if held and not overwrite:
            what = "the results of a run" if "metrics.json" in held else f"other files ({held[0]}, ...)"
            raise OutputError(
                f"{path}: expected a new or empty folder, found {what}; choose another folder or give --overwrite"
            )
        staging, lock = _stage(path)
        return cls(path, staging, created, lock)

    @classmethod
    def reopen(cls, path: Path, staging: Path) -> Self:
        """Reopen the staging folder that a stopped run into `path` has left.

        Raises:
            OutputError: another process writes there.
        """
        return cls(path, staging, False, FolderLock.acquire(path), True)

    def keep(self) -> None:
        """Keep the staging folder even without commit, so that a later run can resume."""
        self._kept = True

    def commit(self) -> None:
        """Move the results into place and remove those of an earlier run; other files stay, unless replaced.

        If a move fails, all moves are undone.

        Raises:
            OutputError: the results cannot be moved.
        """
        if self.path == self.final:
            return
        earlier = self.final / f"{_EARLIER}{uuid4().hex[:8]}"
        try:
            earlier.mkdir()
            _move_all(self._moves(earlier))
        except OSError as error:
            raise OutputError(f"{self.final}: cannot be replaced, {error.strerror}; close what uses it") from error
        shutil.rmtree(earlier, ignore_errors=True)
        for left in unfinished(self.final):  # of this run, and of earlier unfinished ones
            shutil.rmtree(left, ignore_errors=True)
        self.path = self.final

    def _moves(self, earlier: Path) -> list[tuple[Path, Path]]:
        new = sorted(self.path.iterdir())
        names = RESULTS | {item.name for item in new}
        old = sorted(item for item in self.final.iterdir() if item.name in names)
        return [(item, earlier / item.name) for item in old] + [(item, self.final / item.name) for item in new]

    def _discard(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        is_done = self.path == self.final or self._kept
        if not is_done:
            self._discard()
        self._lock.release()
        if not is_done and self._created and not any(self.final.iterdir()):
            self.final.rmdir()


def unfinished(path: Path) -> list[Path]:
    """Return the staging folders of runs into `path` that are still running or were killed."""
    try:
        return sorted(path.glob(f"{STAGING}*")) if path.is_dir() else []
    except OSError:  # not a valid file name
        return []


def _move_all(moves: list[tuple[Path, Path]]) -> None:
    done: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            source.rename(target)
            done.append((source, target))
    except BaseException:  # an interruption here must not leave half of each run
        for source, target in reversed(done):
            target.rename(source)
        raise


def _stage(path: Path) -> tuple[Path, FolderLock]:
    """Make the folder if it is missing, lock it, and make a staging folder in it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = FolderLock.acquire(path)
        staging = path / f"{STAGING}{uuid4().hex[:8]}"
        staging.mkdir()
        return staging, lock
    except OSError as error:
        raise OutputError(f"{path}: cannot be written, {error.strerror}; choose another folder") from error


def _is_ours(item: Path) -> bool:
    # Remains of a killed run are no reason to refuse the next one.
    return item.name == LOCK_FILE or item.name.startswith((STAGING, _EARLIER))
