"""The judge asks geometry of the likeliest places, and an object counts for no more than one geometry."""

import numpy as np
import pytest
from place_images import sliding_view, textured_world

from place_recognition.belief.judge import Judge
from place_recognition.belief.proof import ProofConfig, prove, surplus_of_objects
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.image_processing.surf import Surf
from place_recognition.map.image_store import FeatureStore


@pytest.fixture(scope="module")
def store():
    """Twenty images past ever new things, and the same again."""
    images = FeatureStore(300)
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


def judge(store: FeatureStore, tried: int = 4) -> Judge:
    return Judge(store, ProofConfig(tried=tried), ConsistencyConfig())


def test_the_judge_asks_geometry_of_the_likeliest_places_up_to_one_that_leaves_no_doubt(store):
    proofs = judge(store, 3).judge(28, [3, 7, 8], 10)
    assert proofs == tuple(prove(store, 28, [3, 7, 8], ProofConfig(tried=3)))[: len(proofs)]
    assert max(proofs, key=lambda proof: proof.evidence).location == 8
    assert all(proof.evidence < ProofConfig().plenty for proof in proofs[:-1])


def test_the_same_view_proves_much_and_another_little(store):
    assert judge(store).judge(28, [8], 10)[0].evidence > 40
    assert judge(store).judge(39, [0], 3)[0].evidence < 5


def test_a_match_that_moves_on_needs_no_proposal(store):
    one = judge(store)
    one.judge(25, [5], 15)
    assert [proof.location for proof in one.judge(26, [], 15)] == [6]


def behind(certain: float) -> list[int]:
    """What is looked at when a car that has driven the second lap falls two images behind."""
    images, lap = FeatureStore(300), sliding_view(textured_world(900, seed=5), list(range(0, 580, 29)))
    for image in [*lap, *lap[:10], lap[8]]:
        images.add(Surf().extract(image))
    one = Judge(images, ProofConfig(plenty=1000.0), ConsistencyConfig(around=0, certain=certain))
    for query in range(20, 30):
        one.judge(query, [query - 20], 15)
    return [proof.location for proof in one.judge(30, [], 15)]


def test_on_a_certain_way_neighbours_that_say_more_are_found():
    assert behind(certain=200.0) == [10, 9, 11, 8, 7]
    assert behind(certain=1e9) == [10]


def test_elsewhere_no_neighbour_is_asked(store):
    one = Judge(store, ProofConfig(plenty=1000.0), ConsistencyConfig())
    assert [proof.location for proof in one.judge(28, [7], 15)] == [7]


def test_without_candidates_there_is_no_proof(store):
    assert judge(store).judge(25, [], 15) == ()
