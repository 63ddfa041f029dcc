"""Start rerun's own viewer, as a window or as a web page, bound to this machine.

rerun's SDK starts viewers too (`rr.spawn`, `rr.serve_grpc`, `rr.serve_web_viewer`), but they listen on every interface;
rerun's program takes an address. What the web page loads from the internet: docs/report.md.
"""

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
from urllib.parse import quote

from slam.errors import DataError, OutputError

LOOPBACK = "127.0.0.1"
VIEWER_MEMORY = "2GB"
SERVER_MEMORY = "512MB"  # of the server that passes a live recording on
_START_TIMEOUT_S = 20.0  # a cold start of the viewer takes some seconds
_RECORDINGS = ("recording.rrd", "dense.rrd")
# CI: rerun reports its use to its makers unless switched off, and never where CI is set. The proxy, at a port where
# nobody listens, stops its question for newer releases. Both hold for the window; a browser does not obey them.
_ENVIRONMENT = {"CI": "true", "RERUN_APP_ONLY": "true", "HTTPS_PROXY": f"http://{LOOPBACK}:9"}


@dataclass(frozen=True)
class ViewerProcess:
    """A running viewer.

    Attributes:
        process: rerun's program.
        data_url: address to which a recording is sent.
        page_url: address to open in a browser; None for a window.
    """

    process: subprocess.Popen[bytes]
    data_url: str
    page_url: str | None

    def wait(self) -> None:
        """Wait until the viewer is closed, or until the user interrupts."""
        try:
            self.process.wait()
        finally:
            self.stop()

    def stop(self) -> None:
        """End a web server; a window stays open until the user closes it."""
        if self.page_url is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(timeout=_START_TIMEOUT_S)


def open_recording(run: Path, web: bool) -> ViewerProcess:
    """Show the recording of a run, and of its dense map if there is one, in a window or as a web page.

    Raises:
        DataError: the run has no recording.
        OutputError: no viewer starts, see `start_viewer`.
    """
    files = [run / name for name in _RECORDINGS if (run / name).is_file()]
    if not files:
        raise DataError(
            f"{run}: expected the folder of a run with a recording.rrd, found none; make the run without --no-record"
        )
    return start_viewer(web, files)


def start_viewer(web: bool, files: Sequence[Path] = ()) -> ViewerProcess:
    """Start a viewer that shows files, or waits for data, and return once it listens.

    Raises:
        OutputError: rerun's program is missing, or it ends at once (no display, for instance), or does not answer.
    """
    if not web and sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        raise OutputError(f"rerun: expected a display for its window, found no DISPLAY; {_remedy(files)}")
    ports = [_free_port() for _ in range(2 if web else 1)]
    process = subprocess.Popen(
        _command(ports, files), env={**os.environ, **_ENVIRONMENT}, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=not web,
    )  # fmt: skip
    _wait_until_listening(process, ports, _remedy(files))
    data_url = f"rerun+http://{LOOPBACK}:{ports[0]}/proxy"
    page_url = f"http://{LOOPBACK}:{ports[1]}/?url={quote(data_url, safe='')}" if web else None
    return ViewerProcess(process, data_url, page_url)


def _command(ports: Sequence[int], files: Sequence[Path]) -> list[str]:
    """Return the command line: one port for data, and for a web page a second one."""
    # A recording in a file is kept whole for browsers that come late; a live one loses its oldest data instead.
    memory = ["--memory-limit", VIEWER_MEMORY, "--server-memory-limit", VIEWER_MEMORY if files else SERVER_MEMORY]
    mode = ["--serve-web", "--web-viewer-port", str(ports[1])] if len(ports) > 1 else []
    if not files and not mode:
        mode = ["--expect-data-soon"]
    return [_program(), *map(str, files), "--bind", LOOPBACK, "--port", str(ports[0]), *memory, *mode]


def _program() -> str:
    spec = find_spec("rerun_cli")
    bundled = Path(spec.origin).with_name("rerun") if spec and spec.origin else Path()
    program = str(bundled) if bundled.is_file() else shutil.which("rerun")
    if program is None:
        raise OutputError("rerun: expected its viewer program beside rerun-sdk, found none; reinstall rerun-sdk")
    return program


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _remedy(files: Sequence[Path]) -> str:
    """What to type instead: a finished recording is shown by `revisit view`, a live one by `revisit run`."""
    return "use --web" if files else "use --view web or --view none"


def _wait_until_listening(process: subprocess.Popen[bytes], ports: Sequence[int], remedy: str) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    for port in ports:
        while not _is_listening(port):
            if process.poll() is not None:
                raise OutputError(
                    f"rerun: expected a viewer, but it ended at once with code {process.returncode} "
                    f"(no graphics?); {remedy}"
                )
            if time.monotonic() > deadline:
                process.terminate()
                raise OutputError(
                    f"rerun: expected a viewer on port {port} within {_START_TIMEOUT_S:.0f} s, found none; {remedy}"
                )
            time.sleep(0.05)


def _is_listening(port: int) -> bool:
    try:
        with socket.create_connection((LOOPBACK, port), timeout=1.0):
            return True
    except OSError:
        return False
