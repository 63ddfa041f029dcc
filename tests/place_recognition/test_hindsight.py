"""What lies on one line with its neighbours is borne out, what does not is not, and nothing is lost on the way."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.hindsight import Hindsight, HindsightConfig, Opinion
from place_recognition.belief.proof import Proof
from place_recognition.recognizer import Belief


def opinion(query: int, *places: tuple[int, float]) -> Opinion:
    """Of an image that may show one of the places (location, evidence)."""
    if not places:
        return Opinion((Belief(query, None, 0.0, accepted=False),))
    proofs = tuple(Proof(query, location, 30, evidence, verified=True) for location, evidence in places)
    return Opinion(tuple(Belief(query, p.location, p.evidence, accepted=True, inliers=30) for p in proofs), proofs)


def settled(opinions: list[Opinion], config: HindsightConfig | None = None) -> dict[int, Belief]:
    hindsight = Hindsight(config)
    beliefs = [belief for one in opinions for belief in hindsight.add(one)] + hindsight.finish()
    return {belief.query: belief for belief in beliefs}


@pytest.mark.parametrize("speed", [-1.2, -1.0, 0.8, 1.0, 1.25])
def test_weak_images_on_one_line_are_accepted_together(speed):
    beliefs = settled([opinion(q, (300 + round(speed * q), 25.0)) for q in range(100, 140)])
    assert all(beliefs[q].accepted for q in range(105, 135))


def test_the_same_weak_images_in_no_order_are_not():
    scattered = [17, 205, 90, 3, 260, 130, 44, 180, 71, 233] * 4
    beliefs = settled([opinion(q, (scattered[q - 300], 25.0)) for q in range(300, 340)])
    assert not any(belief.accepted for belief in beliefs.values())


def test_however_many_images_none_of_which_proves_anything_do_not_add_up():
    """Kerbs and cars of one make in two streets: so much evidence in each of 26 images, seen on a simulated drive."""
    evidence = [9, 12, 14, 13, 14, 16, 17, 12, 10, 10, 11, 7, 6, 31, 13, 9, 9, 9, 12, 8, 18, 15, 21, 13, 8, 6]

    def of_the_middle(times: float) -> float:
        street = [opinion(3480 + k, (3360 + k, times * said)) for k, said in enumerate(evidence)]
        return settled(street)[3493].score

    assert of_the_middle(1) < 150
    assert of_the_middle(4) > 500  # images that prove something do


def test_of_two_places_the_one_on_the_line_is_chosen_though_it_proves_less():
    opinions = [opinion(q, (q - 300, 15.0)) for q in range(400, 430)]
    opinions[15] = opinion(415, (20, 35.0), (115, 5.0))
    assert settled(opinions)[415].match == 115


def test_where_a_revisit_ends_an_image_says_most_itself():
    revisit = [opinion(q, (q - 300, 30.0)) for q in range(400, 430)]
    after = [opinion(q, (q - 300, 1.0)) for q in range(430, 440)]  # the right street from afar
    beliefs = settled(revisit + after)
    assert beliefs[429].accepted
    assert not beliefs[439].accepted
    assert beliefs[435].score < 0.1 * beliefs[415].score


def test_the_first_image_of_a_street_seen_from_behind_it_is_denied_by_those_that_have_reached_it():
    before = [opinion(q, ((0, 3, 1, 4)[q % 4], 25.0), (5, 15.0)) for q in range(396, 416)]  # from afar
    beliefs = settled(before + [opinion(q, (q - 417, 100.0)) for q in range(417, 450)])
    assert not any(beliefs[q].accepted for q in range(402, 416))
    assert all(beliefs[q].accepted for q in range(417, 440))


def test_what_lies_far_on_both_sides_bridges_no_gap():
    """The earlier pass turned off, the later one went on, and comes to a street that looks like the one it knows."""
    revisit, gap, alike = range(400, 420), range(420, 440), range(440, 460)
    line = [opinion(q, (q - 300, 0.3 if q in gap else 30.0)) for q in [*revisit, *gap, *alike]]
    beliefs = settled(line)
    assert not any(beliefs[q].accepted for q in range(427, 433))
    assert all(beliefs[q].accepted for q in range(405, 420))


def test_nobody_denies_an_image_that_is_as_sure():
    """The earlier pass stood still here for twenty images."""
    revisit = [opinion(q, (q - 300 if q < 415 else q - 280, 90.0)) for q in range(400, 430)]
    assert all(belief.accepted for belief in settled(revisit).values())


def test_without_a_window_every_image_speaks_for_itself_at_once():
    hindsight = Hindsight(HindsightConfig.none())
    [belief] = hindsight.add(opinion(400, (100, 20.0), (7, 30.0)))
    assert (belief.match, belief.score, belief.accepted) == (7, 30.0, True)
    assert hindsight.finish() == []


def test_what_the_paradigm_refuses_stays_refused():
    refused = [
        Opinion((Belief(q, q - 300, 50.0, False),), (Proof(q, q - 300, 30, 50.0, True),)) for q in range(400, 440)
    ]
    assert not any(belief.accepted for belief in settled(refused).values())


@given(st.lists(st.integers(0, 3), max_size=60), st.integers(0, 5))
def test_every_belief_comes_out_once_in_order_and_so_many_late(counts, window):
    hindsight, out = Hindsight(HindsightConfig(window=window)), []
    for k, count in enumerate(counts):
        out += hindsight.add(opinion(k + 100, *((3 * k + n, 10.0) for n in range(count))))
        assert len(out) == max(k + 1 - window, 0)
    out += hindsight.finish()
    assert [belief.query for belief in out] == list(range(100, 100 + len(counts)))
    assert [belief.match is None for belief in out] == [count == 0 for count in counts]
