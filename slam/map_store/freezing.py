"""States of components as JSON and arrays, and back, bit for bit.

A state is what `state()` of a component returns: dicts with text keys, lists, plain values and numpy arrays, nested.
Decision record: docs/decisions/checkpoints.md.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PLAIN = (str, int, bool, type(None))


def serialize(state: object) -> tuple[Any, list[NDArray[Any]]]:
    """Values that JSON can write, and the arrays of a state in the order in which they were met; not copied.

    Raises:
        TypeError: the state holds something else than dicts, lists, tuples, plain values, numpy scalars and arrays.
    """
    arrays: list[NDArray[Any]] = []
    return _encode(state, arrays), arrays


def deserialize(structure: Any, arrays: list[NDArray[Any]]) -> Any:
    """The state of which `serialize` made a structure and arrays; its tuples have become lists.

    Raises:
        ValueError: the structure is none that `serialize` returns.
    """
    try:
        return _decode(structure, arrays)
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"expected the state of a component, found another structure ({error!r})") from error


def _encode(value: object, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray | np.generic):  # before float, which numpy's float64 is
        arrays.append(np.asarray(value))
        return {"array" if isinstance(value, np.ndarray) else "scalar": len(arrays) - 1}
    if isinstance(value, float) and not math.isfinite(value):  # JSON knows no NaN
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
