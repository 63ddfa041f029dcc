"""Growing neural gas: a graph of nodes that learns the distribution and the topology of samples.

Fritzke, 'A Growing Neural Gas Network Learns Topologies', NIPS 7, 1995; the compiled steps are in `gas_kernels`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.map.gas_kernels import NO_EDGE, Floats, State, learn_all


@dataclass(frozen=True)
class GasConfig:
    """Growth of the gas: Fritzke's values but for the period, which determines the number of samples a node stands for.

    The program of the paper that brought the gas to places moves the winner by 0.8 of the distance and removes edges
    after 10 steps: a node is then little more than its latest sample, and fewer revisits are found.

    Attributes:
        max_nodes: maximum number of nodes.
        insertion_period: number of samples from one insertion of a node to the next, lambda in the paper.
        winner_step, neighbor_step: share of the distance to a sample by which the nearest node and its neighbours move.
        split: factor of the errors of the two nodes between which one is inserted, alpha in the paper.
        decay: factor of all errors after each sample.
        max_edge_age: age at which an edge is removed, in wins of its nodes.
        epochs: number of times that all samples are shown.
    """

    max_nodes: int = 300
    insertion_period: int = 25
    winner_step: float = 0.2
    neighbor_step: float = 0.006
    split: float = 0.5
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
    steps = np.array([config.winner_step, config.neighbor_step, config.split, config.decay], np.float32)
    count = learn_all(
        np.ascontiguousarray(samples, np.float32)[shown], state, steps, config.insertion_period, config.max_edge_age
    )
    edges = np.argwhere(np.triu(state.age[:count, :count]) > NO_EDGE)
    return Gas(np.ascontiguousarray(state.columns[:, :count].T), edges[edges[:, 0] < edges[:, 1]])


def _empty_state(capacity: int, size: int) -> State:
    capacity = max(capacity, 2)
    return State(
        columns=np.zeros((size, capacity), np.float32),
        penalty=np.full(capacity, np.inf, np.float32),
        error=np.zeros(capacity, np.float32),
        age=np.full((capacity, capacity), NO_EDGE, np.int32),
        degree=np.zeros(capacity, np.int32),
    )
