"""Depth that lies beside the colour is found with its displacement; depth in its place is not blamed."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.rectification import Size
from slam.diagnostics.dataset_checks import inspect_dataset
from slam.diagnostics.depth_checks import check_depth, measure_depth
from slam.diagnostics.findings import Finding, Inspection, Status, Use

SIZE = (640, 480)
COUNT = 8


def boxes(seed: int, size: Size = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """A room of boxes at depths of their own before a wall, each with its own grey value; image and depth."""
    rng = np.random.default_rng(seed)
    width, height = size
    image, depth = np.full((height, width), 120.0), np.full((height, width), 4.0)
    for z in np.sort(rng.uniform(1.0, 3.0, 12))[::-1]:
        x, y = rng.integers(0, width - 80), rng.integers(0, height - 60)
        w, h = rng.integers(60, width // 3), rng.integers(50, height // 3)
        image[y : y + h, x : x + w], depth[y : y + h, x : x + w] = rng.uniform(30, 220), z
    image += rng.normal(0, 3, image.shape) + 6 * np.sin(np.arange(width) / 7)  # noise, and a pattern that is no edge
    depth += rng.normal(0, 0.002, depth.shape) * depth**2
    depth[rng.random(depth.shape) < 0.1] = np.nan
    return np.clip(image, 0, 255).astype(np.uint8), depth.astype(np.float32)


def moved(depth: np.ndarray, right: int, down: int) -> np.ndarray:
    matrix = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
    size = depth.shape[1], depth.shape[0]
    return cv2.warpAffine(depth, matrix, size, flags=cv2.INTER_NEAREST, borderValue=(np.nan,) * 4)


def place(pairs: list[tuple[np.ndarray, np.ndarray]]) -> Finding:
    return check_depth([measure_depth(depth) for _, depth in pairs], pairs)[2]


@pytest.fixture(scope="module")
def rooms() -> list[tuple[np.ndarray, np.ndarray]]:
    return [boxes(seed) for seed in range(COUNT)]


@pytest.mark.parametrize("by", [(10, 0), (-10, 0), (0, 10), (0, -10), (7, -7), (20, 4)])
def test_a_displacement_is_found_with_its_amount(
    rooms: list[tuple[np.ndarray, np.ndarray]], by: tuple[int, int]
) -> None:
    finding = place([(image, moved(depth, *by)) for image, depth in rooms])
    assert finding.status is Status.WARNING
    assert np.abs(np.array(finding.figures["displacement_px"]) - by).max() <= 1
    words = f"{abs(by[0])} px {'right' if by[0] >= 0 else 'left'}" if by == (10, 0) else "px"
    assert words in finding.text


def test_depth_in_its_place_is_not_blamed(rooms: list[tuple[np.ndarray, np.ndarray]]) -> None:
    for by in ((0, 0), (2, -3)):
        finding = place([(image, moved(depth, *by)) for image, depth in rooms])
        assert finding.status is Status.OK
        assert np.abs(np.array(finding.figures["displacement_px"]) - by).max() <= 1


def test_depth_of_other_images_has_no_place(rooms: list[tuple[np.ndarray, np.ndarray]]) -> None:
    finding = place([(rooms[k][0], rooms[(k + 3) % COUNT][1]) for k in range(COUNT)])
    assert finding.status is Status.WARNING
    assert "depth edges are no edges of the images" in finding.text


def test_a_wall_has_no_edges_to_compare() -> None:
    flat = np.full(SIZE[::-1], 2.0, np.float32)
    assert place([(image, flat) for image, _ in (boxes(k) for k in range(COUNT))]).status is Status.OK


def test_the_displacement_of_larger_images_is_in_their_pixels() -> None:
    large = [boxes(seed, (1280, 960)) for seed in range(COUNT)]
    finding = place([(image, moved(depth, 20, 0)) for image, depth in large])
    assert finding.status is Status.WARNING
    assert np.abs(np.array(finding.figures["displacement_px"]) - (20, 0)).max() <= 2


@pytest.mark.parametrize(
    ("share", "status", "forbids"),
    [(0.9, Status.OK, ()), (0.25, Status.OK, ()), (0.15, Status.WARNING, ()), (0.0, Status.FAULT, (Use.STEREO,))],
)
def test_coverage(share: float, status: Status, forbids: tuple[Use, ...]) -> None:
    depth = np.full((100, 100), np.nan, np.float32)
    depth[: round(100 * share)] = 2.0
    finding = check_depth([measure_depth(depth)], [])[0]
    assert (finding.status, finding.forbids) == (status, forbids)
    assert finding.figures["share"] == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(
    ("metres", "status"), [(0.3, Status.OK), (60.0, Status.OK), (2000.0, Status.WARNING), (0.002, Status.WARNING)]
)
def test_a_median_that_cannot_be(metres: float, status: Status) -> None:
    finding = check_depth([measure_depth(np.full((40, 40), metres, np.float32))], [])[1]
    assert finding.status is status
    assert ("depth_scale" in finding.text) is (status is Status.WARNING)


def write_room(root: Path, by: tuple[int, int] = (0, 0)) -> Path:
    for name in ("rgb", "depth"):
        (root / name).mkdir(parents=True)
    for k in range(COUNT):
        image, depth = boxes(k)
        cv2.imwrite(str(root / f"rgb/{k}.png"), image)
        stored = np.nan_to_num(moved(depth, *by) * 5000).astype(np.uint16)
        cv2.imwrite(str(root / f"depth/{k}.png"), stored)
    for name, lists in (("rgb", "rgb.txt"), ("depth", "depth.txt")):
        (root / lists).write_text("".join(f"{0.1 * k:.1f} {name}/{k}.png\n" for k in range(COUNT)))
    (root / "camera.toml").write_text("fx = 500\nfy = 500\ncx = 319.5\ncy = 239.5\n")
    return root


def checked(path: Path) -> Inspection:
    return inspect_dataset(DatasetSpec(path), lambda done, total: None)


def test_a_depth_camera_serves_for_everything(tmp_path: Path) -> None:
    inspection = checked(write_room(tmp_path / "room"))
    assert inspection.possible_uses == tuple(Use)
    assert {f.topic for f in inspection.findings} >= {"depth", "depth scale", "depth registration"}
    assert all(finding.status is Status.OK for finding in inspection.findings)
    beside = {f.topic: f.status for f in checked(write_room(tmp_path / "beside", (10, 0))).findings}
    assert beside["depth registration"] is Status.WARNING


def test_a_damaged_depth_image_leaves_one_camera(tmp_path: Path) -> None:
    folder = write_room(tmp_path / "room")
    (folder / "depth" / "3.png").write_bytes(b"\x89PNG")
    inspection = checked(folder)
    assert inspection.possible_uses == (Use.MONO, Use.PLACES)
    assert "depth/3.png: expected a depth image" in inspection.reasons_against(Use.STEREO)[0]


def test_without_depth_there_is_one_camera(tmp_path: Path) -> None:
    folder = write_room(tmp_path / "room")
    (folder / "depth.txt").write_text("")
    inspection = checked(folder)
    assert inspection.possible_uses == (Use.MONO, Use.PLACES)
    assert any("the depth is not used" in finding.text for finding in inspection.findings)
