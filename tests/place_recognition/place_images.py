"""Images that the tests of this folder look at, and an extractor that describes each of them once."""

from functools import cache
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.recognizer import ObservedImage, Proposals, Proposer

Image = NDArray[np.uint8]

DRIVE_SHAPE = (240, 400)  # of the images of `drive`


def textured_world(width: int, seed: int, height: int = 240) -> Image:
    """A strip (height, width) of blobs of many sizes, the same for the same seed."""
    rng = np.random.default_rng(seed)
    world = np.zeros((height, width), np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), sigma)
        world += layer / layer.std()
    return np.clip(128 + 30 * world, 0, 255).astype(np.uint8)


def sliding_view(world: Image, starts: list[int], width: int = 320) -> list[Image]:
    """Windows of a world that begin at the given columns: a camera that moves sideways."""
    return [np.ascontiguousarray(world[:, s : s + width]) for s in starts]


def drive(count: int, seed: int = 1) -> list[Image]:
    """A camera that slides over a wall and shakes a little, with noise: images of DRIVE_SHAPE."""
    rng, (height, width) = np.random.default_rng(seed), DRIVE_SHAPE
    world = textured_world(width + 6 * count + 20, seed, height + 20)
    images = []
    for k in range(count):
        x, y = 6 * k + rng.integers(0, 20), rng.integers(0, 20)
        noisy = world[y : y + height, x : x + width] + rng.normal(0, 2, DRIVE_SHAPE)
        images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return images


def bonnet(image: Image, index: int) -> Image:
    """The image with the same textured strip over its lowest quarter, whatever its number."""
    height, width = image.shape
    painted = image.copy()
    painted[3 * height // 4 :] = textured_world(width, 99)[: height - 3 * height // 4]
    return painted


def kitti_images(root: Path, sequence: str, frames: range) -> list[Image]:
    """Left images of a KITTI clip."""
    folder = root / "kitti_clips" / "sequences" / sequence / "image_0"
    return [cv2.imread(str(folder / f"{k:06d}.png"), cv2.IMREAD_GRAYSCALE) for k in frames]


def changed(image: Image, seed: int) -> Image:
    """The image as a second pass would see it: moved a little, darker, noisy."""
    rng = np.random.default_rng(seed)
    height, width = image.shape
    moved = cv2.warpAffine(image, np.float32([[1.01, 0, -6], [0, 1.01, 3]]), (width, height), borderMode=2)
    return np.clip(0.85 * moved + rng.normal(0, 2, moved.shape), 0, 255).astype(np.uint8)


def gaussian_blob(
    sigma: float, center: tuple[float, float] = (70.0, 60.0), shape: tuple[int, int] = (128, 144)
) -> Image:
    """One bright blob on black, centred at x and y."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.round(200 * np.exp(-((x - center[0]) ** 2 + (y - center[1]) ** 2) / (2 * sigma**2))).astype(np.uint8)


class CachingSurf(Surf):
    """Extracts the features of each image once for all tests."""

    extracted: ClassVar[dict[tuple[bytes, tuple[int, ...], bytes | None], LocalFeatures]] = {}

    def extract(self, image, mask=None):
        key = image.tobytes(), image.shape, None if mask is None else mask.tobytes()
        if key not in self.extracted:
            self.extracted[key] = super().extract(image, mask)
        return self.extracted[key]


LAP_IMAGES, MIN_AGE = 40, 12  # images of a lap, and of those before a query that may not be matched


@cache
def two_laps() -> list[Image]:
    """Forty images along one path, each with new texture, and the same again."""
    lap = sliding_view(textured_world(1600, seed=8), list(range(0, 31 * LAP_IMAGES, 31)))
    return lap + lap


def observe_image(location: int, image: Image, distance_m: float = float("nan")) -> ObservedImage:
    """An image as a proposer sees it; those less than MIN_AGE before it are not matchable."""
    features = CachingSurf().extract(image)
    return ObservedImage(location, image, features, distance_m, max(location - MIN_AGE, -1))


def observed_images(images: list[Image] | None = None) -> list[ObservedImage]:
    """Images, of two laps where none are given, as a proposer sees them."""
    return [observe_image(k, image) for k, image in enumerate(images or two_laps())]


def make_observed(location: int, descriptors: NDArray[np.float32], last_matchable: int) -> ObservedImage:
    """An image that is nothing but descriptors (N, D)."""
    ones = np.ones(len(descriptors), np.float32)
    features = LocalFeatures(np.zeros((len(descriptors), 2), np.float32), ones, ones, descriptors)
    return ObservedImage(location, np.zeros((8, 8), np.uint8), features, float("nan"), last_matchable)


def propose_all(proposer: Proposer, images: list[ObservedImage]) -> list[Proposals]:
    """The proposals for all images of a recording."""
    return [one for image in images for one in proposer.observe(image)] + proposer.finish()


class SecondCamera:
    """A camera that sees images as a later pass would: its place, exposure and noise differ, and cars stand in it."""

    def __init__(self, hard: int, images: int, seed: int = 0) -> None:
        """A camera for a pass of so many images; hard from 0, no difference, to 5."""
        self._hard, self._rng = hard, np.random.default_rng(seed)
        knots = np.arange(0, images + 30, 30)  # in between everything changes slowly
        drawn = self._rng.uniform(-1, 1, (10, len(knots)))
        self._course = np.array([np.interp(np.arange(images), knots, row) for row in drawn]).T

    def view(self, k: int, image: Image) -> Image:
        """An image (H, W) as image k of the pass."""
        height, width = image.shape
        change, rng = self._course[k], self._rng
        corners = np.float32([[0, 0], [width, 0], [width, height], [0, height]])
        shift = 0.02 * self._hard * change[:8].reshape(4, 2) * [width, height]
        warp = cv2.getPerspectiveTransform(corners, corners + shift.astype(np.float32))
        moved = cv2.warpPerspective(image, warp, (width, height), borderMode=cv2.BORDER_REFLECT)
        bright = 255 * (moved / 255) ** (1 + 0.15 * self._hard * change[8]) * (1 + 0.1 * self._hard * change[9])
        seen = np.clip(bright + rng.normal(0, 2 * self._hard, image.shape), 0, 255).astype(np.uint8)
        if self._hard >= 2:
            car_width, car_height = (
                int(width * rng.uniform(0.1, 0.08 * self._hard)),
                int(height * rng.uniform(0.3, 0.7)),
            )
            left, top = rng.integers(width - car_width), rng.integers(height - car_height)
            seen[top : top + car_height, left : left + car_width] = rng.integers(20, 200)
        return seen
