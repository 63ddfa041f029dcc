"""The file of a recording, on a disk that may fill up.

rerun's own writer dies where there is no room, and whoever flushes it then may wait for ever; even the process does not
end. So it writes into a pipe that takes whatever comes, and the file is written here.
"""

import os
import tempfile
import threading
from pathlib import Path

from slam.errors import OutputError
from slam.viewer.parts import join, set_aside

_AT_ONCE = 1 << 16  # bytes: what a pipe holds
_PATIENCE_S = 60.0  # for the rest, once nobody writes any more


class RecordingFile:
    """Keeps what is written into `pipe`, until there is no room; from then on it is thrown away.

    What an earlier part of the same run has left at the path stays in front of it.

    Attributes:
        pipe: path to write to, once.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            set_aside(path)
            self._file = path.open("wb")
            self._folder = tempfile.TemporaryDirectory(prefix="revisit-recording-")
            self.pipe = Path(self._folder.name) / path.name
            os.mkfifo(self.pipe)
        except OSError as error:
            raise OutputError(
                f"{path}: cannot write the recording ({error.strerror}); choose another folder"
            ) from error
        self._problem: OSError | None = None
        self._copying = threading.Thread(target=self._copy, name="recording", daemon=True)
        self._copying.start()

    def close(self) -> None:
        """Wait for the rest, after the writer has closed the pipe.

        Raises:
            OutputError: there was no room; the file is gone.
        """
        self._copying.join(_PATIENCE_S)
        self._folder.cleanup()
        try:
            self._file.close()
        except OSError as error:
            self._problem = self._problem or error
        if self._problem is not None:
            self._path.unlink(missing_ok=True)
            raise OutputError(
                f"{self._path.name}: expected room for the recording, found none ({self._problem.strerror}); it is left"
                " out, make room"
            ) from self._problem
        join(self._path)

    def _copy(self) -> None:
        with self.pipe.open("rb", buffering=0) as pipe:
            while data := pipe.read(_AT_ONCE):
                self._keep(data)

    def _keep(self, data: bytes) -> None:
        if self._problem is not None:
            return
        try:
            self._file.write(data)
        except OSError as error:
            self._problem = error
            self._path.unlink(missing_ok=True)  # room for what is written after it
