"""The recording of a run that was stopped and goes on: its parts become one file again."""

import logging
import shutil
import subprocess
import sys
from pathlib import Path

_LOG = logging.getLogger(__name__)

_MERGE_S = 600.0  # a recording of several gigabytes takes a minute


def set_aside(recording: Path) -> None:
    """Rename what an earlier run has recorded, so that the next part does not take its place."""
    if recording.exists():
        recording.rename(recording.with_name(f"{recording.stem}.part-{len(_parts(recording)):03d}{recording.suffix}"))


def join(recording: Path) -> None:
    """Put the parts before a recording in front of it; where that fails they stay, and can be opened together."""
    parts = _parts(recording)
    if not parts:
        return
    whole = recording.with_name(f".whole{recording.suffix}")
    merge = [_rerun(), "rrd", "merge", "--continue-on-error", "-o", str(whole), *map(str, (*parts, recording))]
    try:
        subprocess.run(merge, check=True, capture_output=True, timeout=_MERGE_S)
    except (OSError, subprocess.SubprocessError) as error:
        _LOG.warning("the parts of the recording stay apart (%s); open them together with: rerun *.rrd", error)
        whole.unlink(missing_ok=True)
        return
    whole.replace(recording)
    for part in parts:
        part.unlink()


def _parts(recording: Path) -> list[Path]:
    return sorted(recording.parent.glob(f"{recording.stem}.part-*{recording.suffix}"))


def _rerun() -> str:
    beside = Path(sys.executable).with_name("rerun")
    return str(beside) if beside.exists() else shutil.which("rerun") or "rerun"
