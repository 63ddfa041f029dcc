"""`revisit doctor`: check of Python, packages and system libraries with remedies, and the licences of all packages.

Uses the standard library and `slam.environment`, which needs no more, so that it also runs in a broken installation.
`python -m slam.apps.doctor --install` installs missing system libraries if it has the rights, and `--install-browser`
the browser that the tests of the report need.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from slam.environment import (
    MATPLOTLIB_CACHE,
    NUMBA_CACHE,
    can_cache_compiled_code,
    can_configure_matplotlib,
    can_create,
    is_temporary,
)

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

_UNICODE = ("utf-8", "utf8", "utf-16", "utf-32")  # consoles that show every character

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
    return [_check_python(), *_check_wheels(), *_check_libraries(), *_check_surroundings()]


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


def _check_surroundings() -> Iterator[Check]:
    """Check what runs find around them: folders that can be written, and the console."""
    yield _check_cache("compiled code", NUMBA_CACHE, "each container compiles anew, about a minute")
    yield _check_cache("list of fonts", MATPLOTLIB_CACHE, "it is made anew, some seconds")
    yield _check_temporary()
    here = Path.cwd()
    state = "can be written" if can_create(here) else "cannot be written; name another with --out"
    yield Check("this folder", f"{here}: {state}")
    encoding = (sys.stdout.encoding or "unknown").lower()
    plain = "" if encoding in _UNICODE else ": other characters are replaced"
    yield Check("console", f"{encoding}{plain}", remedy="export PYTHONIOENCODING=utf-8" if plain else "")
    yield _check_display()


def _check_cache(name: str, variable: str, cost: str) -> Check:
    """Check the folder of a cache, which `prepare_caches` has chosen."""
    folder = os.environ.get(variable)
    if folder is None:
        is_found = can_cache_compiled_code() if variable == NUMBA_CACHE else can_configure_matplotlib()
        if is_found:
            return Check(name, "kept in the package or in the home")
        return Check(name, "", "no folder for it can be written", f"export {variable}=DIR, with a folder of yours")
    if not is_temporary(Path(folder)):
        return Check(name, f"kept in {folder}, by {variable}")
    found = f"kept in {folder}, as package and home cannot be written; where that is lost, {cost}"
    return Check(name, found, remedy=f"export {variable}=DIR, with a folder that lasts")


def _check_temporary() -> Check:
    try:
        return Check("temporary folder", tempfile.gettempdir())
    except FileNotFoundError:
        return Check("temporary folder", "", "none can be written", "export TMPDIR=DIR, with a folder of yours")


def _check_display() -> Check:
    if sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        return Check("display", "none: give --web to revisit view, and --view web to revisit run")
    return Check("display", "present")


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
