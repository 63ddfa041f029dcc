"""Frames with the features of their left images: what is known from an image alone can be found out ahead."""

from dataclasses import dataclass

from place_recognition.image_processing.features import FeatureExtractor, LocalFeatures
from slam.datasets.dataset import Frame
from slam.datasets.prefetch import Recording


@dataclass(frozen=True)
class Described:
    """A drive whose frames are described by whoever reads them (a Recording)."""

    drive: Recording[Frame]
    extractor: FeatureExtractor

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, index: int) -> tuple[Frame, LocalFeatures]:
        """Read a frame, and find the features of its left image.

        Raises:
            DataError: it cannot be read.
        """
        frame = self.drive[index]
        return frame, self.extractor.extract(frame.left)
