"""The leave-one-out test leaves out the clusters that contradict the others, the worst first."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.pose_graph.loop_clusters import LeaveOneOutTest

LIMIT = 34.0


def run_test(clusters: dict[int, list[int]], values: dict[int, float]) -> LeaveOneOutTest:
    """Test clusters whose loops each measure a number; a loop is as far off as from the median of the others."""
    of = {k: cluster for cluster, members in clusters.items() for k in members}

    def predictive_chi2(number: int, others: Sequence[int]) -> float:
        measured = sorted(values[of[k]] for k in others)
        return (values[of[number]] - measured[len(measured) // 2]) ** 2

    tested = LeaveOneOutTest(clusters, predictive_chi2, LIMIT)
    for _ in range(100):
        if tested.step():
            return tested
    pytest.fail("the test did not end")


def test_clusters_that_agree_all_stay() -> None:
    assert not run_test({0: [0, 1], 2: [2, 3], 4: [4, 5]}, {0: 0.0, 2: 1.0, 4: -1.0}).left_out


def test_the_cluster_that_the_others_contradict_goes() -> None:
    left_out = run_test({0: [0, 1, 2], 5: [5, 6], 7: [7, 8], 9: [9, 10]}, {0: 20.0, 5: 0.0, 7: 0.5, 9: 0.0}).left_out
    assert list(left_out) == [0]
    assert left_out[0] > LIMIT


def test_of_two_that_contradict_each_other_the_smaller_goes() -> None:
    assert list(run_test({0: [0, 1], 2: [2, 3, 4]}, {0: 0.0, 2: 9.0}).left_out) == [0]
    assert list(run_test({0: [0, 1, 5], 2: [2, 3]}, {0: 0.0, 2: 9.0}).left_out) == [2]


def test_several_go_one_after_the_other() -> None:
    clusters = {10 * k: list(range(10 * k, 10 * k + 4)) for k in range(6)}
    values = {0: 0.0, 10: 0.1, 20: 50.0, 30: 0.2, 40: -30.0, 50: 0.0}
    assert set(run_test(clusters, values).left_out) == {20, 40}


def test_a_single_loop_is_not_tested() -> None:
    assert not run_test({0: [0], 1: [1, 2], 3: [3, 4]}, {0: 99.0, 1: 0.0, 3: 0.0}).left_out


def test_a_cluster_by_itself_stays() -> None:
    assert not run_test({0: [0, 1, 2]}, {0: 5.0}).left_out


@settings(max_examples=50, deadline=None)
@given(measured=st.lists(st.floats(-100, 100), min_size=1, max_size=8))
def test_it_ends_and_never_leaves_out_everything(measured: list[float]) -> None:
    clusters = {3 * k: [3 * k, 3 * k + 1] for k in range(len(measured))}
    tested = run_test(clusters, {3 * k: value for k, value in enumerate(measured)})
    assert len(tested.left_out) < len(clusters)
