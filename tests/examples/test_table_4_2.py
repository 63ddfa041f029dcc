"""Table 4.2 fills from whatever recordings there are."""

import importlib.util
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from scipy.io import savemat

LAP = 25
EXAMPLE = Path(__file__).parents[2] / "examples" / "table_4_2.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    import sys

    spec = importlib.util.spec_from_file_location("table_4_2", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["table_4_2"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A City Centre of two laps, whose right camera sees nothing; KITTI without images; a truth for one of them."""
    root = tmp_path_factory.mktemp("data")
    noise = np.random.default_rng(5).normal(size=(150, 1200)).astype(np.float32)
    world = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 3.0, 6.0))
    grey = np.clip(128 + 45 * world, 0, 255).astype(np.uint8)
    (root / "city_centre").mkdir()
    for k in range(2 * LAP):
        view = grey[:, 36 * (k % LAP) : 36 * (k % LAP) + 240]
        cv2.imwrite(str(root / "city_centre" / f"{2 * k + 1:04d}.jpg"), view)
        cv2.imwrite(str(root / "city_centre" / f"{2 * k + 2:04d}.jpg"), np.zeros_like(view))
    (root / "kitti").mkdir()
    savemat(root / "groundTruthCityCentre.mat", {"truth": np.eye(2 * LAP, k=-LAP)})
    return root


def fill(example: ModuleType, data: Path, out: Path, *more: str) -> int:
    example.EXCLUDE_S = {"default": 3.0, "published": None}  # the drive lasts seven seconds
    return example.main(["--data", str(data), "--truth", str(data), "--out", str(out), *more])


def test_what_is_there_is_measured_and_what_is_missing_is_named(
    example: ModuleType, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fill(example, data, tmp_path, "--paradigms", "tracked-words") == 0
    table, messages = capsys.readouterr()
    published, preset, default = table.splitlines()[2].split("  ")[-1].strip().split(" / ")
    assert published == "20.0"
    assert float(default) > 60
    assert 0 < float(preset) < float(default)  # their exclusion of 2c leaves few of these 25 images
    assert "KITTI 00: left out." in messages
    assert "malaga_6L: expected the recording, found nothing; data/README.md says where to get it" in messages
    assert {"table_4_2.txt", "table_4_2.tex", "table_4_2.png"} <= {path.name for path in tmp_path.iterdir()}


def test_a_cell_is_kept(example: ModuleType, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, recall in (("tracked-words", 0.123), ("tracked-words-published", 0.4)):
        cell = tmp_path / "City Centre" / folder
        cell.mkdir(parents=True)
        (cell / "metrics.json").write_text(f'{{"places": {{"recall_at_100_precision": {recall}}}}}')
    assert fill(example, data, tmp_path, "--paradigms", "tracked-words") == 0
    assert "20.0 / 40.0 / 12.3" in (tmp_path / "table_4_2.txt").read_text()


def test_a_truth_of_another_size_is_an_error_that_names_both(
    example: ModuleType, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    savemat(tmp_path / "groundTruthCityCentre.mat", {"truth": np.eye(9, k=-3)})
    arguments = ["--data", str(data), "--truth", str(tmp_path), "--out", str(tmp_path / "out")]
    assert example.main(arguments) == 1
    assert "expected a truth of 50 images" in capsys.readouterr().err


def test_an_unknown_paradigm_is_a_usage_error(
    example: ModuleType, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fill(example, data, tmp_path, "--paradigms", "guess") == 2
    assert "unknown paradigm guess" in capsys.readouterr().err
