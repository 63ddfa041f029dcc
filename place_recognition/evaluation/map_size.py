"""How large the map of a recogniser has become."""

from collections import deque
from dataclasses import dataclass
from types import FunctionType, ModuleType

import numpy as np

_OPAQUE = (str, bytes, int, float, complex, bool, type(None), type, FunctionType, ModuleType)


@dataclass(frozen=True)
class MapSize:
    """Size of a map.

    Attributes:
        words: visual words in it; None for a paradigm without words.
        bytes: memory of everything the recogniser holds on to, a vocabulary included.
    """

    words: int | None
    bytes: int


def map_size(recognizer: object) -> MapSize:
    """Ask a recogniser for its `word_count` and `map_bytes`; where it does not know its bytes, add up its arrays."""
    words, size = getattr(recognizer, "word_count", None), getattr(recognizer, "map_bytes", None)
    return MapSize(words, array_bytes(recognizer) if size is None else size)


def array_bytes(thing: object) -> int:
    """Bytes of all numpy arrays that can be reached from a thing, each counted once however many share it."""
    seen: set[int] = set()
    buffers: dict[int, int] = {}
    waiting = [thing]
    while waiting:
        item = waiting.pop()
        if isinstance(item, _OPAQUE) or id(item) in seen:
            continue
        seen.add(id(item))
        if isinstance(item, np.ndarray):
            owner = _owner(item)
            buffers[id(owner)] = owner.nbytes
        else:
            waiting.extend(_parts(item))
    return sum(buffers.values())


def _owner(array: np.ndarray) -> np.ndarray:
    """The array that owns the memory of a view."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _parts(item: object) -> list[object]:
    if isinstance(item, dict):
        return [*item.keys(), *item.values()]
    if isinstance(item, list | tuple | set | frozenset | deque):
        return list(item)
    named = list(vars(item).values()) if hasattr(item, "__dict__") else []
    return named + [getattr(item, name) for name in getattr(type(item), "__slots__", ()) if hasattr(item, name)]
