"""The vocabulary file: a line with type and version, a line of JSON, the numbers, and a checksum of all of them.

Plain bytes, never a pickle, so that opening a file from elsewhere runs no code. By the checksum a flipped bit is an
error and not a slightly different vocabulary.
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

Floats = NDArray[np.float32]

MAGIC = b"REVISIT VOCABULARY "
VERSION = 1
STEPS = 127  # words of the encoding "int8" are multiples of 1 / STEPS
REMEDY = "copy it again, or make one with: revisit vocabulary train"

_DIGEST = sha256().digest_size


@dataclass(frozen=True)
class Contents:
    """Contents of a file.

    Attributes:
        kind: kind of the features that the words are made of.
        words: (W, D) float32 words.
        weights: (W,) float32 weights of the words.
    """

    kind: str
    words: Floats
    weights: Floats


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
    words = np.ascontiguousarray(contents.words, np.float32)
    shape = (len(words), words.shape[1])
    name, packed = next(
        (name, packed)
        for name, encoding in _ENCODINGS.items()
        if np.array_equal(encoding.unpack(packed := encoding.pack(words), shape), words)
    )
    header = {"kind": contents.kind, "words": shape[0], "size": shape[1], "encoding": name}
    weights = np.asarray(contents.weights, "<f4").tobytes()
    return b"%s%d\n%s\n" % (MAGIC, VERSION, json.dumps(header).encode()) + packed + weights


def _decode(data: bytes) -> Contents:
    _check_version(data)
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if sha256(body).digest() != digest:
        raise _UnreadableError(f"a vocabulary that matches its checksum, found {len(data)} bytes that do not")
    try:
        _, head, numbers = body.split(b"\n", 2)
        return _from_bytes(json.loads(head), numbers)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _UnreadableError(f"the contents of a vocabulary, found other ones ({error})") from error


def _check_version(data: bytes) -> None:
    first = data[: data.find(b"\n")]
    if not first.startswith(MAGIC):
        raise _UnreadableError("a vocabulary of Revisit, found another kind of file")
    if first != b"%s%d" % (MAGIC, VERSION):
        found = first[len(MAGIC) :].decode("ascii", "replace")[:20]
        raise _UnreadableError(f"a vocabulary of version {VERSION}, found version {found!r}")


def _from_bytes(header: dict[str, Any], numbers: bytes) -> Contents:
    count, size, encoding = header["words"], header["size"], _ENCODINGS[header["encoding"]]
    if not (isinstance(count, int) and isinstance(size, int) and min(count, size) > 0):
        raise ValueError(f"{count!r} words of {size!r} numbers")
    end = count * encoding.row_bytes(size)
    if len(numbers) != end + 4 * count:
        raise ValueError(f"{len(numbers)} bytes for {count} words of {size} numbers")
    words = encoding.unpack(numbers[:end], (count, size))
    return Contents(str(header["kind"]), words, np.frombuffer(numbers[end:], "<f4").astype(np.float32))
