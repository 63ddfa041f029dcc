"""Checkpoints: states of components as JSON and arrays, and back, bit for bit; chunks hold the arrays in the database.

A state is what `state()` of a component returns: dicts with text keys, lists, plain values and numpy arrays, nested.
Its arrays are cut into chunks that are named by their digests and written only once, as version control does it: a
recogniser's map grows by a thousandth with each image, and most of it never changes again. Computing the digests of
everything is cheap, writing everything at each checkpoint is not. Decision record: docs/decisions/checkpoints.md.
"""

import json
import math
import sqlite3
from collections.abc import Iterator
from hashlib import blake2b
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_PLAIN = (str, int, bool, type(None))
_CHUNK_BYTES = 1 << 16
_DIGEST_BYTES = 16  # two different chunks of one digest are not to be expected before 2^64 of them


def serialize(state: object) -> tuple[Any, list[NDArray[Any]]]:
    """Structure of a state, as values that JSON can write, and its arrays in order of appearance; not copied.

    Raises:
        TypeError: the state holds anything but dicts, lists, tuples, plain values, numpy scalars and arrays.
    """
    arrays: list[NDArray[Any]] = []
    return _encode(state, arrays), arrays


def deserialize(structure: Any, arrays: list[NDArray[Any]]) -> Any:
    """The state from the structure and arrays that `serialize` returned; its tuples have become lists.

    Raises:
        ValueError: `serialize` does not return such a structure.
    """
    try:
        return _decode(structure, arrays)
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"expected the state of a component, found another structure ({error!r})") from error


def _encode(value: object, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray | np.generic):  # before float, which numpy's float64 is
        arrays.append(np.asarray(value))
        return {"array" if isinstance(value, np.ndarray) else "scalar": len(arrays) - 1}
    if isinstance(value, float) and not math.isfinite(value):  # JSON has no NaN
        return {"float": repr(value)}
    if isinstance(value, (float, *_PLAIN)):
        return value
    if isinstance(value, list | tuple):
        return [_encode(item, arrays) for item in value]
    if isinstance(value, dict):
        return {"fields": {_key(key): _encode(item, arrays) for key, item in value.items()}}
    raise _unexpected(value)


def _key(key: object) -> str:
    if not isinstance(key, str):
        raise _unexpected(key)
    return key


def _unexpected(value: object) -> TypeError:
    kind = type(value).__name__
    return TypeError(f"expected plain values, arrays, lists and dicts with text keys, got {kind}")


def _decode(encoded: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(encoded, float | str | int | bool | None):
        return encoded
    if isinstance(encoded, list):
        return [_decode(item, arrays) for item in encoded]
    ((kind, content),) = encoded.items()
    if kind == "fields":
        return {key: _decode(item, arrays) for key, item in content.items()}
    if kind == "array":
        return arrays[content]
    if kind == "scalar":
        return arrays[content][()]
    if kind == "float":
        return float(content)
    raise KeyError(kind)


def write_arrays(connection: sqlite3.Connection, session: int, arrays: list[NDArray[Any]]) -> None:
    """Write the arrays of a session's checkpoint; they replace those of the previous one."""
    connection.execute("DELETE FROM checkpoint_array WHERE session = ?", (session,))
    known = {bytes(row[0]) for row in connection.execute("SELECT digest FROM chunk")}
    for number, array in enumerate(arrays):
        digests = _write(connection, array, known)
        dtype = json.dumps(npy.dtype_to_descr(array.dtype))
        row = (session, number, dtype, json.dumps(array.shape), _layout(array), b"".join(digests))
        connection.execute("INSERT INTO checkpoint_array VALUES (?, ?, ?, ?, ?, ?)", row)
    _sweep(connection, known)


def read_arrays(connection: sqlite3.Connection, session: int) -> list[NDArray[Any]]:
    """Arrays of a session's checkpoint, in order; they may be written to.

    Raises:
        ValueError: a chunk is missing or does not have its digest.
    """
    found = connection.execute("SELECT * FROM checkpoint_array WHERE session = ? ORDER BY number", (session,))
    return [_read(connection, row) for row in found]


def _write(connection: sqlite3.Connection, array: NDArray[Any], known: set[bytes]) -> list[bytes]:
    if array.dtype.hasobject:
        raise ValueError(f"expected an array of numbers, got {array.dtype}")
    digests = []
    for chunk in _chunks(array):
        digests.append(digest(chunk))
        if digests[-1] not in known:
            connection.execute("INSERT INTO chunk VALUES (?, ?)", (digests[-1], chunk))
            known.add(digests[-1])
    return digests


def _chunks(array: NDArray[Any]) -> Iterator[bytes]:
    """The bytes of an array in its layout, a chunk at a time: a recogniser's map need not be in memory twice."""
    if array.size:
        in_layout = np.asarray(array, order=_layout(array))  # a copy only of what is not contiguous
        flat = in_layout.reshape(-1, order=_layout(array)).view(np.uint8)
        for begin in range(0, len(flat), _CHUNK_BYTES):
            yield flat[begin : begin + _CHUNK_BYTES].tobytes()


def _read(connection: sqlite3.Connection, row: sqlite3.Row) -> NDArray[Any]:
    content = bytearray()
    bounds = range(0, len(row["chunks"]) + 1, _DIGEST_BYTES)
    for begin, end in pairwise(bounds):
        name = row["chunks"][begin:end]
        found = connection.execute("SELECT bytes FROM chunk WHERE digest = ?", (name,)).fetchone()
        if found is None or digest(found[0]) != name:
            raise ValueError("a chunk of the checkpoint is missing or damaged")
        content += found[0]
    dtype = npy.descr_to_dtype(_as_descr(json.loads(row["dtype"])))
    if dtype.hasobject:
        raise ValueError(f"expected an array of numbers, got {dtype}")
    return np.frombuffer(content, dtype).reshape(json.loads(row["shape"]), order=row["layout"])


def digest(content: bytes | memoryview) -> bytes:
    """Digest of a content; a chunk is named by it."""
    return blake2b(content, digest_size=_DIGEST_BYTES).digest()


def _layout(array: NDArray[Any]) -> Literal["C", "F"]:
    """Memory order of an array: a sum over the same numbers in another order may differ in its last bits."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


def _as_descr(read: Any) -> Any:
    """Numpy's description of a type, in which JSON has turned tuples into lists."""
    if isinstance(read, str):
        return read
    return [tuple(tuple(part) if k == 2 else _as_descr(part) for k, part in enumerate(field)) for field in read]


def _sweep(connection: sqlite3.Connection, known: set[bytes]) -> None:
    """Delete the chunks that no checkpoint refers to."""
    used: set[bytes] = set()
    for (names,) in connection.execute("SELECT chunks FROM checkpoint_array"):
        used.update(names[begin : begin + _DIGEST_BYTES] for begin in range(0, len(names), _DIGEST_BYTES))
    connection.executemany("DELETE FROM chunk WHERE digest = ?", [(name,) for name in known - used])
