"""`revisit doctor`: check of Python, packages and system libraries with remedies, and the licences of all packages.

Uses the standard library only, so that it also runs in a broken installation. `python -m slam.apps.doctor --install`
installs missing system libraries if it has the rights, and `--install-browser` the browser that the tests of the report
need.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata

DISTRIBUTION = "revisit-slam"
MIN_PYTHON = (3, 11)

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


@dataclass(frozen=True)
class Licence:
    """Licence of one installed package.

    Attributes:
        package: name of the package.
        version: installed version.
        licence: SPDX expression if the package gives one, else the name that it uses; "unknown" without either.
        direct: whether Revisit itself requires the package.
    """

    package: str
    version: str
    licence: str
    direct: bool


def check_machine() -> list[Check]:
    """Check everything that the product needs, in the order in which problems should be solved."""
    return [_check_python(), *_check_wheels(), *_check_libraries()]


def _check_python() -> Check:
    found = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info >= MIN_PYTHON:
        return Check("python", found)
    return Check("python", found, "older than 3.11", "make PYTHON=python3.11")


def _check_wheels() -> Iterator[Check]:
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        yield Check(DISTRIBUTION, "", "not installed", f"python -m pip install {DISTRIBUTION}")
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


def licences(distribution: str = DISTRIBUTION) -> list[Licence]:
    """List the packages that a distribution requires, directly or indirectly, by name; without extras.

    Raises:
        importlib.metadata.PackageNotFoundError: the distribution is not installed.
    """
    direct = _requirements(distribution)
    found: dict[str, Licence] = {}
    waiting = sorted(direct)
    while waiting:
        name = waiting.pop()
        if name in found or not _is_installed(name):
            continue
        found[name] = Licence(name, metadata.version(name), declared_licence(metadata.metadata(name)), name in direct)
        waiting += sorted(_requirements(name))
    return [found[name] for name in sorted(found)]


def declared_licence(about: metadata.PackageMetadata) -> str:
    """Read the licence from the metadata of a package: its expression, its classifiers or its first line of text."""
    fields = about.get_all("Classifier") or []
    classified = [field.split(" :: ")[-1] for field in fields if field.startswith("License :: OSI Approved ::")]
    text = (about.get_all("License") or [""])[0].strip()
    expression = about.get_all("License-Expression") or []
    candidates = [*expression, "; ".join(classified), *text.splitlines()[:1]]
    return next((candidate for candidate in candidates if candidate), "unknown")


def _requirements(distribution: str) -> set[str]:
    """Names of the packages that a distribution requires without extras."""
    required = metadata.requires(distribution) or []
    names = (re.match(r"[\w.-]+", line) for line in required if "extra ==" not in line)
    return {re.sub(r"[-_.]+", "-", name.group()).lower() for name in names if name}


def _is_installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:  # required only on another system or Python version
        return False
    return True


_TASKS = {"--install": install_libraries, "--install-browser": install_browser}

if __name__ == "__main__":
    task = next((_TASKS[word] for word in sys.argv if word in _TASKS), None)
    sys.exit(task() if task else any(check.problem for check in check_machine()))
