"""Growing neural gas: nodes that spread over samples as these come in, joined where the samples join them.

Fritzke, 'A Growing Neural Gas Network Learns Topologies', NIPS 7, 1995; the compiled steps are in `gas_kernels`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.map.gas_kernels import NO_EDGE, Floats, State, learn_all


@dataclass(frozen=True)
class GasConfig:
    """How the gas grows: Fritzke's values but for the period, which sets how many samples a node stands for.

    The code of the paper that brought the gas to places moves the winner by 0.8 of the way and forgets edges after 10
    steps: there a node is little more than its latest sample, and fewer revisits are found.

    Attributes:
        nodes: at most so many.
        period: samples from one insertion of a node to the next, lambda.
        winner_step, neighbour_step: share of the way to a sample by which the nearest node and those joined to it move.
        split: factor of the errors of the two nodes between which one is inserted, alpha.
        decay: factor of all errors after each sample.
        oldest: age at which an edge is forgotten, in wins of its nodes.
        epochs: times that all samples are shown.
    """

    nodes: int = 300
    period: int = 25
    winner_step: float = 0.2
    neighbour_step: float = 0.006
    split: float = 0.5
    decay: float = 0.995
    oldest: int = 50
    epochs: int = 1


@dataclass(frozen=True)
class Gas:
    """What has grown.

    Attributes:
        nodes: (K, D) float32.
        edges: (E, 2) int64, indices of joined nodes, the smaller first.
    """

    nodes: Floats
    edges: NDArray[np.int64]


def grow_gas(samples: Floats, rng: np.random.Generator, config: GasConfig | None = None) -> Gas:
    """Grow a gas over samples (N, D), shown in random order. The same samples and generator give the same bits.

    One sample or none is its own gas.
    """
    config = config or GasConfig()
    if len(samples) < 2:
        return Gas(np.array(samples, np.float32), np.empty((0, 2), np.int64))
    shown = np.concatenate([rng.permutation(len(samples)) for _ in range(config.epochs)])
    state = _empty_state(min(config.nodes, 2 + len(shown) // config.period), samples.shape[1])
    steps = np.array([config.winner_step, config.neighbour_step, config.split, config.decay], np.float32)
    count = learn_all(np.ascontiguousarray(samples, np.float32)[shown], state, steps, config.period, config.oldest)
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
