"""Every script of benchmarks/ and examples/ starts where a newcomer stands, and says what it needs."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted(
    path
    for folder in ("benchmarks", "examples")
    for path in (ROOT / folder).glob("*.py")
    if "__main__" in path.read_text() or path.name[0].isdigit() or path.stem == "own_features"
)
# Of each script that reads something: a command line with a path that leads nowhere.
NOWHERE = "no/such/place"
WRONG_PATHS = {
    "calibrate_place_filter": [NOWHERE, NOWHERE],
    "chain": [NOWHERE],
    "cluster": [NOWHERE],
    "compare_versions": ["compare", NOWHERE, NOWHERE],
    "default_vocabulary": [NOWHERE],
    "dense_map": [NOWHERE],
    "image_descriptors": [NOWHERE, NOWHERE],
    "indoors": [NOWHERE],
    "kill_and_resume": [NOWHERE],
    "long_drive": ["made", "--base", NOWHERE],
    "mono_odometry": [NOWHERE, "00"],
    "odometry_drift": [NOWHERE, "00"],
    "odometry_faults": [NOWHERE, "00"],
    "odometry_memory": [NOWHERE, "00"],
    "odometry_window": [NOWHERE],
    "online_graph": [NOWHERE],
    "orb_vocabulary": [NOWHERE, "--out", "made"],
    "peers": [NOWHERE],
    "places": [NOWHERE],
    "places_at_scale": [NOWHERE, "--out", "made"],
    "places_speed": [NOWHERE],
    "pose_graph": [NOWHERE],
    "published_presets": [NOWHERE, NOWHERE, "10"],
    "rehearsal": [NOWHERE, "--out", "made"],
    "second_drive": [NOWHERE, "--out", "made"],
    "simulation_realism": [NOWHERE],
    "small_cnn": [NOWHERE, "made"],
    "static_regions": [NOWHERE],
    "viewer": [NOWHERE],
    "vocabulary_quality": [NOWHERE],
    "word_index": [NOWHERE],
    "false_loops": [NOWHERE, "--out", "made"],
    "figure_4_16": [NOWHERE, "--out", "made"],
    "table_4_2": ["--data", NOWHERE, "--truth", NOWHERE],
}


def run_all(commands: dict[str, list[str]], folder: Path) -> dict[str, "subprocess.CompletedProcess[str]"]:
    """Run scripts side by side, from any folder: a fresh clone has no PYTHONPATH."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(name: str) -> "subprocess.CompletedProcess[str]":
        (script,) = [path for path in SCRIPTS if path.stem == name]
        command = [sys.executable, str(script), *commands[name]]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        return dict(zip(commands, pool.map(run, commands), strict=True))


def test_every_script_has_a_help_that_is_its_docstring(tmp_path: Path) -> None:
    done = run_all({path.stem: ["--help"] for path in SCRIPTS}, tmp_path)
    assert len(done) > 35
    for name, finished in done.items():
        assert finished.returncode == 0, (name, finished.stderr)
        assert f"usage: {name}.py" in finished.stdout
        assert len(finished.stdout.splitlines()) > 6, name
    assert list(tmp_path.iterdir()) == []


def test_a_path_that_leads_nowhere_is_one_line_that_names_it(tmp_path: Path) -> None:
    for name, finished in run_all(WRONG_PATHS, tmp_path).items():
        assert finished.returncode == 1, (name, finished.stderr)
        (line,) = finished.stderr.splitlines()
        assert NOWHERE in line, name


@pytest.mark.parametrize("script", [path for path in SCRIPTS if path.parent.name == "benchmarks"], ids=lambda p: p.stem)
def test_every_benchmark_that_reads_something_is_tried_with_a_wrong_path(script: Path) -> None:
    assert script.stem in WRONG_PATHS or "existing" not in script.read_text()
