"""Every script of benchmarks/ and examples/ starts where a newcomer stands, and says what it needs."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

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
    "export_networks": ["aliked-n16", "made", "--repository", NOWHERE],
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


# Starts each script as the interpreter would, in a copy of a process that has loaded the libraries of others: they
# take most of the time of a start, and a script loads them from nowhere else.
_START = """
import json, os, runpy, sys
import cv2, gtsam, numba, numpy, scipy.ndimage, scipy.sparse.linalg, scipy.spatial.transform

def start(script, arguments, output):
    for stream, descriptor in (("stdout", 1), ("stderr", 2)):
        os.dup2(os.open(f"{output}.{stream}", os.O_CREAT | os.O_WRONLY), descriptor)
    sys.argv, sys.path[0] = [script, *arguments], os.path.dirname(script)
    try:
        runpy.run_path(script, run_name="__main__")
    finally:
        sys.stdout.flush()

commands, left = json.loads(sys.argv[1]), len(os.sched_getaffinity(0))
started, codes = {}, {}
def wait():
    child, status = os.wait()
    codes[started.pop(child)] = os.waitstatus_to_exitcode(status)
for name, command in commands.items():
    if len(started) == left:
        wait()
    child = os.fork()
    if not child:
        start(*command)
        sys.exit()
    started[child] = name
while started:
    wait()
print(json.dumps(codes))
"""


@dataclass(frozen=True)
class Finished:
    returncode: int
    stdout: str
    stderr: str


def run_all(commands: dict[str, list[str]], folder: Path) -> dict[str, Finished]:
    """Run scripts side by side, from any folder: a fresh clone has no PYTHONPATH."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    paths = {path.stem: path for path in SCRIPTS}
    with TemporaryDirectory() as outputs:
        asked = {name: (str(paths[name]), words, f"{outputs}/{name}") for name, words in commands.items()}
        starter = [sys.executable, "-c", _START, json.dumps(asked)]
        done = subprocess.run(starter, cwd=folder, env=environment, capture_output=True, text=True, check=True)
        return {
            name: Finished(code, *(Path(f"{outputs}/{name}.{stream}").read_text() for stream in ("stdout", "stderr")))
            for name, code in json.loads(done.stdout).items()
        }


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
