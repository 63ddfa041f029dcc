"""A lock on an output folder, held by the process that writes there: two commands must not undo each other's work.

The lock is an open file: it ends with its process, however that ends. Its text names the process for the message.
"""

import errno
import fcntl
import json
import os
import shlex
import socket
import sys
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

from slam.errors import OutputError

LOCK_FILE = ".revisit.lock"
# What a file system without locks answers, such as some network folders: there the process that is named decides.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@dataclass
class FolderLock:
    """The lock that this process holds on a folder.

    Attributes:
        file: the lock file in the folder.
    """

    file: Path
    _descriptor: int

    @classmethod
    def acquire(cls, folder: Path) -> Self:
        """Lock a folder that exists.

        Raises:
            OutputError: another process holds the lock, or the folder cannot be written.
        """
        file = folder / LOCK_FILE
        while True:
            try:
                descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            except OSError as error:
                raise OutputError(f"{folder}: cannot be written, {error.strerror}; choose another folder") from error
            if not _lock(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise OutputError(_refusal(folder, holder))
            if _is_same(descriptor, file):  # else its former holder has removed it meanwhile
                break
            os.close(descriptor)
        with suppress(OSError):  # a full disk: nameless, but locked
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, json.dumps(_this_process()).encode(), 0)
        return cls(file, descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Remove the lock; a second time does nothing."""
        if self._descriptor < 0:
            return
        self.file.unlink(missing_ok=True)
        os.close(self._descriptor)
        self._descriptor = -1


def check_no_writer(folder: Path) -> None:
    """Check that no live process writes into a folder, which need not exist.

    Raises:
        OutputError: one does.
    """
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CLOEXEC)
    except OSError:  # no folder, no lock, or one that cannot be written, which whoever writes there will say
        return
    try:
        if not _lock(descriptor):
            raise OutputError(_refusal(folder, _holder(descriptor)))
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    """Lock an open file; False where a live process holds it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _NO_LOCKS and not _is_alive(_holder(descriptor))
    return True


def _is_same(descriptor: int, file: Path) -> bool:
    try:
        there, ours = file.stat(), os.fstat(descriptor)
    except FileNotFoundError:
        return False
    return (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)


def _this_process() -> dict[str, object]:
    command = shlex.join(["revisit", *sys.argv[1:]])
    started = datetime.now().astimezone().isoformat(" ", "seconds")
    return {"pid": os.getpid(), "host": socket.gethostname(), "started": started, "command": command}


def _holder(descriptor: int) -> dict[str, object]:
    """The process that a lock file names; empty where it names none."""
    try:
        found = json.loads(os.pread(descriptor, 10_000, 0))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _is_alive(holder: dict[str, object]) -> bool:
    pid = holder.get("pid")
    if holder.get("host") != socket.gethostname() or not isinstance(pid, int) or pid == os.getpid():
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _refusal(folder: Path, holder: dict[str, object]) -> str:
    who = f"process {holder.get('pid', 'of unknown number')} on {holder.get('host', 'an unknown host')}"
    what = f", since {holder['started']}: {holder['command']}" if {"started", "command"} <= holder.keys() else ""
    return f"{folder}: another command writes there ({who}{what}); wait until it ends or choose another folder"
