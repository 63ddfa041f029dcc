"""The viewer as a web page: it listens on this machine alone, ends with the run, and shows the recording."""

import time
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from slam.report import style
from slam.viewer import viewer_process
from slam.viewer.rerun_viewer import RerunViewer

from ..report import fabricate
from ..report.browser import NO_BROWSER, WEBGL, browser, has_browser
from .test_rerun_viewer import CAMERA, frame_view

TIMEOUT_S = 150.0  # of a software rasterizer on busy cores


@pytest.mark.skipif(not has_browser(), reason=NO_BROWSER)
def test_a_browser_shows_the_drive(caplog):
    record, rng = fabricate.record(60), np.random.default_rng(0)
    viewer = RerunViewer(None, CAMERA, record.ground_truth, "web")
    try:
        for index in range(60):
            viewer.show_frame(frame_view(record, index, rng))
        page_url = caplog.messages[-1].removeprefix("watch the run at ")
        with browser(WEBGL, console="SEVERE") as shown:
            shown.screen(800, 600)
            shown.visit(page_url)
            assert wait_for(shown, style.rgb(style.ODOMETRY))
            local = [url for url in shown.loaded() if urlsplit(url).hostname == "127.0.0.1"]
            assert any(url.endswith("ReadMessages") for url in local)
    finally:
        viewer.close()


def wait_for(shown, colour) -> bool:
    """Whether a line of that colour gets drawn."""
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        image = cv2.imdecode(np.frombuffer(shown.driver.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR)
        if (np.abs(image[:, :, ::-1].astype(int) - colour).max(axis=2) < 12).sum() > 100:
            return True
        time.sleep(0.5)
    return False


def test_the_page_names_the_data_it_shows_and_is_gone_once_it_is_stopped():
    viewer = viewer_process.start_viewer(web=True)
    with urlopen(viewer.page_url) as answer:
        assert b"<canvas" in answer.read()
    query = parse_qs(urlsplit(viewer.page_url).query)
    assert query == {"url": [viewer.data_url]}
    viewer.stop()
    with pytest.raises(OSError, match="refused"):
        urlopen(viewer.page_url)
