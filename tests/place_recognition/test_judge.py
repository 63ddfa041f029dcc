"""The judge's short cuts change nothing about its answer."""

import pytest
from place_images import sliding_view, textured_world

from place_recognition.belief.judge import Judge
from place_recognition.belief.proof import Pairing, ProofConfig, chance_evidence, prove
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


def test_no_proof_outweighs_the_one_in_which_all_matches_agree():
    for matches in range(8, 300, 13):
        for chance in (0.001, 0.01, 0.1, 0.5):
            most = chance_evidence(matches, matches, chance)
            assert all(chance_evidence(inliers, matches, chance) <= most for inliers in range(matches))


def test_the_judge_finds_the_best_of_all_proofs(store):
    judge, config = Judge(store, ProofConfig(tried=3), ConsistencyConfig()), ProofConfig(tried=3)
    candidates = [3, 7, 8]
    best = max(prove(store, 28, candidates, config), key=lambda proof: proof.evidence)
    assert judge.judge(28, candidates, 10).proof == best
    assert best.location == 8


def test_a_pairing_that_cannot_win_is_not_checked(store, monkeypatch):
    checked = []
    original = Pairing.check
    monkeypatch.setattr(Pairing, "check", lambda self, config: checked.append(self.location) or original(self, config))
    judge = Judge(store, ProofConfig(tried=3), ConsistencyConfig())
    assert judge.judge(28, [1, 8, 16], 18).proof.location == 8
    assert checked == [8]


def test_a_match_that_moves_on_needs_no_proposal(store):
    judge = Judge(store, ProofConfig(), ConsistencyConfig())
    judge.judge(25, [5], 15)
    assert judge.judge(26, [], 15).proof.location == 6


def test_without_candidates_there_is_no_judgement(store):
    assert Judge(store, ProofConfig(), ConsistencyConfig()).judge(25, [], 15) is None
