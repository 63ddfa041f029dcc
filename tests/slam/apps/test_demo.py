"""The demo: where its rendered dataset is kept."""

from pathlib import Path

import pytest
from rich.console import Console

from slam.apps import demo
from slam.simulation.scenario.config import FORMAT


@pytest.fixture
def rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders that the demo asks the simulation for; nothing is rendered."""
    folders: list[Path] = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(demo, "simulate", lambda config, out, progress: folders.append(out) or out)
    return folders


def test_each_version_of_the_simulation_has_a_cache_of_its_own(
    rendered: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    demo.demo_dataset(0, Console(quiet=True))
    monkeypatch.setattr(demo, "FORMAT", FORMAT + 1)
    demo.demo_dataset(0, Console(quiet=True))
    demo.demo_dataset(1, Console(quiet=True))
    assert len(set(rendered)) == 3
    assert {folder.parent for folder in rendered} == {tmp_path / "revisit"}


def test_the_same_demo_is_found_in_the_cache_again(rendered: list[Path]):
    demo.demo_dataset(0, Console(quiet=True))
    demo.demo_dataset(0, Console(quiet=True))
    assert len(set(rendered)) == 1
