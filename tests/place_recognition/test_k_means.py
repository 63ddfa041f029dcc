"""k-means by blocks is FAISS's own, bit by bit, and nobody's share of the work changes it."""

import pickle
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import faiss
import numpy as np
import pytest

from place_recognition.map import k_means as module
from place_recognition.map.k_means import Item, Result, Rows, blocks, k_means


def points(count: int, size: int, seed: int = 0) -> np.ndarray:
    return (np.random.default_rng(seed).normal(size=(count, size)) / 8).astype(np.float32)


def travelling(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """A map whose work, items and results go to another process and back."""
    for item in items:
        there = pickle.loads(pickle.dumps((work, item)))
        yield pickle.loads(pickle.dumps(there[0](there[1])))


@pytest.mark.parametrize(("count", "size", "words"), [(9000, 64, 40), (5000, 128, 30), (500, 64, 450)])
def test_the_bits_are_those_of_faiss(monkeypatch: pytest.MonkeyPatch, count: int, size: int, words: int):
    monkeypatch.setattr(module, "ROWS", 4096)
    rows = points(count, size)
    if words > count / 2:
        rows[:100] = rows[0]  # equal rows leave centres without any
    means = faiss.Kmeans(size, words, niter=4, seed=7, min_points_per_centroid=1, max_points_per_centroid=count)
    threads = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    means.train(rows)
    faiss.omp_set_num_threads(threads)
    assert k_means(rows, words, 4, 7).tobytes() == means.centroids.tobytes()
    if words > count / 2:
        assert means.iteration_stats[0]["nsplit"] > 0


def test_what_travels_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(module, "ROWS", 1000)
    rows = points(2500, 64)
    expected = k_means(rows, 20, 3, 0).tobytes()
    assert k_means(rows, 20, 3, 0, travelling).tobytes() == expected
    np.save(tmp_path / "rows.npy", rows)
    assert (
        k_means(np.lib.format.open_memmap(tmp_path / "rows.npy", mode="r"), 20, 3, 0, travelling).tobytes() == expected
    )


def test_rows_of_a_file_travel_as_its_name(tmp_path: Path):
    rows = points(3000, 64)
    np.save(tmp_path / "rows.npy", rows)
    mapped = Rows(np.lib.format.open_memmap(tmp_path / "rows.npy", mode="r"), 100, 2100)
    message = pickle.dumps(mapped)
    assert len(message) < 1000
    assert np.array_equal(pickle.loads(message).values, rows[100:2100])
    assert len(pickle.dumps(Rows(rows, 100, 200))) < 100 * 64 * 4 + 1000


def test_blocks_are_all_rows_once_and_none_is_empty(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "ROWS", 100)
    for count in (0, 1, module.ROWS, module.ROWS + 1, 3 * module.ROWS):
        parts = blocks(np.arange(count, dtype=np.float32)[:, None])
        assert [part.begin for part in parts] == list(range(0, count, module.ROWS))
        assert np.concatenate([np.empty((0, 1)), *(part.values for part in parts)]).ravel().tolist() == list(
            range(count)
        )
