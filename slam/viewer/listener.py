"""Start rerun's own viewer so that it listens on this machine alone, keeps to its memory and phones nobody.

rerun's SDK can spawn and serve too, but then it listens on every interface; its command line takes an
address.
"""

import logging
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from slam.errors import DataError, OutputError
from slam.viewer.web_page import LOOPBACK, WebPage

_LOG = logging.getLogger(__name__)

VIEWER_MEMORY = "2GB"
SERVER_MEMORY = "512MB"
_PATIENCE_S = 20.0  # a cold start of the viewer takes some seconds


@dataclass(frozen=True)
class Listener:
    """A running viewer process.

    Attributes:
        process: the child; a window stays open when the run ends, a web server is stopped with it.
        address: where data is to be sent.
        page: what a browser shows; None for a window.
    """

    process: subprocess.Popen[bytes]
    address: str
    page: WebPage | None

    def wait(self) -> None:
        """Wait until the viewer is closed, or until the user interrupts."""
        try:
            self.process.wait()
        finally:
            self.stop()

    def stop(self) -> None:
        """End a web server; leave a window to the user, who closes it."""
        if self.page is None:
            return
        self.page.close()
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(timeout=_PATIENCE_S)


def open_recording(run: Path, web: bool) -> Listener:
    """Show the recording of a run, and its dense map where it has one, in a window or as a web page.

    Raises:
        DataError: the run has no recording.
        OutputError: see `listen`.
    """
    files = [path for path in (run / "recording.rrd", run / "dense.rrd") if path.is_file()]
    if not files:
        raise DataError(
            f"{run}: expected the folder of a run with a recording.rrd, found none; make the run without --no-record"
        )
    return listen(web, files)


def listen(web: bool, files: Sequence[Path] = ()) -> Listener:
    """Start a viewer, as a window or as a web page, and wait until it takes data, if it has not got files.

    Raises:
        OutputError: rerun's program is missing, ended at once (no display, for instance) or stays silent.
    """
    if not web:
        _require_display()
    port, page_port = free_port(), free_port()
    process = subprocess.Popen(
        _command(web, port, page_port, files), env=_private(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=not web,
    )  # fmt: skip
    _wait(process, [port, page_port] if web else [port])
    page = WebPage(page_port, port) if web else None
    if page is not None:
        _LOG.warning("watch the run at %s", page.address)
    return Listener(process, f"rerun+http://{LOOPBACK}:{port}/proxy", page)


def free_port() -> int:
    """Return a port of the loopback interface that is free just now."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _command(web: bool, port: int, page_port: int, files: Sequence[Path] = ()) -> list[str]:
    kept = VIEWER_MEMORY if files else SERVER_MEMORY  # of a recording that is there all is kept for who comes late
    limits = ["--memory-limit", VIEWER_MEMORY, "--server-memory-limit", kept]
    how = ["--serve-web", "--web-viewer-port", str(page_port)] if web else [] if files else ["--expect-data-soon"]
    return [_program(), *map(str, files), "--bind", LOOPBACK, "--port", str(port), *limits, *how]


def _program() -> str:
    spec = find_spec("rerun_cli")
    binary = Path(spec.origin).with_name("rerun") if spec and spec.origin else Path()
    found = str(binary) if binary.is_file() else shutil.which("rerun")
    if found is None:
        raise OutputError(
            "rerun: expected its viewer program beside rerun-sdk, found none; reinstall or use --view none"
        )
    return found


def _private() -> dict[str, str]:
    # rerun reports its use to its makers unless switched off, and never where CI is set; and it asks for news of its
    # releases, which a proxy that nobody runs keeps from leaving
    nobody = f"http://{LOOPBACK}:9"
    return {**os.environ, "CI": "true", "RERUN_APP_ONLY": "true", "HTTPS_PROXY": nobody, "https_proxy": nobody}


def _require_display() -> None:
    # without one the viewer opens its port before it fails, so waiting for the port does not tell
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise OutputError("rerun: expected a display for its window, found no DISPLAY; use --view web or --view none")


def _wait(process: subprocess.Popen[bytes], ports: list[int]) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while ports:
        if process.poll() is not None:
            raise OutputError(
                f"rerun: expected a viewer, but it ended at once with code {process.returncode} "
                "(no graphics?); use --view web or --view none"
            )
        if time.monotonic() > deadline:
            process.terminate()
            raise OutputError(
                f"rerun: expected a viewer on port {ports[0]} within {_PATIENCE_S:.0f} s; use --view none"
            )
        ports = [port for port in ports if not _answers(port)]
        time.sleep(0.05)


def _answers(port: int) -> bool:
    try:
        with socket.create_connection((LOOPBACK, port), timeout=1.0):
            return True
    except OSError:
        return False
