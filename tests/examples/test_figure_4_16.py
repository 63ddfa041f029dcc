"""Figure 4.16 is drawn from any recording with a truth: both panels, every paradigm, and the control."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
LAP = 15


@pytest.fixture(scope="module")
def example() -> ModuleType:
    sys.path.insert(0, str(EXAMPLES))  # where street.py is
    spec = importlib.util.spec_from_file_location("figure_4_16", EXAMPLES / "figure_4_16.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(EXAMPLES))
    return module


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two laps past a wall of blobs, and which images of them show the same."""
    root = tmp_path_factory.mktemp("hall")
    noise = np.random.default_rng(5).normal(size=(150, 800)).astype(np.float32)
    world = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 3.0, 6.0))
    grey = np.clip(128 + 45 * world, 0, 255).astype(np.uint8)
    (root / "images").mkdir()
    for k in range(2 * LAP):
        cv2.imwrite(str(root / "images" / f"{k:03d}.png"), grey[:, 36 * (k % LAP) : 36 * (k % LAP) + 240])
    np.savez(root / "truth.npz", truth=np.eye(2 * LAP, k=-LAP))
    return root


def test_each_paradigm_and_the_control_are_drawn_and_printed(
    example: ModuleType, hall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--ground-truth", str(hall / "truth.npz"), "--out", str(tmp_path)]
    assert example.main([str(hall / "images"), *options, "--paradigms", "tracked-words", "pixel-sequences"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in printed] == ["tracked-words", "pixel-sequences", "random images"]
    picture = cv2.imread(str(tmp_path / "figure_4_16.png"))
    assert picture is not None
    assert picture.std() > 10
    assert (tmp_path / "tracked-words" / "stages.png").is_file()


def test_a_source_that_is_none_is_one_line(
    example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert example.main([str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
