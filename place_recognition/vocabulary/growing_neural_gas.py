"""Growing neural gas: a graph of nodes that learns the distribution and the topology of samples.

Fritzke, 'A Growing Neural Gas Network Learns Topologies', NIPS 7, 1995. The compiled functions name his steps by their
numbers.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.matching import add_products

Floats = NDArray[np.float32]
Ages = NDArray[np.int32]

NO_EDGE = np.int32(-1)  # age of an edge that is not there


class GasState(NamedTuple):
    """Storage for the greatest number of nodes, K; the first ones are in use.

    Attributes:
        columns: (D, K) nodes as columns, so that a SIMD loop compares all of them with a sample.
        penalty: (K,) half the squared length of each node, infinite for nodes not in use.
        error: (K,) accumulated squared distance of each node.
        age: (K, K) age of each edge, symmetric.
        degree: (K,) number of edges of each node.
    """

    columns: Floats
    penalty: Floats
    error: Floats
    age: Ages
    degree: Ages


class LearningRule(NamedTuple):
    """Numbers of `GasConfig` that the compiled steps need, in single precision like the nodes."""

    winner_step: np.float32
    neighbor_step: np.float32
    split: np.float32
    decay: np.float32
    insertion_period: int
    max_edge_age: int


@dataclass(frozen=True)
class GasConfig:
    """Growth of the gas: Fritzke's values but for the period, which determines the number of samples a node stands for.

    The program of the paper that brought the gas to places moves the winner by 0.8 of the distance and removes edges
    after 10 steps: a node is then little more than its latest sample, and fewer revisits are found.

    Attributes:
        max_nodes: maximum number of nodes.
        insertion_period: number of samples from one insertion of a node to the next, lambda in the paper.
        winner_step_ratio, neighbor_step_ratio: share of the distance to a sample by which the nearest node and its
            neighbours move.
        split_factor: factor of the errors of the two nodes between which one is inserted, alpha in the paper.
        decay: factor of all errors after each sample.
        max_edge_age: age at which an edge is removed, in wins of its nodes.
        epochs: number of times that all samples are shown.
    """

    max_nodes: int = 300
    insertion_period: int = 25
    winner_step_ratio: float = 0.2
    neighbor_step_ratio: float = 0.006
    split_factor: float = 0.5
    decay: float = 0.995
    max_edge_age: int = 50
    epochs: int = 1


@dataclass(frozen=True)
class Gas:
    """The graph that has grown.

    Attributes:
        nodes: (K, D) float32 positions.
        edges: (E, 2) int64 indices of joined nodes, the smaller first.
    """

    nodes: Floats
    edges: NDArray[np.int64]


def grow_gas(samples: Floats, rng: np.random.Generator, config: GasConfig | None = None) -> Gas:
    """Grow a gas over samples (N, D) in random order; the same samples and generator give the same bits.

    Fewer than two samples are the nodes themselves.
    """
    config = config or GasConfig()
    if len(samples) < 2:
        return Gas(np.array(samples, np.float32), np.empty((0, 2), np.int64))
    shown = np.concatenate([rng.permutation(len(samples)) for _ in range(config.epochs)])
    state = _empty_state(min(config.max_nodes, 2 + len(shown) // config.insertion_period), samples.shape[1])
    rule = LearningRule(
        winner_step=np.float32(config.winner_step_ratio),
        neighbor_step=np.float32(config.neighbor_step_ratio),
        split=np.float32(config.split_factor),
        decay=np.float32(config.decay),
        insertion_period=config.insertion_period,
        max_edge_age=config.max_edge_age,
    )
    count = learn_all(np.ascontiguousarray(samples, np.float32)[shown], state, rule)
    edges = np.argwhere(np.triu(state.age[:count, :count]) > NO_EDGE)
    return Gas(np.ascontiguousarray(state.columns[:, :count].T), edges[edges[:, 0] < edges[:, 1]])


def _empty_state(capacity: int, size: int) -> GasState:
    capacity = max(capacity, 2)
    return GasState(
        columns=np.zeros((size, capacity), np.float32),
        penalty=np.full(capacity, np.inf, np.float32),
        error=np.zeros(capacity, np.float32),
        age=np.full((capacity, capacity), NO_EDGE, np.int32),
        degree=np.zeros(capacity, np.int32),
    )


@njit(cache=True)
def learn_all(samples: Floats, state: GasState, rule: LearningRule) -> int:
    """Learn from all samples (N, D), N > 1, in their order.

    Args:
        samples: (N, D) float32, contiguous.
        state: storage without a node.
        rule: steps, factors and ages.

    Returns:
        Number of nodes.
    """
    for node in range(2):  # step 0: two nodes at random places; at samples, as most of the space is empty
        _move(state, node, samples[node], 1)
    count = 2
    closeness = np.empty_like(state.penalty)
    for i in range(len(samples)):
        count = _learn(samples[i], state, count, closeness, rule)
        if (i + 1) % rule.insertion_period == 0 and count < len(state.penalty):
            count = _insert(state, count, rule.split)
        for node in range(count):
            state.error[node] *= rule.decay  # step 9
    return count


@njit(cache=True)
def _learn(sample: Floats, state: GasState, count: int, closeness: Floats, rule: LearningRule) -> int:
    """Do steps 2 to 7 for one sample; return the number of nodes after."""
    winner, second = _two_nearest(sample, state, count, closeness)
    state.error[winner] += _move(state, winner, sample, rule.winner_step)
    for other in range(count):
        if state.age[winner, other] > NO_EDGE:
            _move(state, other, sample, rule.neighbor_step)
            age = state.age[winner, other] + 1
            _set_edge(state, winner, other, age if age <= rule.max_edge_age or other == second else NO_EDGE)
    _set_edge(state, winner, second, 0)
    return _remove_isolated(state, count)


@njit(cache=True)
def _two_nearest(sample: Floats, state: GasState, count: int, closeness: Floats) -> tuple[int, int]:
    """Find the nearest node and the second nearest (step 2)."""
    # |s - w|^2 = |s|^2 - 2 (s.w - |w|^2 / 2) is least where s.w - |w|^2 / 2 is greatest
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
def _insert(state: GasState, count: int, split: float) -> int:
    """Insert a node between that of greatest error and its neighbour of greatest error (step 8)."""
    worst, neighbor = 0, -1
    for node in range(1, count):
        if state.error[node] > state.error[worst]:
            worst = node
    for other in range(count):
        joined = state.age[worst, other] > NO_EDGE
        if joined and (neighbor < 0 or state.error[other] > state.error[neighbor]):
            neighbor = other
    if neighbor < 0:
        return count
    for k in range(len(state.columns)):
        state.columns[k, count] = np.float32(0.5) * (state.columns[k, worst] + state.columns[k, neighbor])
    _update_penalty(state, count)
    _set_edge(state, worst, neighbor, NO_EDGE)
    _set_edge(state, worst, count, 0)
    _set_edge(state, neighbor, count, 0)
    state.error[worst] *= split
    state.error[neighbor] *= split
    state.error[count] = state.error[worst]
    return count + 1


@njit(cache=True)
def _remove_isolated(state: GasState, count: int) -> int:
    """Remove the nodes that have lost their last edge (step 7); return the number of nodes."""
    # The last node takes the place of a removed one, so that the nodes in use stay the first ones.
    node = 0
    while node < count and count > 2:
        if state.degree[node] > 0:
            node += 1
            continue
        count -= 1
        _move_last(state, count, node)
    return count


@njit(cache=True)
def _move_last(state: GasState, node: int, name: int) -> None:
    """Move the last node to the index of a node without edges."""
    for other in range(node):
        age = state.age[node, other]
        if age > NO_EDGE:
            _set_edge(state, node, other, NO_EDGE)
            _set_edge(state, name, other, age)
    for k in range(len(state.columns)):
        state.columns[k, name] = state.columns[k, node]
    state.penalty[name], state.error[name] = state.penalty[node], state.error[node]
    state.penalty[node], state.error[node] = np.inf, 0


@njit(cache=True)
def _move(state: GasState, node: int, sample: Floats, step: float) -> np.float32:
    """Move a node by a share of the distance to the sample; return the squared distance."""
    squared = np.float32(0)
    for k in range(len(sample)):
        offset = sample[k] - state.columns[k, node]
        squared += offset * offset
        state.columns[k, node] += np.float32(step) * offset
    _update_penalty(state, node)
    return squared


@njit(cache=True)
def _update_penalty(state: GasState, node: int) -> None:
    """Update the penalty of a node that has moved."""
    total = np.float32(0)
    for k in range(len(state.columns)):
        total += state.columns[k, node] * state.columns[k, node]
    state.penalty[node] = np.float32(0.5) * total


@njit(cache=True)
def _set_edge(state: GasState, first: int, second: int, age: int) -> None:
    """Set the age of the edge between two nodes; NO_EDGE removes it."""
    change = (age > NO_EDGE) - (state.age[first, second] > NO_EDGE)
    state.degree[first] += change
    state.degree[second] += change
    state.age[first, second] = state.age[second, first] = age
