"""A street of landmarks and a camera in it: features of images without images, so that each truth is known."""

from dataclasses import dataclass

import numpy as np

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.map.image_history import ImageHistory

FOCAL_PX, WIDTH_PX, HEIGHT_PX = 400.0, 1000.0, 380.0
MAX_FEATURES = 250
NAN = float("nan")


@dataclass(frozen=True)
class View:
    """Features of an image, and the landmark (N,) that each of them shows."""

    features: LocalFeatures
    landmarks: np.ndarray


class LandmarkStreet:
    """House fronts on both sides of a street along z; each landmark is detected within a range of distances."""

    def __init__(self, seed: int = 0, length_m: float = 300.0, per_m: float = 12.0) -> None:
        rng = np.random.default_rng(seed)
        count = int(length_m * per_m)
        side = rng.choice([-1.0, 1.0], count)
        depth_m = rng.uniform(0, length_m, count)
        self._points = np.stack([side * rng.uniform(4, 10, count), rng.uniform(-5, 2, count), depth_m], axis=1)
        self._nearest_m = np.exp(rng.uniform(np.log(4), np.log(14), count))  # seen from there to twice as far away
        self._strength = rng.random(count).astype(np.float32)
        self._descriptors = unit(rng.normal(size=(count, 64)))
        self._rng = rng

    def view(self, z_m: float, x_m: float = 0.0, mirrored: bool = False) -> View:
        """What a camera at z_m, x_m beside the middle of the street, sees along the street; or its mirror image."""
        offset = self._points - np.array([x_m, 0.0, z_m])
        ahead = np.maximum(offset[:, 2], 0.1)
        pixels = FOCAL_PX * offset[:, :2] / ahead[:, None] + np.array([WIDTH_PX, HEIGHT_PX]) / 2
        inside = ((pixels >= 0) & (pixels < [WIDTH_PX, HEIGHT_PX])).all(axis=1)
        seen = np.flatnonzero(inside & (ahead > self._nearest_m) & (ahead < 2 * self._nearest_m))
        seen = seen[np.argsort(-self._strength[seen], kind="stable")][:MAX_FEATURES]
        pixels = pixels[seen] + self._rng.normal(0, 0.3, (len(seen), 2))
        if mirrored:
            pixels[:, 0] = WIDTH_PX - pixels[:, 0]
        noisy = unit(self._descriptors[seen] + self._rng.normal(0, 0.03, (len(seen), 64)))
        return View(make_features(pixels, noisy), seen)


def unit(vectors: np.ndarray) -> np.ndarray:
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def make_features(pixels: np.ndarray, descriptors: np.ndarray) -> LocalFeatures:
    """Features at pixels (N, 2), strongest first."""
    responses = np.linspace(2, 1, len(pixels), dtype=np.float32)
    return LocalFeatures(pixels.astype(np.float32), np.full(len(pixels), 2, np.float32), responses, descriptors)


def unrelated_features(rng: np.random.Generator, count: int = 200) -> LocalFeatures:
    """Features of something that was never seen before, as a lorry that passes."""
    pixels = rng.uniform(0, 1, (count, 2)) * [WIDTH_PX, HEIGHT_PX]
    return make_features(pixels, unit(rng.normal(size=(count, 64))))


def no_features() -> LocalFeatures:
    """Features of a blank image."""
    return make_features(np.empty((0, 2)), np.empty((0, 64), np.float32))


def history_of(features: list[LocalFeatures]) -> ImageHistory:
    """A history of images whose distance is not measured."""
    history = ImageHistory()
    for k, one in enumerate(features):
        history.add(k, one, NAN)
    return history
