"""What every test may ask for."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

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
