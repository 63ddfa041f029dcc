"""Atomic writing of files: a file appears complete or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

from slam.errors import OutputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` with the same suffix; the file written there replaces `path` at the end.

    For libraries that need a file name. If the block fails, the temporary file is removed and `path` stays as it was.

    Raises:
        OutputError: the file cannot be written (no such folder, no permission, disk full).
    """
    temporary = path.with_name(f".{path.stem}-{uuid4().hex[:8]}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{path}: cannot be written, {reason}; choose another folder or make room") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_writer(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open `path` to write text ("w": UTF-8, bare line feeds) or bytes ("wb"); it appears at the end.

    Raises:
        OutputError: see `replacing`.
    """
    text = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}
    with replacing(path) as temporary, temporary.open(mode, **text) as file:  # type: ignore[call-overload]
        yield file
