"""The table over published sets: what is there is measured, and what is missing or odd costs a line."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
COUNT = 14


@pytest.fixture(scope="module")
def example() -> ModuleType:
    sys.path.insert(0, str(EXAMPLES))  # where street.py is
    spec = importlib.util.spec_from_file_location("two_traverses", EXAMPLES / "two_traverses.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["two_traverses"] = module  # where dataclasses look
    spec.loader.exec_module(module)
    sys.path.remove(str(EXAMPLES))
    return module


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same wall as two walks, as photographs with positions, and with a picture that is none."""
    root = tmp_path_factory.mktemp("data")
    noise = np.random.default_rng(5).normal(size=(150, 800)).astype(np.float32)
    world = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 3.0, 6.0))
    grey = np.clip(128 + 45 * world, 0, 255).astype(np.uint8)
    folders = ["gardens_point/day_left", "gardens_point/day_right", "nordland/summer", "nordland/winter"]
    for folder in [*folders, "pitts30k/images/test/queries", "pitts30k/images/test/database"]:
        (root / folder).mkdir(parents=True)
        for k in range(COUNT):
            name = f"@{500000 + 40 * k}.5@4477000.0@17@T@{k}@.png" if "pitts" in folder else f"{k:03d}.png"
            cv2.imwrite(str(root / folder / name), grey[:, 36 * k : 36 * k + 240])
    (root / "nordland" / "winter" / "005.png").write_bytes(b"no picture")
    return root


def test_what_is_there_is_measured_and_the_rest_costs_a_line(
    example: ModuleType, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--data", str(data), "--out", str(tmp_path), "--paradigms", "global-descriptor", "seq-slam"]
    assert example.main(options) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    measured = [line.split() for line in lines if f" {COUNT} " in line]
    assert [(line[0], line[2] if line[0] == "Gardens" else line[1]) for line in measured] == [
        ("Gardens", "day"),
        ("Gardens", "day"),
        ("Pitts30k,", "test"),
    ]
    assert all(" 1.000" in line for line in lines if f" {COUNT} " in line)
    assert sum("not there" in line and "get it from http" in line for line in lines) == len(example.SETS) - 3
    assert sum("005.png" in line for line in captured.err.splitlines()) == 2
    assert (tmp_path / "gardens_point_day_right.seq-slam" / "matches.png").is_file()


def test_without_any_set_it_says_where_to_get_them(
    example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert example.main(["--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().out.count("get it from") == len(example.SETS)
