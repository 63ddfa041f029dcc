"""SeqSLAM: the online paradigm gives the answers of the published batch computation."""

import numpy as np
import pytest
from place_images import LAP_IMAGES, changed, observe_image, propose_all, two_laps

from place_recognition.image_processing.global_descriptors import ThumbnailConfig, make_thumbnail
from place_recognition.paradigms.seq_slam import SeqSlam, SeqSlamConfig, enhance_contrast, smallest_lines
from place_recognition.recognizer import ObservedImage

HALF = 5
REFERENCE = two_laps()[:LAP_IMAGES]
QUERY = [changed(image, k) for k, image in enumerate(REFERENCE)]


def propose(reference, query, config=None):
    """Proposals of a query, whose locations go on after the reference."""
    proposer = SeqSlam(config)
    for k, image in enumerate(reference):
        proposer.observe(observe_image(k, image))
    proposer.finish()
    proposer.end_reference()
    last = len(reference) - 1
    seen = [observe_image(len(reference) + k, image) for k, image in enumerate(query)]
    return propose_all(
        proposer, [ObservedImage(one.location, one.pixels, one.features, float("nan"), last) for one in seen]
    )


def batch(reference, query):
    """The matrix computation of Milford and Wyeth, as OpenSeqSLAM does it: match and quotient of each inner query."""
    pictures = [
        np.array([make_thumbnail(image, ThumbnailConfig()).ravel() for image in images], np.int64)
        for images in (reference, query)
    ]
    differences = np.abs(pictures[0][:, None] - pictures[1]).sum(axis=2)
    enhanced = np.empty(differences.shape)
    for row in range(len(reference)):
        window = differences[max(row - HALF, 0) : row + HALF + 1]
        enhanced[row] = (differences[row] - window.mean(axis=0)) / window.std(axis=0, ddof=1)
    enhanced += 10 / np.sqrt(11)
    found = {}
    for center in range(HALF, len(query) - HALF):
        lines = np.full(len(reference), np.inf)
        for at in range(len(reference)):
            for speed in (0.8, 0.9, 1.0, 1.1, 1.2):
                rows = np.array([at + int(np.floor(speed * k + 0.5)) for k in range(-HALF, HALF + 1)])
                inside = (rows >= 0) & (rows < len(reference))
                columns = np.arange(center - HALF, center + HALF + 1)
                values = np.where(inside, enhanced[np.clip(rows, 0, len(reference) - 1), columns], 10 / np.sqrt(11))
                lines[at] = min(lines[at], values.mean())
        best = int(lines.argmin())
        others = np.concatenate([lines[: max(best - HALF, 0)], lines[best + HALF + 1 :]])
        found[center] = best, lines[best] / others.min()
    return found


def test_the_answers_are_those_of_the_batch_computation():
    proposals, expected = propose(REFERENCE, QUERY), batch(REFERENCE, QUERY)
    for center, (match, quotient) in expected.items():
        assert proposals[center].locations[0] == match
        assert proposals[center].scores[0] == pytest.approx(1 - quotient, abs=1e-5)
    assert np.mean([match == center for center, (match, _) in expected.items()]) > 0.9


def test_each_query_is_answered_half_a_sequence_late_in_order():
    proposer, answered = SeqSlam(), []
    for k, image in enumerate(REFERENCE):
        answered.append([one.query for one in proposer.observe(observe_image(k, image))])
    assert answered == [[]] * HALF + [[k] for k in range(LAP_IMAGES - HALF)]
    assert [one.query for one in proposer.finish()] == list(range(LAP_IMAGES - HALF, LAP_IMAGES))


def test_the_ends_of_a_query_are_answered_too():
    proposals = propose(REFERENCE, QUERY)
    assert [abs(proposals[k].locations[0] - k) <= 1 for k in (0, 1, LAP_IMAGES - 2, LAP_IMAGES - 1)] == [True] * 4


def test_half_the_speed_is_outside_the_search_and_found_where_it_is_searched():
    slow = [QUERY[k // 2] for k in range(2 * LAP_IMAGES)]

    def hits(config):
        found = propose(REFERENCE, slow, config)
        return np.mean([bool(p.locations) and abs(p.locations[0] - k // 2) <= 1 for k, p in enumerate(found)])

    assert hits(SeqSlamConfig(speed_ratios=(0.5,))) > hits(SeqSlamConfig()) + 0.1


@pytest.mark.parametrize("seed", range(3))
def test_enhanced_differences_are_at_least_0_and_know_no_gain(seed):
    differences = np.random.default_rng(seed).integers(0, 1000, 60)
    enhanced = enhance_contrast(differences, HALF)
    assert enhanced.min() >= 0
    np.testing.assert_allclose(enhance_contrast(3 * differences + 50, HALF), enhanced, atol=1e-5)


def test_equal_differences_are_as_usual():
    assert enhance_contrast(np.full(20, 7), HALF).tolist() == pytest.approx([10 / np.sqrt(11)] * 20)


def test_a_line_counts_what_lies_outside_as_usual():
    rows = np.zeros((3, 4), np.float32)
    assert smallest_lines(rows, np.array([[-1, 0, 1]]), 3.0).tolist() == pytest.approx([1.0, 0.0, 0.0, 1.0])
