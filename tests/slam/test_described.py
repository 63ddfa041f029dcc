"""Features found ahead by the thread that reads are those the chain would have found, and nobody finds them twice."""

import threading
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from place_recognition.image_processing.extractors import EXTRACTORS, make_extractor
from place_recognition.image_processing.features import FeatureExtractor, LocalFeatures
from slam.config import RunConfig
from slam.datasets.described import Described
from slam.datasets.kitti import open_kitti
from slam.datasets.prefetch import prefetch
from slam.parts import build_parts
from slam.system import Slam

FRAMES = 12


@dataclass
class Counted:
    """An extractor that knows which threads have asked it."""

    inner: FeatureExtractor
    threads: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        return self.inner.kind

    def extract(self, image: np.ndarray) -> LocalFeatures:
        self.threads.append(threading.current_thread().name)
        return self.inner.extract(image)


def same(one: LocalFeatures, other: LocalFeatures) -> bool:
    pairs = [(one.pixels, other.pixels), (one.scales, other.scales), (one.descriptors, other.descriptors)]
    return all(np.array_equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("name", sorted(EXTRACTORS))
def test_another_thread_finds_the_same_features(circle_drive: Path, name: str):
    drive, extractor = open_kitti(circle_drive), make_extractor(name)
    for frame, features in islice(prefetch(Described(drive, extractor)), 4):
        assert same(features, extractor.extract(frame.left))


def test_the_chain_goes_the_same_way_and_describes_no_image_again(circle_drive: Path):
    drive, config = open_kitti(circle_drive), RunConfig(paradigm="tracked-words")
    alone, ahead = Slam(build_parts(drive.camera, config)), Slam(build_parts(drive.camera, config))
    reader = Counted(ahead.parts.features.extractor)
    ahead.parts.features._extractor = in_chain = Counted(reader.inner)
    for frame, features in islice(prefetch(Described(drive, reader)), FRAMES):
        told, expected = ahead.process(frame, features), alone.process(frame)
        assert np.array_equal(told.T_world_camera, expected.T_world_camera)
        assert np.array_equal(told.landmarks.points, expected.landmarks.points)
    assert in_chain.threads == []
    assert threading.current_thread().name not in reader.threads
