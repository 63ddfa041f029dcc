"""The recording file of a run: room on its disk, and merging of the parts of a resumed run.

rerun's own sink writes the file. It must not fill the disk: the results of the run are written after it, and rerun
may wait for ever once its writer has failed on a full disk (docs/decisions/recordings.md).
"""

import logging
import shutil
import subprocess
import sys
from pathlib import Path

from slam.errors import OutputError

_LOG = logging.getLogger(__name__)

# Kept free for the results that are written at the end of the run: the report may take 25 MB, a map 27 bytes a point.
RESERVE_BYTES = 200_000_000
_MERGE_TIMEOUT_S = 600.0  # a recording of several gigabytes takes a minute


def has_room(recording: Path) -> bool:
    """Return whether the disk of a recording has more than the reserve left.

    Raises:
        OutputError: its folder is gone.
    """
    try:
        return shutil.disk_usage(recording.parent).free > RESERVE_BYTES
    except OSError as error:
        raise _unwritable(recording, error) from error


def rotate_recording(recording: Path) -> None:
    """Rename the recording of an earlier part of the run, so that a new one can be written.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        if recording.exists():
            number = len(_parts(recording))
            recording.rename(recording.with_name(f"{recording.stem}.part-{number:03d}{recording.suffix}"))
        recording.touch()  # gives the reason if the folder cannot be written, which rerun does not
    except OSError as error:
        raise _unwritable(recording, error) from error


def merge_recordings(recording: Path) -> None:
    """Merge the earlier parts of a recording into it; if that fails they stay, and can be opened together."""
    parts = _parts(recording)
    if not parts:
        return
    merged = recording.with_name(f".merged{recording.suffix}")
    command = [_rerun(), "rrd", "merge", "--continue-on-error", "-o", str(merged), *map(str, (*parts, recording))]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=_MERGE_TIMEOUT_S)
    except (OSError, subprocess.SubprocessError) as error:
        _LOG.warning("the parts of the recording were not merged (%s); open them together with: rerun *.rrd", error)
        merged.unlink(missing_ok=True)
        return
    merged.replace(recording)
    for part in parts:
        part.unlink()


def _parts(recording: Path) -> list[Path]:
    return sorted(recording.parent.glob(f"{recording.stem}.part-*{recording.suffix}"))


def _rerun() -> str:
    beside = Path(sys.executable).with_name("rerun")
    return str(beside) if beside.exists() else shutil.which("rerun") or "rerun"


def _unwritable(recording: Path, error: OSError) -> OutputError:
    return OutputError(f"{recording}: cannot write the recording ({error.strerror}); choose another folder")
