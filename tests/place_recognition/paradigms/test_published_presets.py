"""The published presets find a second pass by themselves, and every threshold of theirs decides something.

Each paradigm sees the drive once; its proposals are then decided again and again with other thresholds.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from place_images import changed, kitti_images

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.paradigms import published, registry
from place_recognition.paradigms.registry import (
    ParadigmsConfig,
    exclusion_s,
    make_control,
    make_feature_extractor,
    make_recognizer,
    with_exclusion,
    with_preset,
)

NAMES = ("sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words")
PASS = 25  # images of a pass; another street of as many lies between both
EXCLUDED = 20
NO_GATES = {"min_inliers": 0, "min_consistent_frames": 1}


class CachingExtractor:
    """Extracts the features of each image once."""

    def __init__(self, inner):
        self.inner, self.kind, self.found = inner, inner.kind, {}

    def extract(self, image):
        key = image.tobytes()
        if key not in self.found:
            self.found[key] = self.inner.extract(image)
        return self.found[key]


class Recording:
    """Keeps what a proposer answers."""

    def __init__(self, inner):
        self.inner, self.answers = inner, []

    def observe(self, image):
        self.answers.append(self.inner.observe(image))
        return self.answers[-1]

    def finish(self):
        self.answers.append(self.inner.finish())
        return self.answers[-1]


class Replay:
    """Answers as a recorded proposer did."""

    def __init__(self, answers):
        self.answers = iter(answers)

    def observe(self, image):
        return next(self.answers)

    def finish(self):
        return next(self.answers)


@dataclass
class Drive:
    """A drive as a published preset sees it: its images, features and proposals, and the beliefs of the preset."""

    name: str
    images: list
    extractor: CachingExtractor
    config: ParadigmsConfig
    answers: list
    beliefs: list

    @property
    def scores(self):
        """(K,) own scores of all first candidates."""
        return np.array([b.stages.own_score for b in self.beliefs if b.stages.own_score is not None])

    def decide(self, **changes: Any) -> list:
        """Beliefs with some thresholds changed."""
        decision = replace(published.DECISIONS[self.name], **changes)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(published.DECISIONS, self.name, decision)
            patch.setitem(registry.PARADIGMS, self.name, lambda *_: Replay(self.answers))
            return observe(make_recognizer(self.name, FeatureCache(self.extractor), self.config), self.images)


def observe(recognizer, images):
    beliefs = [b for k, image in enumerate(images) for b in recognizer.observe(k, image, float("nan"))]
    return beliefs + recognizer.finish()


def is_true(belief, tolerance=5):
    return belief.query >= 2 * PASS and abs(belief.query - 2 * PASS - belief.match) <= tolerance


def accepted(beliefs):
    return {belief.query for belief in beliefs if belief.accepted}


@pytest.fixture(scope="module")
def images(test_data):
    first = kitti_images(test_data, "07", range(0, 2 * PASS, 2))
    other = kitti_images(test_data, "05", range(0, 2 * PASS, 2))
    between = kitti_images(test_data, "07", range(1, 2 * PASS, 2))
    return [*first, *other, *(changed(image, seed) for seed, image in enumerate(between))]


@pytest.fixture(scope="module", params=NAMES)
def drive(request, images) -> Iterator[Drive]:
    name, build = request.param, registry.PARADIGMS[request.param]
    chosen = with_exclusion(ParadigmsConfig(preset="published"), 0 if request.param == "tracked-words" else EXCLUDED)
    config = with_preset(name, chosen)
    extractor, kept = CachingExtractor(make_feature_extractor(config)), []

    def recording(*arguments):
        kept.append(Recording(build(*arguments)))
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry.PARADIGMS, name, recording)
        beliefs = observe(make_recognizer(name, FeatureCache(extractor), config), images)
    return Drive(name, images, extractor, config, kept[0].answers, beliefs)


def test_the_preset_finds_the_second_pass_and_accepts_nothing_else(drive):
    matched = [b for b in drive.beliefs if b.accepted]
    assert len(matched) >= PASS // 3
    assert all(is_true(b) for b in matched)
    assert drive.decide() == drive.beliefs


def test_a_threshold_above_the_best_score_accepts_nothing(drive):
    best = drive.scores.max()
    assert accepted(drive.decide(min_score=best * 1.001)) == set()
    assert accepted(drive.decide(min_score=best, min_consistent_frames=1))


def test_without_a_threshold_false_matches_are_accepted_and_the_published_one_refuses_them(drive):
    false = [b for b in drive.decide(min_score=0.0, **NO_GATES) if b.accepted and not is_true(b)]
    left = [b for b in drive.decide(**NO_GATES) if b.accepted and not is_true(b)]
    assert len(false) >= 5
    assert len(left) < len(false)


def test_a_match_has_the_score_and_the_inliers_that_the_preset_asks_for(drive):
    decision = published.DECISIONS[drive.name]
    for belief in drive.beliefs:
        if belief.accepted:
            assert belief.score >= decision.min_score
            assert belief.inliers >= decision.min_inliers


def test_without_geometry_false_matches_are_accepted_and_inliers_beyond_all_accept_nothing(drive):
    beliefs = drive.decide(min_score=0.0, min_inliers=0)
    assert any(b.accepted and not is_true(b) for b in beliefs)
    assert not any(b.accepted and not is_true(b, 10) for b in drive.decide(min_score=0.0, min_inliers=60))
    most = max(b.inliers for b in beliefs if b.inliers is not None)
    assert accepted(drive.decide(min_inliers=most + 1)) == set()


def test_the_temporal_gate_asks_for_as_many_successive_matches(drive):
    alone = drive.decide(min_consistent_frames=1)
    matches = {b.query: b.match for b in alone if b.accepted}
    for count, gap in ((2, 10), (3, 10), (2, 0)):
        expected = {query for query in matches if is_consistent(matches, query, count, gap)}
        assert accepted(drive.decide(min_consistent_frames=count, max_gap_frames=gap)) == expected
        assert expected < matches.keys()
    assert accepted(drive.decide(min_consistent_frames=PASS + 1)) == set()


def is_consistent(matches: dict[int, int], query: int, count: int, gap: int) -> bool:
    """Whether the latest `count` queries all have matches, each at most `gap` images from that before."""
    latest = range(query - count + 1, query + 1)
    return all(q in matches for q in latest) and all(abs(matches[b] - matches[a]) <= gap for a, b in pairwise(latest))


def test_the_control_of_a_preset_has_its_end(images):
    config = with_exclusion(ParadigmsConfig(preset="published"), EXCLUDED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(published, "CONTROL", replace(published.CONTROL, min_inliers=0, min_consistent_frames=1))
        free = observe(make_control(FeatureCache(CachingExtractor(make_feature_extractor(config))), config), images)
    matches = [b for b in free if b.accepted]
    assert len(matches) > 2 * PASS
    assert all(b.query - b.match >= EXCLUDED for b in matches)
    assert [b.answered_at for b in free] == [b.query for b in free]
    strict = observe(make_control(FeatureCache(CachingExtractor(make_feature_extractor(config))), config), images)
    assert len(accepted(strict)) < PASS // 2


def test_the_exclusion_is_that_of_the_papers():
    settings = ParadigmsConfig(preset="published")
    assert [exclusion_s(name, settings) for name in NAMES] == [40.0, 40.0, 40.0, 0.0]
    assert all(exclusion_s(name, ParadigmsConfig()) == 0.0 for name in NAMES)
