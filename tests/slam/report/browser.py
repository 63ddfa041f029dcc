"""A headless Chromium that tells what pages do: what they load and what goes wrong in them."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

NO_BROWSER = "there is no chromium with its chromedriver here: python -m slam.apps.doctor --install-browser"
_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # which Chromium refuses to have as root, as in a container
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--force-device-scale-factor=1",
    "--window-size=1280,900",
)


def has_browser() -> bool:
    """Whether Debian's chromium and chromium-driver are installed."""
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


PAINTED = ("--disable-gpu",)  # of pages that need no WebGL
WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # without graphics hardware


@contextmanager
def browser(graphics: tuple[str, ...] = PAINTED, console: str = "ALL") -> Iterator["Browser"]:
    """A browser that has no page open yet, and keeps what the console gets from such a level on."""
    options = Options()
    options.binary_location = shutil.which("chromium") or ""
    for flag in (*_FLAGS, *graphics):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": console, "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        yield Browser(driver)
    finally:
        driver.quit()


class Browser:
    """Opens pages and asks them what they show."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, path: Path) -> float:
        """Open a file and wait until it has been drawn. Returns the seconds that took."""
        return self.visit(path.absolute().as_uri())

    def visit(self, address: str) -> float:
        """Open an address and wait until it has been drawn. Returns the seconds that took."""
        self.loaded(), self.complaints()
        self.driver.get(address)
        return self.settle() / 1000

    def settle(self) -> float:
        """Wait until the page has done what is due, and has drawn it. Returns the milliseconds since it was opened."""
        return self.driver.execute_async_script(
            "const done = arguments[0];"
            "requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now())));"
        )

    def run(self, script: str, *arguments: object) -> object:
        """What a script returns."""
        return self.driver.execute_script(script, *arguments)

    def loaded(self) -> list[str]:
        """Addresses asked for since this was asked last; data within the page is none."""
        messages = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
        return [url for url in sent if not url.startswith("data:")]

    def complaints(self) -> list[str]:
        """What the console holds since this was asked last."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def theme(self, name: str) -> None:
        """Have the system prefer `light` or `dark` pages."""
        features = [{"name": "prefers-color-scheme", "value": name}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def screen(self, width: int, height: int) -> None:
        """Show pages on a screen of so many pixels."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)

    def press(self, *keys: str) -> None:
        """Press keys where the focus is."""
        self.driver.switch_to.active_element.send_keys(*keys)
        self.settle()
