"""What a run needs from the machine around it: folders for caches that can be written, and a console for its words.

Standard library only, so that `revisit doctor` can ask in a broken installation. `prepare_caches` runs before numba and
matplotlib are imported, as both read their environment once.
"""

import codecs
import io
import os
import stat
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

NUMBA_CACHE, MATPLOTLIB_CACHE = "NUMBA_CACHE_DIR", "MPLCONFIGDIR"
_PACKAGES = ("odometry", "place_recognition", "slam")
_ROOT = Path(__file__).parents[1]
_SHARED_MEMORY = Path("/dev/shm")  # where a container without a writable /tmp can still write
_ENCODING_ERRORS = "revisit.replace"
# Characters of our own words that a console in Latin-1 or ASCII lacks, and their usual substitutes.
_PLAIN = {"\N{EN DASH}": "-", "\N{EM DASH}": "-", "\N{HORIZONTAL ELLIPSIS}": "...", "\N{BULLET}": "*"}


def prepare_caches() -> None:
    """Point the caches of numba and matplotlib to a private temporary folder where their own cannot be written.

    Without a folder for compiled code numba refuses to define a kernel, so that nothing that computes would start:
    a package installed by root, used by somebody without a home (a container of another user, a cluster module).
    """
    if not can_cache_compiled_code():
        _use_temporary(NUMBA_CACHE, "numba")
    if not can_configure_matplotlib():
        _use_temporary(MATPLOTLIB_CACHE, "matplotlib")


def can_cache_compiled_code() -> bool:
    """Whether numba finds a folder for compiled code: the one that is set, those of our packages, or the home's."""
    named = os.environ.get(NUMBA_CACHE)
    if named and can_create(Path(named)):
        return True
    # The home first: to look at all folders of the packages takes 10 ms at every start.
    return can_create(_cache_home() / "numba") or all(map(can_create, _compiled_folders()))


def _compiled_folders() -> Iterable[Path]:
    """The folders in which numba keeps compiled code, beside the source of our kernels."""
    for package in _PACKAGES:
        for folder, _, names in os.walk(_ROOT / package):
            if any(name.endswith(".py") for name in names):
                yield Path(folder) / "__pycache__"


def can_configure_matplotlib() -> bool:
    """Whether matplotlib can keep its list of fonts."""
    named = os.environ.get(MATPLOTLIB_CACHE)
    if named:
        return can_create(Path(named))
    config = os.environ.get("XDG_CONFIG_HOME")
    return can_create((Path(config) if config else _home() / ".config") / "matplotlib")


def can_create(folder: Path) -> bool:
    """Whether a folder can be written, or made where it is missing."""
    if not folder.is_absolute():
        return False  # without a home, ~ stands for itself: a folder called ~ would appear wherever one works
    nearest = next((place for place in (folder, *folder.parents) if os.path.lexists(place)), folder)
    return nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)


def cache_folder() -> Path:
    """Folder of rendered datasets: `$XDG_CACHE_HOME/revisit`, by default `~/.cache/revisit`, else a temporary one."""
    folder = _cache_home() / "revisit"
    return folder if can_create(folder) else (private_folder("cache") or folder)


def private_folder(name: str) -> Path | None:
    """A temporary folder that only this user can read and write, the same one each time; None if none can be made.

    It is trusted only if nobody else can have put anything there, as numba runs what it finds in its cache.
    """
    for place in _temporary_places():
        folder = place / f"revisit-{os.getuid()}-{name}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            status = folder.lstat()
        except OSError:
            continue
        is_private = stat.S_ISDIR(status.st_mode) and stat.S_IMODE(status.st_mode) == 0o700
        if is_private and status.st_uid == os.getuid() and os.access(folder, os.W_OK | os.X_OK):
            return folder
    return None


def is_temporary(folder: Path) -> bool:
    """Whether a folder is one of those that `private_folder` makes."""
    return folder.name.startswith(f"revisit-{os.getuid()}-")


def _temporary_places() -> list[Path]:
    try:
        places = [Path(tempfile.gettempdir())]
    except FileNotFoundError:  # none can be written
        places = []
    return [*places, _SHARED_MEMORY]


def _use_temporary(variable: str, name: str) -> None:
    folder = private_folder(name)
    if folder is not None:
        os.environ[variable] = str(folder)


def _home() -> Path:
    return Path(os.path.expanduser("~"))  # noqa: PTH111 - Path.home() fails for a user without an entry or HOME


def _cache_home() -> Path:
    named = os.environ.get("XDG_CACHE_HOME")
    return Path(named) if named else _home() / ".cache"


def prepare_consoles() -> None:
    """Let the consoles replace what their encoding lacks, as no word is worth the result of a run."""
    codecs.register_error(_ENCODING_ERRORS, _replace_unknown)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_ENCODING_ERRORS)


class _LastingOutput(io.FileIO):
    """Standard output or error, which goes nowhere once its reader has gone (`revisit run ... | head -1`)."""

    def write(self, data: Any, /) -> int:
        """Write, or point the descriptor to the null device, for child processes too."""
        try:
            return super().write(data)
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)


def outlive_readers() -> None:
    """Let a run go on to its end when the reader of its output has gone: a line that nobody reads costs no result."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper) or stream.isatty():
            continue
        try:
            descriptor = stream.fileno()
        except OSError:  # a stream in memory, which nobody can close
            continue
        stream.flush()
        file = io.BufferedWriter(_LastingOutput(descriptor, "w", closefd=False))
        lasting = io.TextIOWrapper(file, stream.encoding, stream.errors, line_buffering=stream.line_buffering)
        setattr(sys, name, lasting)


def _replace_unknown(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    unknown = error.object[error.start : error.end]
    return "".join(_PLAIN.get(character, "?") for character in unknown), error.end
