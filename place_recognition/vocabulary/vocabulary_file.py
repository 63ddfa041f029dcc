"""The vocabulary file: a line with type and version, a line of JSON, the numbers, and a checksum of all of them.

Version 1 holds a flat list of words, version 2 a tree of binary words. Plain bytes, never a pickle, so that opening a
file from elsewhere runs no code. By the checksum a flipped bit is an error and not a slightly different vocabulary.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]

MAGIC = b"REVISIT VOCABULARY "
FLAT, TREE = 1, 2  # versions
STEPS = 127  # words of the encoding "int8" are multiples of 1 / STEPS
REMEDY = "copy it again, or make one with: revisit vocabulary train"

_DIGEST = sha256().digest_size


@dataclass(frozen=True)
class FlatContents:
    """Contents of a file of version 1.

    Attributes:
        kind: kind of the features that the words are made of.
        words: (W, D) float32 words.
        weights: (W,) float32 weights of the words.
    """

    kind: str
    words: Floats
    weights: Floats


@dataclass(frozen=True)
class TreeContents:
    """Contents of a file of version 2: a tree of C nodes, of which those without children are the W words.

    Attributes:
        kind: kind of the features that the words are made of.
        size: number of bits of a descriptor.
        centers: (C, ceil(size / 8)) uint8 packed bits of the nodes.
        children: (C,) uint8 number of children of each node.
        weights: (W,) float32 weights of the words.
    """

    kind: str
    size: int
    centers: Bytes
    children: Bytes
    weights: Floats


Contents = FlatContents | TreeContents


@dataclass(frozen=True)
class _Encoding:
    """Conversion of words to bytes (`pack`) and, with their shape, back (`unpack`)."""

    pack: Callable[[Floats], bytes]
    unpack: Callable[[bytes, tuple[int, int]], Floats]
    row_bytes: Callable[[int], int]


def _unpack_bits(data: bytes, shape: tuple[int, int]) -> Floats:
    rows = np.frombuffer(data, np.uint8).reshape(shape[0], -1)
    signs = np.unpackbits(rows, axis=1, count=shape[1]).astype(np.float32) * 2 - 1
    return signs * bit_value(shape[1])


def bit_value(size: int) -> np.float32:
    """Return the absolute value of each of `size` bits as a float: a binary descriptor then has unit length."""
    return np.float32(1 / np.sqrt(size))


# In order of size: a vocabulary is written in the first encoding that loses nothing of it.
_ENCODINGS = {
    "bits": _Encoding(lambda w: np.packbits(w > 0, axis=1).tobytes(), _unpack_bits, lambda size: (size + 7) // 8),
    "int8": _Encoding(
        lambda w: np.clip(np.round(w * STEPS), -STEPS, STEPS).astype(np.int8).tobytes(),
        lambda data, shape: np.frombuffer(data, np.int8).reshape(shape).astype(np.float32) * np.float32(1 / STEPS),
        lambda size: size,
    ),
    "float32": _Encoding(
        lambda w: w.astype("<f4").tobytes(),
        lambda data, shape: np.frombuffer(data, "<f4").reshape(shape).astype(np.float32),
        lambda size: 4 * size,
    ),
}


def round_to_steps(words: Floats) -> Floats:
    """Round words (W, D) to multiples of 1 / STEPS, which a file holds in a byte a number without loss."""
    encoding = _ENCODINGS["int8"]
    return encoding.unpack(encoding.pack(words), (len(words), words.shape[1]))


def write_contents(path: Path, contents: Contents) -> None:
    """Write a file, whole or not at all.

    Raises:
        OSError: the folder is missing or cannot be written.
    """
    body = _encode(contents)
    temporary = path.with_name(f".{path.name}-{uuid4().hex[:8]}")
    try:
        temporary.write_bytes(body + sha256(body).digest())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def read_contents(path: Path) -> Contents:
    """Read a file.

    Raises:
        ValueError: the file is missing, of another type or version, or damaged; the message names the file, what was
            expected and found, and the remedy.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(f"{path}: expected a vocabulary, found {reason}; {REMEDY}") from error
    try:
        return _decode(data)
    except _UnreadableError as error:
        raise ValueError(f"{path}: expected {error}; {REMEDY}") from error


class _UnreadableError(Exception):
    """A file cannot be read; the message is what was expected and what was found."""


def _encode(contents: Contents) -> bytes:
    version, header, numbers = _encode_tree(contents) if isinstance(contents, TreeContents) else _encode_flat(contents)
    weights = np.asarray(contents.weights, "<f4").tobytes()
    return b"%s%d\n%s\n" % (MAGIC, version, json.dumps(header).encode()) + numbers + weights


def _encode_flat(contents: FlatContents) -> tuple[int, dict[str, Any], bytes]:
    words = np.ascontiguousarray(contents.words, np.float32)
    shape = (len(words), words.shape[1])
    name, packed = next(
        (name, packed)
        for name, encoding in _ENCODINGS.items()
        if np.array_equal(encoding.unpack(packed := encoding.pack(words), shape), words)
    )
    return FLAT, {"kind": contents.kind, "words": shape[0], "size": shape[1], "encoding": name}, packed


def _encode_tree(contents: TreeContents) -> tuple[int, dict[str, Any], bytes]:
    header = {"kind": contents.kind, "words": len(contents.weights), "size": contents.size}
    header["nodes"] = len(contents.children)
    return TREE, header, contents.centers.tobytes() + contents.children.tobytes()


def _decode(data: bytes) -> Contents:
    decode = _DECODERS[_read_version(data)]
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if sha256(body).digest() != digest:
        raise _UnreadableError(f"a vocabulary that matches its checksum, found {len(data)} bytes that do not")
    try:
        _, head, numbers = body.split(b"\n", 2)
        return decode(json.loads(head), numbers)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _UnreadableError(f"the contents of a vocabulary, found other ones ({error})") from error


def _read_version(data: bytes) -> int:
    first = data[: data.find(b"\n")]
    if not first.startswith(MAGIC):
        raise _UnreadableError("a vocabulary of Revisit, found another kind of file")
    for version in _DECODERS:
        if first == b"%s%d" % (MAGIC, version):
            return version
    found = first[len(MAGIC) :].decode("ascii", "replace")[:20]
    raise _UnreadableError(f"a vocabulary of version {FLAT} or {TREE}, found version {found!r}")


def _decode_flat(header: dict[str, Any], numbers: bytes) -> FlatContents:
    count, size, encoding = header["words"], header["size"], _ENCODINGS[header["encoding"]]
    _check_numbers(count, size)
    end = count * encoding.row_bytes(size)
    _check_length(numbers, end + 4 * count, f"{count} words of {size} numbers")
    words = encoding.unpack(numbers[:end], (count, size))
    return FlatContents(str(header["kind"]), words, np.frombuffer(numbers[end:], "<f4").astype(np.float32))


def _decode_tree(header: dict[str, Any], numbers: bytes) -> TreeContents:
    count, size, nodes = header["words"], header["size"], header["nodes"]
    _check_numbers(count, size, nodes)
    row = (size + 7) // 8
    _check_length(numbers, nodes * (row + 1) + 4 * count, f"{count} words of {nodes} nodes of {size} bits")
    centers = np.frombuffer(numbers[: nodes * row], np.uint8).reshape(nodes, row)
    children = np.frombuffer(numbers[nodes * row : nodes * (row + 1)], np.uint8)
    weights = np.frombuffer(numbers[nodes * (row + 1) :], "<f4").astype(np.float32)
    return TreeContents(str(header["kind"]), size, centers, children, weights)


_DECODERS: dict[int, Callable[[dict[str, Any], bytes], Contents]] = {FLAT: _decode_flat, TREE: _decode_tree}


def _check_numbers(*numbers: Any) -> None:
    if not (all(isinstance(number, int) for number in numbers) and min(numbers) > 0):
        raise ValueError(f"numbers of words, of their parts and of nodes from 1, got {numbers!r}")


def _check_length(numbers: bytes, length: int, what: str) -> None:
    if len(numbers) != length:
        raise ValueError(f"{len(numbers)} bytes for {what}")
