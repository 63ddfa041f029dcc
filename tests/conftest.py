"""What every test may ask for."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]


def pytest_sessionstart() -> None:
    """Delete the compiled code that is older than any kernel's source.

    Numba compiles a kernel anew when its own file changes, not when that of a function changes which it inlines.
    """
    sources = [path for folder in ("odometry", "place_recognition", "slam") for path in (ROOT / folder).rglob("*.py")]
    newest = max(path.stat().st_mtime for path in sources if "@njit" in path.read_text())
    for folder in {path.parent / "__pycache__" for path in sources}:
        for cached in folder.glob("*.nb[ic]"):
            if cached.stat().st_mtime < newest:
                cached.unlink(missing_ok=True)


# Properties are about truths: how long one example takes on a busy machine says nothing about them.
settings.register_profile("untimed", settings.default, deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def test_data() -> Path:
    """Folder of real recordings; tests that need it are skipped where it is not named."""
    folder = os.environ.get("REVISIT_TEST_DATA")
    if not folder:
        pytest.skip("REVISIT_TEST_DATA does not name the folder of real recordings")
    return Path(folder).resolve()
