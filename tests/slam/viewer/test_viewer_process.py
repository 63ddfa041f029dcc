import ipaddress
import sys
from pathlib import Path

import pytest

from odometry.camera import StereoCamera
from slam.errors import DataError, OutputError
from slam.viewer import viewer_process
from slam.viewer.rerun_viewer import RerunViewer

LISTENING = "0A"


def bound_addresses(ports):
    """Return the addresses on which this machine listens on any of the ports."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            _, local, _, state = line.split()[:4]
            address, port = local.split(":")
            if state == LISTENING and int(port, 16) in ports:
                found.add(str(ipaddress.ip_address(bytes.fromhex(address)[::-1])) if len(address) == 8 else address)
    return found


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux to list who listens")
def test_the_web_viewer_listens_on_this_machine_alone_and_stops_with_the_run():
    served = viewer_process.start_viewer(web=True)
    ports = {int(url.split(":")[2].split("/")[0]) for url in (served.data_url, served.page_url)}
    assert bound_addresses(ports) == {"127.0.0.1"}
    served.stop()
    assert bound_addresses(ports) == set()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_a_window_without_a_display_is_an_error_with_a_remedy(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(OutputError, match=r"no DISPLAY; use --view web"):
        viewer_process.start_viewer(web=False)
    with pytest.raises(OutputError, match=r"no DISPLAY; use --web$"):  # `revisit view` has no --view
        viewer_process.start_viewer(web=False, files=[Path("recording.rrd")])


def test_the_window_reports_nothing_and_asks_for_no_releases(monkeypatch):
    started = {}
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer_process.subprocess, "Popen", lambda command, **how: started.update(how, command=command))
    monkeypatch.setattr(viewer_process, "_wait_until_listening", lambda process, ports, remedy: None)
    assert viewer_process.start_viewer(web=False).page_url is None
    assert started["env"]["CI"] == "true"
    assert started["env"]["HTTPS_PROXY"] == "http://127.0.0.1:9"
    assert started["command"][started["command"].index("--bind") + 1] == "127.0.0.1"


def test_a_viewer_that_ends_at_once_is_an_error_with_its_code(monkeypatch):
    monkeypatch.setattr(viewer_process, "_command", lambda ports, files: [sys.executable, "-c", "raise SystemExit(3)"])
    with pytest.raises(OutputError, match=r"ended at once with code 3"):
        viewer_process.start_viewer(web=True)


def test_a_viewer_that_never_listens_is_an_error_and_is_ended(monkeypatch):
    monkeypatch.setattr(
        viewer_process, "_command", lambda ports, files: [sys.executable, "-c", "import time; time.sleep(60)"]
    )
    monkeypatch.setattr(viewer_process, "_START_TIMEOUT_S", 0.2)
    with pytest.raises(OutputError, match=r"expected a viewer on port \d+ within 0 s"):
        viewer_process.start_viewer(web=True)


def test_a_run_is_opened_with_its_dense_map(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(
        viewer_process, "start_viewer", lambda web, files: opened.append((web, [path.name for path in files]))
    )
    with pytest.raises(DataError, match=r"expected the folder of a run with a recording\.rrd, found none"):
        viewer_process.open_recording(tmp_path, web=True)
    (tmp_path / "recording.rrd").touch()
    viewer_process.open_recording(tmp_path, web=False)
    (tmp_path / "dense.rrd").touch()
    viewer_process.open_recording(tmp_path, web=True)
    assert opened == [(False, ["recording.rrd"]), (True, ["recording.rrd", "dense.rrd"])]


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux to list who listens")
def test_a_recording_is_served_on_this_machine_alone_until_the_viewer_ends(tmp_path):
    RerunViewer(tmp_path / "recording.rrd", StereoCamera(120.0, 120.0, 79.5, 29.5, 0.5, 160, 60)).close()
    served = viewer_process.open_recording(tmp_path, web=True)
    ports = {int(url.split(":")[2].split("/")[0]) for url in (served.data_url, served.page_url)}
    assert bound_addresses(ports) == {"127.0.0.1"}
    served.process.terminate()
    served.wait()
    assert bound_addresses(ports) == set()


def test_memory_is_limited():
    command = viewer_process._command([1, 2], [])
    assert command[command.index("--memory-limit") + 1] == "2GB"
    assert command[command.index("--server-memory-limit") + 1] == "512MB"
