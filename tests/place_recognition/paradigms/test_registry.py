"""The registry makes every paradigm by its name and passes on an exclusion to each."""

import numpy as np
import pytest
from place_images import LAP_IMAGES, CachingSurf, changed, two_laps

from place_recognition import staged_recognizer
from place_recognition.evaluation.memory import count_array_bytes, map_size
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig, make_recognizer, with_exclusion
from place_recognition.vocabulary.vocabulary import FlatVocabulary, save_vocabulary

NAMES = {
    "sequence-histograms",
    "dynamic-sequences",
    "hierarchical-places",
    "tracked-words",
    "pixel-sequences",
    "global-descriptor",
    "seq-slam",
}


def test_the_names_are_those_of_the_command_line():
    assert set(PARADIGMS) == NAMES


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown paradigm .guess.: expected one of .*tracked-words"):
        make_recognizer("guess", FeatureCache(Surf()))


def test_a_vocabulary_of_other_features_is_refused_with_its_file(tmp_path):
    file = tmp_path / "orb.vocabulary"
    save_vocabulary(file, FlatVocabulary("orb-256", np.eye(4, dtype=np.float32), np.ones(4, np.float32)))
    with pytest.raises(ValueError, match=r"orb\.vocabulary: expected a vocabulary of surf-upright-64 features"):
        make_recognizer("dynamic-sequences", FeatureCache(Surf()), ParadigmsConfig(vocabulary=str(file)))


def test_a_damaged_vocabulary_is_refused_with_its_file(tmp_path):
    (tmp_path / "x.vocabulary").write_bytes(b"words")
    with pytest.raises(ValueError, match=r"x\.vocabulary"):
        make_recognizer(
            "sequence-histograms", FeatureCache(Surf()), ParadigmsConfig(vocabulary=str(tmp_path / "x.vocabulary"))
        )


def test_a_descriptor_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown global descriptor 'magic'"):
        make_recognizer("global-descriptor", FeatureCache(Surf()), ParadigmsConfig(descriptor="magic"))
    with pytest.raises(ValueError, match=r"none\.onnx: expected an ONNX file, found none"):
        make_recognizer(
            "global-descriptor", FeatureCache(Surf()), ParadigmsConfig(descriptor=f"onnx:{tmp_path}/none.onnx")
        )


def test_an_exclusion_changes_nothing_else():
    config = ParadigmsConfig()
    changed = with_exclusion(config, 40)
    assert changed.view.exclusion_frames == 40
    assert with_exclusion(changed, 0) == config


def test_an_unknown_preset_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown preset .best.: expected one of default, published"):
        make_recognizer("tracked-words", FeatureCache(Surf()), ParadigmsConfig(preset="best"))


@pytest.mark.parametrize("name", PARADIGMS)
def test_the_seed_reaches_the_samples_of_geometry(name, monkeypatch):
    seeds = []

    def record(images, query, candidates, last_matchable, config, pool):
        seeds.append(config.epipolar.seed)
        return ()

    monkeypatch.setattr(staged_recognizer, "verify_candidates", record)
    recognizer = make_recognizer(name, FeatureCache(CachingSurf()), ParadigmsConfig(seed=7))
    for i, image in enumerate(two_laps()[:3]):
        recognizer.observe(i, image, float("nan"))
    recognizer.finish()
    assert seeds == [7, 7, 7]


@pytest.mark.parametrize("name", PARADIGMS)
def test_no_image_within_the_exclusion_is_matched_and_those_beyond_still_are(name):
    def beliefs(images):
        recognizer = make_recognizer(name, FeatureCache(CachingSurf()), with_exclusion(ParadigmsConfig(), images))
        found = [b for i, image in enumerate(two_laps()) for b in recognizer.observe(i, image, float("nan"))]
        return found + recognizer.finish()

    matched = [b for b in beliefs(38) if b.match is not None]
    assert matched
    assert all(b.query - b.match >= 38 for b in matched)
    assert all(b.match is None or b.query - b.match >= 70 for b in beliefs(70))


@pytest.mark.parametrize("name", PARADIGMS)
def test_a_map_grows_with_the_images(name):
    recognizer = make_recognizer(name, FeatureCache(CachingSurf()))
    sizes = []
    for i, image in enumerate(two_laps()):
        recognizer.observe(i, image, float("nan"))
        if i in (0, 79):
            sizes.append(map_size(recognizer).bytes)
    assert sizes[1] > sizes[0]


class Holder:
    """Holds arrays in every way that a map may."""

    __slots__ = ("inner", "others")

    def __init__(self) -> None:
        whole = np.zeros((10, 10))
        self.inner = {"view": whole[2:4], "again": whole}
        self.others = [(np.ones(5, np.int8),), self]


def test_shared_memory_counts_once_and_circles_do_no_harm():
    assert count_array_bytes(Holder()) == 805


def test_a_recogniser_that_knows_its_size_is_believed():
    class Sized:
        word_count, map_bytes = 7, 123

    size = map_size(Sized())
    assert (size.words, size.bytes) == (7, 123)


def test_matches_of_learned_features_may_be_less_clear_than_those_of_surf():
    class Learned(CachingSurf):
        """The same features under the name of a network."""

        kind = "onnx-surf"

    images = two_laps()
    seen = [changed(image, k) for k, image in enumerate(images[LAP_IMAGES:])]
    inliers = []
    for extractor in (CachingSurf(), Learned()):
        recognizer = make_recognizer("global-descriptor", FeatureCache(extractor))
        answers = [
            answer
            for k, image in enumerate([*images[:LAP_IMAGES], *seen])
            for answer in recognizer.observe(k, image, float("nan"))
        ] + recognizer.finish()
        inliers.append(sum(answer.inliers or 0 for answer in answers))
    assert inliers[1] > 1.02 * inliers[0] > 0
