"""An audit leaves out the groups that contradict the rest, the worst first."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.loop_audit import LeaveOneOutTest

LIMIT = 34.0


def audited(groups: dict[int, list[int]], says: dict[int, float]) -> LeaveOneOutTest:
    """Audit groups whose loops each claim a number; a loop is as far off as from the median of the others."""
    of = {k: group for group, members in groups.items() for k in members}

    def surprise(number: int, others: Sequence[int]) -> float:
        claims = sorted(says[of[k]] for k in others)
        return (says[of[number]] - claims[len(claims) // 2]) ** 2

    audit = LeaveOneOutTest(groups, surprise, LIMIT)
    for _ in range(100):
        if audit.step():
            return audit
    pytest.fail("the audit did not end")


def test_groups_that_agree_all_stay() -> None:
    assert not audited({0: [0, 1], 2: [2, 3], 4: [4, 5]}, {0: 0.0, 2: 1.0, 4: -1.0}).left_out


def test_the_group_that_the_others_contradict_goes() -> None:
    left_out = audited({0: [0, 1, 2], 5: [5, 6], 7: [7, 8], 9: [9, 10]}, {0: 20.0, 5: 0.0, 7: 0.5, 9: 0.0}).left_out
    assert list(left_out) == [0]
    assert left_out[0] > LIMIT


def test_of_two_that_contradict_each_other_the_smaller_goes() -> None:
    assert list(audited({0: [0, 1], 2: [2, 3, 4]}, {0: 0.0, 2: 9.0}).left_out) == [0]
    assert list(audited({0: [0, 1, 5], 2: [2, 3]}, {0: 0.0, 2: 9.0}).left_out) == [2]


def test_several_go_one_after_the_other() -> None:
    groups = {10 * k: list(range(10 * k, 10 * k + 4)) for k in range(6)}
    says = {0: 0.0, 10: 0.1, 20: 50.0, 30: 0.2, 40: -30.0, 50: 0.0}
    assert set(audited(groups, says).left_out) == {20, 40}


def test_a_single_loop_is_not_asked() -> None:
    assert not audited({0: [0], 1: [1, 2], 3: [3, 4]}, {0: 99.0, 1: 0.0, 3: 0.0}).left_out


def test_a_group_by_itself_is_beyond_doubt() -> None:
    assert not audited({0: [0, 1, 2]}, {0: 5.0}).left_out


@settings(max_examples=50, deadline=None)
@given(claims=st.lists(st.floats(-100, 100), min_size=1, max_size=8))
def test_an_audit_ends_and_never_leaves_out_everything(claims: list[float]) -> None:
    groups = {3 * k: [3 * k, 3 * k + 1] for k in range(len(claims))}
    audit = audited(groups, {3 * k: claim for k, claim in enumerate(claims)})
    assert len(audit.left_out) < len(groups)
