"""Check of the installation: Python, the installed packages and the system libraries, each with its remedy.

Uses the standard library only, so that it also runs in a broken installation. `python -m slam.doctor --install`
installs missing system libraries if it has the rights, and `--install-browser` the browser that the tests of the report
need.
"""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata

MINIMUM_PYTHON = (3, 11)

# System libraries that Open3D's shared object needs (`ldd libOpen3D.so`), and the Debian packages that contain them.
SYSTEM_LIBRARIES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libstdc++.so.6": "libstdc++6",
}

# Programs that only tests need, and the Debian packages that contain them. Without them these tests are skipped.
BROWSER = {"chromium": "chromium", "chromedriver": "chromium-driver"}


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Attributes:
        name: name of the component.
        found: version or state that was found; empty if it is missing.
        problem: description of the problem; empty if there is none.
        remedy: command that solves the problem.
    """

    name: str
    found: str
    problem: str = ""
    remedy: str = ""


def check_machine() -> list[Check]:
    """Check everything that the product needs, in the order in which problems should be solved."""
    return [_check_python(), *_check_wheels(), *_check_libraries()]


def _check_python() -> Check:
    found = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info >= MINIMUM_PYTHON:
        return Check("python", found)
    return Check("python", found, "older than 3.11", "make PYTHON=python3.11")


def _check_wheels() -> Iterator[Check]:
    try:
        requirements = metadata.requires("revisit-slam") or []
    except metadata.PackageNotFoundError:
        yield Check("revisit-slam", "", "not installed", "python -m pip install revisit-slam")
        return
    for requirement in (line for line in requirements if "extra ==" not in line):
        name = requirement.split(">")[0].split("=")[0].strip()
        try:
            yield Check(name, metadata.version(name))
        except metadata.PackageNotFoundError:
            yield Check(name, "", "not installed", f"python -m pip install '{requirement}'")


def _check_libraries() -> Iterator[Check]:
    for library, package in SYSTEM_LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError as error:
            yield Check(library, "", f"cannot be loaded: {error}", _apt_line([package]))
        else:
            yield Check(library, "present")


def _apt_line(packages: list[str]) -> str:
    sudo = "" if os.geteuid() == 0 else "sudo "
    return f"{sudo}apt-get install --yes --no-install-recommends {' '.join(packages)}"


def missing_packages() -> list[str]:
    """List the Debian packages of the system libraries that cannot be loaded."""
    return [SYSTEM_LIBRARIES[check.name] for check in _check_libraries() if check.problem]


def missing_browser() -> list[str]:
    """List the Debian packages of the browser that are not installed."""
    return [package for program, package in BROWSER.items() if shutil.which(program) is None]


def install_libraries() -> int:
    """Install missing system libraries, or print the command for it if rights are missing. Returns an exit code."""
    return _install(missing_packages, "Open3D needs system libraries that are not installed")


def install_browser() -> int:
    """Install the browser of the tests, or print the command for it if rights are missing. Returns an exit code."""
    return _install(missing_browser, "Some tests need a browser that is not installed, and are skipped")


def _install(missing: Callable[[], list[str]], message: str) -> int:
    packages = missing()
    if not packages:
        return 0
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        print(f"{message}. Type:\n  {_apt_line(packages)}", file=sys.stderr)
        return 1
    subprocess.run(["apt-get", "update", "-qq"], check=False)
    quiet = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    done = subprocess.run([*_apt_line(packages).split(), "-qq"], env=quiet, check=False)
    return 1 if done.returncode or missing() else 0


_TASKS = {"--install": install_libraries, "--install-browser": install_browser}

if __name__ == "__main__":
    task = next((_TASKS[word] for word in sys.argv if word in _TASKS), None)
    sys.exit(task() if task else any(check.problem for check in check_machine()))
