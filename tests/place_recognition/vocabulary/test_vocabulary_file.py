"""The file of a vocabulary gives back what went in, or says what is wrong with it."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from place_recognition.vocabulary import vocabulary_file
from place_recognition.vocabulary.vocabulary import FlatVocabulary, load_vocabulary, save_vocabulary
from place_recognition.vocabulary.vocabulary_file import round_to_steps
from place_recognition.vocabulary.vocabulary_training import VocabularyTrainingConfig, train_tree
from place_recognition.vocabulary.vocabulary_tree import VocabularyTree


def words(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def signs(shape: tuple[int, int]) -> np.ndarray:
    return (np.sign(words(shape)) / np.sqrt(shape[1])).astype(np.float32)


def saved(path: Path, content: np.ndarray) -> FlatVocabulary:
    vocabulary = FlatVocabulary("surf-upright-64", content, np.arange(len(content), dtype=np.float32) / 7)
    save_vocabulary(path, vocabulary)
    return vocabulary


@pytest.mark.parametrize(
    "content",
    [
        words((20, 64)),
        round_to_steps(words((20, 64))),
        signs((20, 256)),
        signs((3, 21)),
        1000 * words((1, 1)),
        -words((2, 3)),
    ],
)
def test_a_round_trip_gives_the_same_bits(tmp_path: Path, content: np.ndarray):
    vocabulary = saved(tmp_path / "a.vocabulary", content)
    again = load_vocabulary(tmp_path / "a.vocabulary")
    assert again.kind == vocabulary.kind
    assert again.words.tobytes() == vocabulary.words.tobytes()
    assert again.weights.tobytes() == vocabulary.weights.tobytes()


def test_a_tree_comes_back_with_the_same_bits_and_words(tmp_path: Path):
    bits = np.random.default_rng(0).integers(0, 2**63, (500, 2)).astype(np.uint64)
    tree = train_tree("orb-100", 100, bits & np.uint64(2**36 - 1), VocabularyTrainingConfig(words=60))
    save_vocabulary(tmp_path / "a.vocabulary", tree)
    again = load_vocabulary(tmp_path / "a.vocabulary")
    assert isinstance(again, VocabularyTree)
    assert (again.kind, again.size, len(again)) == ("orb-100", 100, 60)
    for name in ("centers", "children", "weights", "words"):
        assert getattr(again, name).tobytes() == getattr(tree, name).tobytes()
    descriptors = words((40, 100))
    np.testing.assert_array_equal(again.assign(descriptors), tree.assign(descriptors))


def test_binary_words_take_a_bit_and_words_on_steps_a_byte_a_number(tmp_path: Path):
    saved(tmp_path / "bits", signs((100, 256)))
    saved(tmp_path / "bytes", round_to_steps(words((100, 64))))
    assert (tmp_path / "bits").stat().st_size < 100 * (32 + 4) + 300
    assert (tmp_path / "bytes").stat().st_size < 100 * (64 + 4) + 300


def test_steps_move_a_number_by_half_a_step_at_most():
    before = words((50, 64))
    assert np.abs(round_to_steps(before) - before).max() <= 0.5 / 127 + 1e-6
    np.testing.assert_array_equal(round_to_steps(round_to_steps(before)), round_to_steps(before))


@given(data=st.data())
@settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_damage_goes_unnoticed(tmp_path: Path, data: st.DataObject):
    path = tmp_path / "a.vocabulary"
    saved(path, round_to_steps(words((6, 16))))
    whole = path.read_bytes()
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)), "length")])
    for _ in range(data.draw(st.integers(0, 3), "flips")):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1), "at")] ^= data.draw(st.integers(1, 255), "flip")
    path.write_bytes(damaged)
    if bytes(damaged) != whole:
        with pytest.raises(ValueError, match=r"a\.vocabulary: expected .*, found .*; .*vocabulary train") as error:
            load_vocabulary(path)
        assert "\n" not in str(error.value)


HEAD = b'REVISIT VOCABULARY 1\n{"kind": "x", "words": %d, "size": %d, "encoding": "int8"}\n'


TREE_HEAD = b'REVISIT VOCABULARY 2\n{"kind": "x", "words": 2, "size": 8, "nodes": %d}\n'


def tree_numbers(children: list[int]) -> bytes:
    return bytes(len(children)) + bytes(children) + bytes(8)


def with_checksum(body: bytes) -> bytes:
    return body + vocabulary_file.sha256(body).digest()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"", "found another kind of file"),
        (b"\x89PNG\r\n", "found another kind of file"),
        (b"REVISIT VOCABULARY 3\n{}\n", "of version 1 or 2, found version '3'"),
        (b"REVISIT VOCABULARY 2\n{}\n", "contents"),
        (TREE_HEAD % 3 + tree_numbers([2, 0, 0])[:-1], "13 bytes for 2 words of 3 nodes of 8 bits"),
        (TREE_HEAD % 3 + tree_numbers([1, 1, 0]), "weights"),
        (TREE_HEAD % 3 + tree_numbers([0, 2, 0]), "make a tree"),
        (TREE_HEAD % 4 + tree_numbers([1, 0, 2, 0]), "make a tree"),
        (TREE_HEAD % 0, "contents"),
        (b"REVISIT VOCABULARY 1\n", "contents"),
        (b"REVISIT VOCABULARY 1\n[1, 2]\n", "contents"),
        (b"REVISIT VOCABULARY 1\n{}\n", "contents"),
        (b'REVISIT VOCABULARY 1\n{"kind": "x", "words": 1, "size": 1, "encoding": "zip"}\n', "contents"),
        (HEAD % (9, 9) + b"12", "2 bytes for 9 words"),
        (HEAD % (-1, -4), "contents"),
        (HEAD % (0, 0), "contents"),
        (
            HEAD % (1, 1) + b"\x01\x00\x00\xc0\x7f",
            "fin",
        ),
    ],
)
def test_other_contents_are_refused_although_their_checksum_fits(tmp_path: Path, body: bytes, message: str):
    path = tmp_path / "a.vocabulary"
    path.write_bytes(with_checksum(body))
    with pytest.raises(ValueError, match=message) as error:
        load_vocabulary(path)
    assert str(path) in str(error.value)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"none\.vocabulary: expected a vocabulary, found no such file"):
        load_vocabulary(tmp_path / "none.vocabulary")
    with pytest.raises(ValueError, match="found is a directory"):
        load_vocabulary(tmp_path)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.vocabulary"
    before = saved(path, words((3, 4)))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space"):
        saved(path, words((5, 4)))
    assert load_vocabulary(path).words.tobytes() == before.words.tobytes()
    assert [file.name for file in tmp_path.iterdir()] == ["a.vocabulary"]
