"""The strongest features of every image, quantised and spilled to disk, for the verification of candidates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import SpillFile
from place_recognition.image_processing.local_features import DESCRIPTOR_STEPS, LocalFeatures

Floats = NDArray[np.float32]
Bytes = NDArray[np.int8]

PIXEL_STEP = 1 / 16  # resolution of stored pixels: a 30th of the distance within which matches agree
FIRST_OCTAVE, OCTAVE_STEPS = -1.0, 32  # scales from half a pixel to 125 are stored to 1 % of themselves in one byte
IN_MEMORY = 512  # latest images kept in memory: 18 MB of 500 SURF features each


@dataclass(frozen=True)
class StoredFeatures:
    """Features of one image as they were stored, strongest first.

    Attributes:
        pixels: (N, 2) float32, x and y to a sixteenth of a pixel (coarser in images of more than 4,096 pixels a side).
        quantized: (N, D) int8, descriptors in steps of 1 / DESCRIPTOR_STEPS.
        octaves: (N,) float32, logarithm to base 2 of the scales in pixels.
    """

    pixels: Floats
    quantized: Bytes
    octaves: Floats

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def descriptors(self) -> Floats:
        """(N, D) float32 of about unit length."""
        return self.quantized.astype(np.float32) * np.float32(1 / DESCRIPTOR_STEPS)

    def strongest(self, count: int) -> "StoredFeatures":
        """Return the `count` strongest features."""
        return StoredFeatures(self.pixels[:count], self.quantized[:count], self.octaves[:count])


class FeatureStore:
    """Features of all images by location (0, 1, 2, ...): 34 kB an image of 500 features of 64 numbers.

    The latest images stay in memory, the older ones in a temporary file that is deleted with the store
    (docs/decisions/feature_spilling.md).
    """

    def __init__(self, features: int, in_memory: int = IN_MEMORY) -> None:
        self._limit, self._in_memory = features, in_memory
        self._records: SpillFile | None = None

    def __len__(self) -> int:
        return 0 if self._records is None else len(self._records)

    @property
    def disk_bytes(self) -> int:
        """Size of the temporary file."""
        return 0 if self._records is None else self._records.disk_bytes

    def __getitem__(self, location: int) -> StoredFeatures:
        record = self._record(location)
        count = int(record["count"])
        pixels = record["pixels"][:count].astype(np.float32) * record["pixel_step"]
        octaves = record["octaves"][:count] * np.float32(1 / OCTAVE_STEPS) + np.float32(FIRST_OCTAVE)
        return StoredFeatures(pixels, record["quantized"][:count].copy(), octaves)

    def count(self, location: int) -> int:
        """Return the number of features stored of the image at a location."""
        return int(self._record(location)["count"])

    def strongest(self, locations: Sequence[int], count: int) -> tuple[Bytes, NDArray[np.int64]]:
        """Return quantised descriptors (L, count, D) of the strongest features at L locations, and their number."""
        dimension = self._records.dtype["quantized"].shape[1] if self._records else 0
        descriptors, counts = np.zeros((len(locations), count, dimension), np.int8), np.zeros(len(locations), np.int64)
        for k, location in enumerate(locations):
            record = self._record(location)
            counts[k] = min(int(record["count"]), count)
            descriptors[k, : counts[k]] = record["quantized"][: counts[k]]
        return descriptors, counts

    def add(self, features: LocalFeatures) -> None:
        """Store the strongest features of the next image.

        Raises:
            ValueError: descriptors of another length than those before.
            OSError: the disk is full.
        """
        count, dimension = min(len(features), self._limit), features.descriptors.shape[1]
        records = self._records or self._begin(dimension)
        record = np.zeros((), records.dtype)
        if record["quantized"].shape[1] != dimension:
            raise ValueError(f"expected descriptors of {record['quantized'].shape[1]} numbers, got {dimension}")
        pixels = features.pixels[:count]
        step = max(PIXEL_STEP, float(pixels.max(initial=0)) / np.iinfo(np.uint16).max)
        record["count"], record["pixel_step"] = count, step
        record["pixels"][:count] = np.round(np.maximum(pixels, 0) / step)
        record["quantized"][:count] = np.round(features.descriptors[:count] * DESCRIPTOR_STEPS)
        steps = OCTAVE_STEPS * (np.log2(np.maximum(features.scales[:count], 1e-6)) - FIRST_OCTAVE)
        record["octaves"][:count] = np.clip(np.round(steps), 0, 255)
        records.append(record)

    def erase(self, location: int) -> None:
        """Forget the features of the image at a location."""
        assert self._records is not None
        self._records.erase(location)

    def _begin(self, dimension: int) -> SpillFile:
        self._records = SpillFile(record_dtype(self._limit, dimension), self._in_memory)
        return self._records

    def _record(self, location: int) -> NDArray[np.void]:
        if self._records is None or not 0 <= location < len(self):
            raise IndexError(f"expected a location below {len(self)}, got {location}")
        return self._records.read(location)

    def state(self) -> NDArray[np.void] | None:
        """All records, for a checkpoint; None before the first image."""
        return None if self._records is None else self._records.state()

    def restore(self, records: NDArray[np.void] | None) -> None:
        """Take over the records of another store into this one, which is empty.

        Raises:
            ValueError: records of another number of features.
        """
        if records is not None:
            dimension = records.dtype["quantized"].shape[-1]
            self._begin(dimension).restore(records)


def record_dtype(features: int, dimension: int) -> np.dtype[np.void]:
    """Return the structured type of the record of one image."""
    return np.dtype(
        [
            ("count", np.int32),
            ("pixel_step", np.float32),
            ("pixels", np.uint16, (features, 2)),
            ("quantized", np.int8, (features, dimension)),
            ("octaves", np.uint8, features),
        ]
    )
