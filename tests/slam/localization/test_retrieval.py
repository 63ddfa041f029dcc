"""Images that share words are alike; what all share does not count."""

import numpy as np
import pytest

from slam.localization.retrieval import IndexConfig, PlaceIndex

IMAGES, FEATURES = 12, 60


@pytest.fixture(scope="module")
def places() -> list[np.ndarray]:
    """Descriptors of images of different places; every image shows the first ten of them as well."""
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(IMAGES, FEATURES, 64)).astype(np.float32)
    drawn[:, :10] = drawn[0, :10]
    return list(drawn / np.linalg.norm(drawn, axis=2, keepdims=True))


@pytest.mark.parametrize("words", [100, 10000])
def test_each_place_is_most_similar_to_itself(places: list[np.ndarray], words: int) -> None:
    index = PlaceIndex.build(lambda: places, IndexConfig(words))
    rng = np.random.default_rng(1)
    for number, descriptors in enumerate(places):
        again = descriptors[rng.permutation(FEATURES)[:40]] + rng.normal(size=(40, 64)).astype(np.float32) * 0.01
        similarity = index.similarity(again)
        assert similarity.argmax() == number
        assert similarity.max() <= 1 + 1e-6


def test_words_that_every_place_shows_carry_no_information(places: list[np.ndarray]) -> None:
    index = PlaceIndex.build(lambda: places, IndexConfig())
    similarity = index.similarity(places[3][:10])
    assert np.ptp(similarity) < 0.05
    assert np.ptp(index.similarity(places[3])) > 0.5


def test_an_image_without_features_is_similar_to_no_place(places: list[np.ndarray]) -> None:
    empty = np.empty((0, 64), np.float32)
    index = PlaceIndex.build(lambda: [empty, *places], IndexConfig())
    assert not index.similarity(empty).any()
    assert index.similarity(places[0]).argmax() == 1
    assert np.isfinite(index.similarity(places[0])).all()
