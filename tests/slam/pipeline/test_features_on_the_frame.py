"""Features extracted by the thread that reads ahead are those of the system, and no image is described twice."""

import threading
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from place_recognition.image_processing.extractors import EXTRACTORS, make_extractor
from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures
from slam.components import build_components
from slam.config import RunConfig
from slam.datasets.formats.kitti import open_kitti
from slam.datasets.prefetch import prefetch
from slam.system import Slam

FRAMES = 12


@dataclass
class CountingExtractor:
    """An extractor that records which threads have called it."""

    inner: FeatureExtractor
    threads: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        return self.inner.kind

    def extract(self, image: np.ndarray, mask: np.ndarray | None = None) -> LocalFeatures:
        self.threads.append(threading.current_thread().name)
        return self.inner.extract(image, mask)


def same(one: LocalFeatures, other: LocalFeatures) -> bool:
    pairs = [(one.pixels, other.pixels), (one.scales, other.scales), (one.descriptors, other.descriptors)]
    return all(np.array_equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("name", sorted(EXTRACTORS))
def test_another_thread_extracts_the_same_features(circle_drive: Path, name: str):
    dataset, extractor = open_kitti(circle_drive), make_extractor(name)
    for frame in islice(prefetch(dataset, prepare=lambda frame: frame.with_features(extractor)), 4):
        assert frame.features is not None
        assert same(frame.features, extractor.extract(frame.left))


def test_existing_features_are_not_extracted_again(circle_drive: Path):
    extractor = CountingExtractor(make_extractor("surf"))
    frame = open_kitti(circle_drive)[0].with_features(extractor)
    assert frame.with_features(extractor) is frame
    assert len(extractor.threads) == 1


@pytest.mark.parametrize("ahead", [True, False], ids=["read ahead", "in the system"])
def test_features_of_an_image_are_extracted_once_for_all_stages(circle_drive: Path, ahead: bool):
    dataset, config = open_kitti(circle_drive), RunConfig(paradigm="tracked-words")
    expected = Slam(build_components(dataset.camera, config))
    slam = Slam(build_components(dataset.camera, config))
    extractor = CountingExtractor(slam.components.features.extractor)
    slam.components.features._extractor = extractor  # the cache that recogniser and loop closer share
    for frame in islice(prefetch(dataset, prepare=slam.describe if ahead else None), FRAMES):
        result, other = slam.process(frame), expected.process(dataset[frame.index])
        assert np.array_equal(result.T_world_camera, other.T_world_camera)
        assert np.array_equal(result.landmarks.points, other.landmarks.points)
    here = threading.current_thread().name
    if ahead:
        assert here not in extractor.threads
    else:
        assert extractor.threads == [here] * FRAMES
