"""The stages that the benchmarks of the odometry time are functions that the odometry has."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SCRIPTS = ("mono_odometry", "odometry_drift")


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_functions_of_all_stages_exist(script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    stages = importlib.import_module(script).STAGES
    assert len(stages) > 3
    assert [name for owner, name, _ in stages if not hasattr(owner, name)] == []
