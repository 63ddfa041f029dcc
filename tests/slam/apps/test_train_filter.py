"""`revisit filter train`: what it writes and what it refuses."""

import tomllib

import numpy as np
import pytest

from slam.apps.train import train_filter_file
from slam.errors import ConfigError, DataError


@pytest.fixture
def files(tmp_path):
    """A matrix of 200 images in sequences of 4 with a revisit from the 25th on, and its truth."""
    rng, first = np.random.default_rng(0), np.arange(0, 200, 4)
    truth = np.zeros((200, 200), np.uint8)
    for k in range(100, 200):
        truth[k, k - 100] = 1
    matrix = np.full((200, 200), np.nan, np.float32)
    for i, row in enumerate(first):
        near = np.abs(np.arange(max(i - 4, 0)) - (i - 25)) == 0
        matrix[row, first[: max(i - 4, 0)]] = rng.uniform(0, 0.3, len(near)) + 0.5 * near
    np.savez(tmp_path / "matrix.npz", similarity=matrix, step=np.array(1))
    np.savez(tmp_path / "truth.npz", truth=truth)
    return tmp_path


def test_the_filter_is_written_as_settings_that_name_its_paradigm(files):
    summary = train_filter_file(files / "matrix.npz", files / "truth.npz", files / "f.toml", "dynamic-sequences")
    learnt = tomllib.loads((files / "f.toml").read_text())["places"]["dynamic_sequences"]["filter"]
    assert np.shape(learnt["kernel"]) == (3, 3)
    assert learnt["kernel"][1][1] > 0
    assert "25 cells of revisits, 25 of them found; 0 others" in summary


def test_files_that_do_not_belong_together_are_named(files):
    np.savez(files / "other.npz", truth=np.eye(7))
    with pytest.raises(DataError, match=r"matrix\.npz and .*other\.npz: expected a matrix"):
        train_filter_file(files / "matrix.npz", files / "other.npz", files / "f.toml", "dynamic-sequences")


def test_missing_foreign_and_shrunk_matrices_are_refused(files):
    arguments = (files / "truth.npz", files / "f.toml", "dynamic-sequences")
    with pytest.raises(DataError, match=r"none\.npz: expected the matrix\.npz of revisit places"):
        train_filter_file(files / "none.npz", *arguments)
    with pytest.raises(DataError, match=r"expected an array named similarity, .* found truth"):
        train_filter_file(files / "truth.npz", *arguments)
    np.savez(files / "shrunk.npz", similarity=np.eye(4), step=np.array(2))
    with pytest.raises(DataError, match="found it shrunk"):
        train_filter_file(files / "shrunk.npz", *arguments)
    assert not (files / "f.toml").exists()


def test_a_paradigm_without_a_filter_is_refused(files):
    with pytest.raises(ConfigError, match="expected one with a filter, sequence-histograms or dynamic-sequences"):
        train_filter_file(files / "matrix.npz", files / "truth.npz", files / "f.toml", "tracked-words")
