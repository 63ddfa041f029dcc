"""`--view web` in a headless browser: the drive is shown, and nobody but this machine is asked for anything."""

import time
from urllib.parse import urlsplit
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from slam.report import colours
from slam.viewer import listener
from slam.viewer.rerun_viewer import RerunViewer

from ..report import fabricate
from ..report.browser import NO_BROWSER, WEBGL, browser, has_browser
from .test_rerun_viewer import CAMERA, step

PATIENCE_S = 150.0  # of a software rasterizer on busy cores


@pytest.mark.skipif(not has_browser(), reason=NO_BROWSER)
def test_a_browser_shows_the_drive_and_asks_only_this_machine(caplog):
    record, rng = fabricate.record(60), np.random.default_rng(0)
    viewer = RerunViewer(None, CAMERA, record.ground_truth, "web")
    try:
        for index in range(60):
            viewer.step(step(record, index, rng))
        page = caplog.messages[-1].removeprefix("watch the run at ")
        with browser(WEBGL, console="SEVERE") as shown:
            shown.screen(800, 600)
            shown.visit(page)
            assert wait_for(shown, colours.rgb(colours.ODOMETRY))
            asked = shown.loaded()
            assert {urlsplit(url).hostname for url in asked} == {"127.0.0.1"}
            assert any(url.endswith("ReadMessages") for url in asked)
            assert shown.complaints() == []
    finally:
        viewer.close()


def wait_for(shown, colour) -> bool:
    """Whether a line of that colour gets drawn."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        image = cv2.imdecode(np.frombuffer(shown.driver.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR)
        if (np.abs(image[:, :, ::-1].astype(int) - colour).max(axis=2) < 12).sum() > 100:
            return True
        time.sleep(0.5)
    return False


@pytest.fixture(scope="module")
def served():
    found = listener.listen(web=True)
    yield found
    found.stop()


def test_a_browser_is_told_to_ask_nobody_else(served):
    with urlopen(served.page.address) as answer:
        page, policy = answer.read().decode(), dict(part.split(" ", 1) for part in policies(answer))
    assert '<link rel="icon"' in page
    assert "googleapis" not in page
    data = urlsplit(served.address.removeprefix("rerun+")).netloc
    assert policy["default-src"] == "'self'"
    assert policy["connect-src"] == f"'self' http://{data}"
    assert not any(word in " ".join(policy.values()) for word in ("*", "https:", "http: "))


def policies(answer) -> list[str]:
    return answer.headers["Content-Security-Policy"].split("; ")


def test_what_rerun_does_not_have_is_not_found(served):
    with pytest.raises(OSError, match="404"):
        urlopen(served.page.address.split("?")[0] + "nowhere.js")


def test_a_closed_page_answers_no_more():
    found = listener.listen(web=True)
    found.stop()
    with pytest.raises(OSError, match="refused"):
        urlopen(found.page.address)
