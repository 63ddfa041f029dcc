"""The compiled steps of a growing neural gas, with the numbers that Fritzke (NIPS 7, 1995) gave them."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.belief.matching import add_products

Floats = NDArray[np.float32]
Ages = NDArray[np.int32]

NO_EDGE = np.int32(-1)


class State(NamedTuple):
    """Storage for all nodes that may come; only the first so many are in use."""

    columns: Floats  # (D, K): nodes side by side, so that all are compared with a sample at the speed of the memory
    penalty: Floats  # (K,) half the squared length of each node, infinite for nodes not in use
    error: Floats  # (K,) accumulated squared distance
    age: Ages  # (K, K) of the edges, symmetric
    degree: Ages  # (K,) edges of each node


@njit(cache=True)
def learn_all(samples: Floats, state: State, steps: Floats, period: int, oldest: int) -> int:
    """Show all samples (N, D), N > 1, in their order.

    Args:
        samples: float32, contiguous.
        state: of no node yet.
        steps: shares of the way of the winner and of its neighbours, factors of errors at an insertion and at a sample.
        period: samples from one insertion to the next.
        oldest: age at which an edge is forgotten.

    Returns:
        Number of nodes.
    """
    for node in range(2):  # 0. two nodes at random places: at samples, as most of the space is empty
        _move(state, node, samples[node], 1)
    count = 2
    closeness = np.empty_like(state.penalty)
    for i in range(len(samples)):
        count = _learn(samples[i], state, count, closeness, (steps[0], steps[1], oldest))
        if (i + 1) % period == 0 and count < len(state.penalty):
            count = _insert(state, count, steps[2])
        for node in range(count):  # 9.
            state.error[node] *= steps[3]
    return count


@njit(cache=True)
def _learn(sample: Floats, state: State, count: int, closeness: Floats, rule: tuple[float, float, int]) -> int:
    """Steps 2 to 7 for one sample; number of nodes after."""
    winner_step, neighbour_step, oldest = rule
    winner, second = _two_nearest(sample, state, count, closeness)
    state.error[winner] += _move(state, winner, sample, winner_step)
    for other in range(count):
        if state.age[winner, other] > NO_EDGE:
            _move(state, other, sample, neighbour_step)
            age = state.age[winner, other] + 1
            _join(state, winner, other, age if age <= oldest or other == second else NO_EDGE)
    _join(state, winner, second, 0)
    return _drop_alone(state, count)


@njit(cache=True)
def _two_nearest(sample: Floats, state: State, count: int, closeness: Floats) -> tuple[int, int]:
    # |s - w|^2 is least where s.w - |w|^2 / 2 is greatest
    for node in range(len(closeness)):
        closeness[node] = -state.penalty[node]
    add_products(sample, state.columns, closeness)
    winner, second = (0, 1) if closeness[0] >= closeness[1] else (1, 0)
    for node in range(2, count):
        if closeness[node] > closeness[winner]:
            winner, second = node, winner
        elif closeness[node] > closeness[second]:
            second = node
    return winner, second


@njit(cache=True)
def _insert(state: State, count: int, split: float) -> int:
    """Step 8: a node between that of greatest error and the worst of those joined to it."""
    worst, neighbour = 0, -1
    for node in range(1, count):
        if state.error[node] > state.error[worst]:
            worst = node
    for other in range(count):
        joined = state.age[worst, other] > NO_EDGE
        if joined and (neighbour < 0 or state.error[other] > state.error[neighbour]):
            neighbour = other
    if neighbour < 0:
        return count
    for k in range(len(state.columns)):
        state.columns[k, count] = np.float32(0.5) * (state.columns[k, worst] + state.columns[k, neighbour])
    _measure(state, count)
    _join(state, worst, neighbour, NO_EDGE)
    _join(state, worst, count, 0)
    _join(state, neighbour, count, 0)
    state.error[worst] *= split
    state.error[neighbour] *= split
    state.error[count] = state.error[worst]
    return count + 1


@njit(cache=True)
def _drop_alone(state: State, count: int) -> int:
    """Step 7: remove the nodes that have lost their last edge; the last node takes the place of each."""
    node = 0
    while node < count and count > 2:
        if state.degree[node] > 0:
            node += 1
            continue
        count -= 1
        _rename(state, count, node)
    return count


@njit(cache=True)
def _rename(state: State, node: int, name: int) -> None:
    """Let a node, the last one, be known by the index of one without edges."""
    for other in range(node):
        age = state.age[node, other]
        if age > NO_EDGE:
            _join(state, node, other, NO_EDGE)
            _join(state, name, other, age)
    for k in range(len(state.columns)):
        state.columns[k, name] = state.columns[k, node]
    state.penalty[name], state.error[name] = state.penalty[node], state.error[node]
    state.penalty[node], state.error[node] = np.inf, 0


@njit(cache=True)
def _move(state: State, node: int, sample: Floats, step: float) -> np.float32:
    """Move a node by a share of its way to the sample; squared length of that way."""
    squared = np.float32(0)
    for k in range(len(sample)):
        way = sample[k] - state.columns[k, node]
        squared += way * way
        state.columns[k, node] += np.float32(step) * way
    _measure(state, node)
    return squared


@njit(cache=True)
def _measure(state: State, node: int) -> None:
    """Bring the penalty of a node to where the node is."""
    total = np.float32(0)
    for k in range(len(state.columns)):
        total += state.columns[k, node] * state.columns[k, node]
    state.penalty[node] = np.float32(0.5) * total


@njit(cache=True)
def _join(state: State, first: int, second: int, age: int) -> None:
    """Give the edge between two nodes an age, or take it away."""
    change = (age > NO_EDGE) - (state.age[first, second] > NO_EDGE)
    state.degree[first] += change
    state.degree[second] += change
    state.age[first, second] = state.age[second, first] = age
