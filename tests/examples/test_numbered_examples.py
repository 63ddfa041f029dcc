"""The numbered examples run as they stand, on a tiny drive, and each leaves a picture."""

import csv
import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path

import cv2
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]_*.py"))
FEATURES = ROOT / "examples" / "own_features.py"
ODOMETRY = ROOT / "examples" / "own_odometry.py"
PARTS = ROOT / "examples" / "compare_parts.py"
TINY = ("--width", "256", "--speed", "40")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder for all: the drive is rendered once."""
    return tmp_path_factory.mktemp("examples")


def run(example: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, str(example), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths})


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_leaves_its_picture(example: Path, out: Path):
    tiny = TINY if "street(given)" in example.read_text() else ()
    result = run(example, "--out", str(out), *tiny)
    assert result.returncode == 0, result.stderr
    picture = cv2.imread(str(out / f"{example.stem}.png"))
    assert picture is not None
    assert picture.std() > 10, "an empty picture"
    if example.stem == "5_false_loops":
        assert_that_robust_optimisation_helps(result.stdout)


def test_features_of_ones_own_recognise_places(out: Path):
    result = run(FEATURES, "--out", str(out), *TINY)
    assert result.returncode == 0, result.stderr
    recalls = dict(re.findall(r"(\S+): R@P100 (\S+)", result.stdout))
    assert float(recalls["patch-64"]) > 0.5


def test_an_odometry_of_ones_own_is_corrected_by_the_chain(out: Path):
    result = run(ODOMETRY, "--out", str(out), "--width", "400", "--speed", "10")
    assert result.returncode == 0, result.stderr
    before, after, loops = map(float, re.findall(r"[\d.]+", result.stdout))
    assert loops > 20
    assert after < before


def test_parts_of_other_programs_are_compared_in_one_table(out: Path):
    drive = run(EXAMPLES[0], "--out", str(out), *TINY)  # the drive that the examples share
    assert drive.returncode == 0, drive.stderr
    truth = next(out.glob("drive_*_40/poses/00.txt"))
    result = run(PARTS, "--out", str(out), *TINY, "--trajectory", f"truth={truth}")
    assert result.returncode == 0, result.stderr
    with (out / "compare_parts" / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["odometry"], row["paradigm"], row["robust"]) for row in rows} == set(
        product(["stereo", "file-truth"], ["tracked-words", "file-brightness"], ["none", "pcm+gnc"])
    )
    assert all(float(row["odometry_ate_m"]) < 1e-6 for row in rows if row["odometry"] == "file-truth")
    assert all(float(row["odometry_ate_m"]) > 1e-3 for row in rows if row["odometry"] == "stereo")


@pytest.mark.parametrize("example", [*EXAMPLES, FEATURES, ODOMETRY, PARTS], ids=lambda path: path.stem)
def test_an_example_fits_on_a_screen_or_two(example: Path):
    assert len(example.read_text().splitlines()) <= 80


def test_the_examples_are_numbered_without_gaps():
    assert [path.stem[0] for path in EXAMPLES] == [str(number) for number in range(1, len(EXAMPLES) + 1)]
    assert len(EXAMPLES) >= 6


def assert_that_robust_optimisation_helps(printed: str) -> None:
    errors = {line.split(":")[0]: float(line.split("ATE ")[1].split(" m")[0]) for line in printed.splitlines()}
    assert errors["pcm+gnc"] < errors["odometry"] < errors["none"]
