"""The gas learns the shape of what it is shown."""

import numpy as np
import pytest
from place_images import sliding_view, textured_world
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from place_recognition.image_processing.surf import Surf
from place_recognition.vocabulary.growing_neural_gas import GasConfig, grow_gas

SMALL = GasConfig(max_nodes=40, insertion_period=100)


def gas_of(samples, config=SMALL, seed=1):
    return grow_gas(np.asarray(samples, np.float32), np.random.default_rng(seed), config)


def components(gas):
    """Component (K,) of each node in the graph of the edges."""
    rows, columns = gas.edges.T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(gas.nodes), len(gas.nodes)))
    return connected_components(graph, directed=False)[1]


def ring(count, seed=0):
    angles = np.random.default_rng(seed).uniform(0, 2 * np.pi, count)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def quantisation_error(samples, nodes):
    return cdist(samples, nodes).min(axis=1).mean()


def plain_gas(samples, config, seed):
    """Fritzke's algorithm in double precision, step by step as numbered in his paper: nodes and edges."""
    shown = np.asarray(samples, np.float64)[np.random.default_rng(seed).permutation(len(samples))]
    nodes, error, age = [shown[0].copy(), shown[1].copy()], [0.0, 0.0], {}
    for count, sample in enumerate(shown, start=1):
        distances = [float(np.sum((sample - node) ** 2)) for node in nodes]
        winner, second = np.argsort(distances, kind="stable")[:2].tolist()  # 2
        for edge in [edge for edge in age if winner in edge]:  # 3
            age[edge] += 1
        error[winner] += distances[winner]  # 4
        nodes[winner] = nodes[winner] + config.winner_step_ratio * (sample - nodes[winner])  # 5
        for edge in [edge for edge in age if winner in edge]:
            [other] = edge - {winner}
            nodes[other] = nodes[other] + config.neighbor_step_ratio * (sample - nodes[other])
        age[frozenset((winner, second))] = 0  # 6
        age = {edge: old for edge, old in age.items() if old <= config.max_edge_age}  # 7
        assert all(any(k in edge for edge in age) for k in range(len(nodes))), "chosen so that no node is removed"
        if count % config.insertion_period == 0 and len(nodes) < config.max_nodes:  # 8
            worst = int(np.argmax(error))
            joined = sorted(k for edge in age if worst in edge for k in edge - {worst})
            neighbor = max(joined, key=lambda k: (error[k], -k))
            nodes.append((nodes[worst] + nodes[neighbor]) / 2)
            del age[frozenset((worst, neighbor))]
            age[frozenset((worst, len(nodes) - 1))] = age[frozenset((neighbor, len(nodes) - 1))] = 0
            error[worst] *= config.split_factor
            error[neighbor] *= config.split_factor
            error.append(error[worst])
        error = [config.decay * value for value in error]  # 9
    return np.array(nodes), {tuple(sorted(edge)) for edge in age}


@pytest.mark.parametrize("seed", range(3))
def test_the_gas_is_that_of_the_paper_written_out(seed):
    samples = np.random.default_rng(10 + seed).normal(size=(700, 6))
    config = GasConfig(max_nodes=25, insertion_period=25, max_edge_age=10**6)
    gas = gas_of(samples, config, seed)
    nodes, edges = plain_gas(samples.astype(np.float32), config, seed)
    np.testing.assert_allclose(gas.nodes, nodes, atol=1e-4)
    assert {tuple(edge) for edge in gas.edges.tolist()} == edges


@pytest.fixture(scope="module")
def descriptors():
    """SURF of a dozen neighbouring images."""
    views = sliding_view(textured_world(800, seed=5), list(range(0, 240, 20)))
    return np.concatenate([Surf().extract(view).descriptors[:200] for view in views])


def test_a_ring_becomes_one_closed_chain():
    gas = gas_of(ring(6000))
    assert np.abs(np.linalg.norm(gas.nodes, axis=1) - 1).max() < 0.02
    assert (np.bincount(gas.edges.ravel(), minlength=40) == 2).all()
    assert len(set(components(gas))) == 1


def test_no_edge_crosses_the_hole_of_a_ring():
    gas = gas_of(ring(6000))
    length = np.linalg.norm(gas.nodes[gas.edges[:, 0]] - gas.nodes[gas.edges[:, 1]], axis=1)
    assert length.max() < 0.4


@pytest.mark.parametrize("seed", range(3))
def test_blobs_far_apart_get_components_of_their_own(seed):
    rng = np.random.default_rng(seed)
    centers = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]])
    blob = rng.integers(4, size=12000)
    gas = gas_of(centers[blob] + rng.normal(size=(12000, 3)))
    owner = cdist(gas.nodes, centers).argmin(axis=1)
    assert set(owner) == {0, 1, 2, 3}
    assert (owner[gas.edges[:, 0]] == owner[gas.edges[:, 1]]).all()


def test_a_denser_region_gets_more_nodes():
    rng = np.random.default_rng(2)
    samples = np.concatenate([rng.normal(0, 1, (8000, 2)), rng.normal(30, 1, (800, 2))])
    gas = gas_of(samples)
    assert np.sum(gas.nodes[:, 0] < 15) > 2 * np.sum(gas.nodes[:, 0] > 15) > 0


def test_more_nodes_lie_nearer_to_the_descriptors_they_stand_for(descriptors):
    errors = [
        quantisation_error(descriptors, gas_of(descriptors, GasConfig(max_nodes=nodes)).nodes) for nodes in (10, 30, 90)
    ]
    assert errors[0] > errors[1] > errors[2]


def test_nodes_stand_for_descriptors_better_than_picks_do(descriptors):
    gas = gas_of(descriptors, GasConfig(epochs=2))
    picks = np.random.default_rng(0).choice(descriptors, len(gas.nodes), replace=False)
    assert quantisation_error(descriptors, gas.nodes) < 0.95 * quantisation_error(descriptors, picks)


def test_a_node_comes_with_each_period_and_never_more_than_allowed(descriptors):
    assert len(gas_of(descriptors[:1000], GasConfig(insertion_period=25, max_edge_age=10**6)).nodes) == 42
    assert len(gas_of(descriptors[:1000], GasConfig(max_nodes=7)).nodes) == 7


def test_edges_are_named_once_and_join_different_nodes(descriptors):
    edges = gas_of(descriptors, GasConfig()).edges
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_the_same_generator_gives_the_same_bits_and_another_another_gas(descriptors):
    first, again, other = (gas_of(descriptors, GasConfig(), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.nodes, again.nodes)
    np.testing.assert_array_equal(first.edges, again.edges)
    assert not np.array_equal(first.nodes, other.nodes)


def test_samples_are_left_as_they_are(descriptors):
    before = descriptors.copy()
    grow_gas(descriptors, np.random.default_rng(0))
    np.testing.assert_array_equal(descriptors, before)


@pytest.mark.parametrize("count", [0, 1])
def test_hardly_any_samples_are_their_own_gas(count):
    samples = np.full((count, 4), 0.5, np.float32)
    gas = gas_of(samples)
    np.testing.assert_array_equal(gas.nodes, samples)
    assert gas.edges.shape == (0, 2)


def test_equal_samples_need_no_more_than_finite_nodes_at_their_place():
    gas = gas_of(np.ones((500, 3)))
    np.testing.assert_allclose(gas.nodes, 1, rtol=1e-6)
