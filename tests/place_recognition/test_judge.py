"""The judge tells places apart by evidence, and images of one place by what they show larger."""

import numpy as np
import pytest
from place_images import sliding_view, textured_world

from place_recognition.belief.judge import Judge
from place_recognition.belief.proof import ProofConfig, prove, surplus_of_objects, zoom_between
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.image_processing.surf import Surf
from place_recognition.map.image_store import ImageStore


@pytest.fixture(scope="module")
def store():
    """Twenty images past ever new things, and the same again."""
    images = ImageStore(300)
    lap = sliding_view(textured_world(900, seed=5), list(range(0, 580, 29)))
    for image in lap + lap:
        images.add(Surf().extract(image))
    return images


def test_one_object_counts_as_a_geometry_and_no_more():
    rng = np.random.default_rng(0)
    car = rng.uniform([100, 100], [160, 160], (60, 2)).astype(np.float32)
    street = np.stack([np.arange(0, 1200, 100), np.full(12, 50)], axis=1).astype(np.float32)
    assert surplus_of_objects(car, 60.0) == 60 - 7
    assert surplus_of_objects(street, 60.0) == 0
    assert surplus_of_objects(np.concatenate([car, street + np.float32([300, 0])]), 60.0) == 60 - 7
    assert surplus_of_objects(np.concatenate([car, car + np.float32([500, 0])]), 60.0) == 2 * (60 - 7)


def test_zoom_is_known_whatever_the_shift():
    points = np.random.default_rng(1).uniform([0, 0], [1200, 370], (40, 2)).astype(np.float32)
    assert zoom_between(points + np.float32([30, -12]), points) == pytest.approx(0, abs=1e-3)
    assert zoom_between(1.25 * points - [100, 40], points) == pytest.approx(np.log2(1.25), abs=1e-3)
    assert zoom_between(points, 2 * points) == pytest.approx(-1, abs=1e-3)
    assert zoom_between(points[:1], points[:1]) == 0


def test_the_judge_finds_the_best_of_all_proofs(store):
    judge, config = Judge(store, ProofConfig(tried=3), ConsistencyConfig()), ProofConfig(tried=3)
    candidates = [3, 7, 8]
    best = max(prove(store, 28, candidates, config), key=lambda proof: proof.evidence)
    assert judge.judge(28, candidates, 10).proof.location == best.location
    assert best.location == 8


def test_enough_evidence_is_accepted_and_little_is_not(store):
    judge = Judge(store, ProofConfig(), ConsistencyConfig())
    assert judge.judge(28, [8], 10).sure
    assert not judge.judge(39, [0], 3).sure


def test_a_match_that_moves_on_needs_no_proposal(store):
    judge = Judge(store, ProofConfig(), ConsistencyConfig())
    judge.judge(25, [5], 15)
    assert judge.judge(26, [], 15).proof.location == 6


def test_without_candidates_there_is_no_judgement(store):
    assert Judge(store, ProofConfig(), ConsistencyConfig()).judge(25, [], 15) is None
