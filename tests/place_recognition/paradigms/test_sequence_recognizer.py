"""Both paradigms of sequences on real drives, and what they share."""

import numpy as np
import pytest
from place_images import changed, kitti_images, sliding_view, textured_world

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.sequence_paradigms import (
    DynamicSequencesConfig,
    SequenceHistogramsConfig,
    make_dynamic_sequences,
    make_sequence_histograms,
)
from place_recognition.paradigms.sequence_recognizer import SequenceMatchingConfig
from place_recognition.vocabulary.vocabulary import FlatVocabulary, default_vocabulary

PARADIGMS = pytest.mark.parametrize("paradigm", [make_sequence_histograms, make_dynamic_sequences])


class Rows(dict):
    """The rows of both matrices, by stage and query."""

    def add(self, query, matches, values, stage="similarity"):
        self[stage, query] = (matches, values)


def beliefs_of(paradigm, images, step_m=float("nan"), config=None):
    """Beliefs and rows of a drive; `step_m` is the distance between images."""
    rows = Rows()
    recognizer = paradigm(FeatureCache(Surf()), default_vocabulary(), config, rows)
    beliefs = [b for i, image in enumerate(images) for b in recognizer.observe(i, image, step_m * i)]
    return beliefs + recognizer.finish(), rows


@pytest.fixture(scope="module")
def frames(test_data):
    return kitti_images(test_data, "07", range(0, 80, 2))


@pytest.fixture(scope="module")
def two_passes(test_data, frames):
    """A drive, and the frames in between as another, changed pass."""
    between = kitti_images(test_data, "07", range(1, 81, 2))
    return frames + [changed(image, seed) for seed, image in enumerate(between)]


@PARADIGMS
def test_a_second_pass_is_recognised_and_the_first_is_not(paradigm, two_passes):
    beliefs, rows = beliefs_of(paradigm, two_passes)
    first = len(two_passes) // 2
    assert [b.query for b in beliefs] == list(range(len(two_passes)))
    assert not any(b.accepted for b in beliefs[:first])
    assert np.mean([b.accepted and abs(b.query - first - b.match) <= 2 for b in beliefs[first:]]) > 0.9
    queries = sorted(query for stage, query in rows if stage == "filtered")
    assert queries == sorted(query for stage, query in rows if stage == "similarity")
    matches, response = rows["filtered", queries[-4]]
    assert set(matches) <= set(queries)
    assert abs(matches[response.argmax()] - (queries[-4] - first)) <= 10


@PARADIGMS
def test_a_revisit_in_the_opposite_direction_is_recognised_although_the_filter_suppresses_it(paradigm, test_data):
    order = [*range(0, 60, 2), *range(59, 0, -2)]
    images = kitti_images(test_data, "05", range(60))
    beliefs, _ = beliefs_of(paradigm, [images[k] for k in order], step_m=1.7)
    accepted = [b for b in beliefs if b.accepted]
    assert len(accepted) > 10
    assert all(abs(order[b.query] - order[b.match]) <= 5 for b in accepted)


@PARADIGMS
def test_published_settings_accept_only_sequences_with_a_response(paradigm, two_passes):
    config = {make_sequence_histograms: SequenceHistogramsConfig, make_dynamic_sequences: DynamicSequencesConfig}[
        paradigm
    ].published()
    assert config.filter.threshold == {make_sequence_histograms: 0.32, make_dynamic_sequences: 3.5}[paradigm]
    beliefs, rows = beliefs_of(paradigm, two_passes, config=config)
    starts = np.array(sorted(query for stage, query in rows if stage == "filtered"))
    for belief in beliefs:
        if belief.accepted:
            first = starts[np.searchsorted(starts, belief.query, side="right") - 1]
            assert rows["filtered", first][1].max() >= config.filter.threshold


@PARADIGMS
def test_runs_of_at_most_one_sequence_are_answered(paradigm):
    images = sliding_view(textured_world(400, seed=2), [0, 10, 20])
    for count in range(4):
        beliefs, _ = beliefs_of(paradigm, images[:count], step_m=1.0)
        assert [(b.query, b.match) for b in beliefs] == [(k, None) for k in range(count)]


@PARADIGMS
def test_a_vocabulary_of_other_features_is_refused(paradigm):
    words = FlatVocabulary("orb-256", np.eye(256, dtype=np.float32), np.ones(256, np.float32))
    with pytest.raises(ValueError, match="expected a vocabulary of surf-upright-64 features, found one of orb-256"):
        paradigm(FeatureCache(Surf()), words)


def test_an_unknown_score_is_refused():
    with pytest.raises(ValueError, match="expected a score of scaled-l2, l2, cosine, got 'l1'"):
        SequenceMatchingConfig(score="l1")
