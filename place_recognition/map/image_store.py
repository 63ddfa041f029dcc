"""What is kept of every image for looking closer later: its strongest features, small."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures

Floats = NDArray[np.float32]

STEPS = 127  # a number of a unit descriptor is kept as a multiple of 1 / STEPS: 0.02 of distance, one byte


@dataclass(frozen=True)
class StoredFeatures:
    """Pixels (N, 2) float32 and descriptors (N, D) float32 of about unit length, strongest first."""

    pixels: Floats
    descriptors: Floats

    def strongest(self, count: int) -> "StoredFeatures":
        """The first so many."""
        return StoredFeatures(self.pixels[:count], self.descriptors[:count])


class ImageStore:
    """Features of all images, by location: 36 kB for 500 features of 64 numbers."""

    def __init__(self, features: int) -> None:
        self._limit = features
        self._images: list[tuple[Floats, NDArray[np.int8]]] = []

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, location: int) -> StoredFeatures:
        pixels, small = self._images[location]
        return StoredFeatures(pixels, small.astype(np.float32) * np.float32(1 / STEPS))

    def add(self, features: LocalFeatures) -> None:
        """Keep the strongest features of the next image."""
        small = np.round(features.descriptors[: self._limit] * STEPS).astype(np.int8)
        self._images.append((features.pixels[: self._limit].copy(), small))
