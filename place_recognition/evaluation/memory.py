"""The memory that the map of a recogniser takes."""

from collections import deque
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MapSize:
    """Size of a map.

    Attributes:
        words: number of visual words in the map; None for a paradigm without words.
        bytes: memory of all that the recogniser keeps, a vocabulary included.
    """

    words: int | None
    bytes: int


def map_size(recognizer: object) -> MapSize:
    """Return the `word_count` and `map_bytes` of a recogniser; without `map_bytes`, add up its arrays."""
    words, size = getattr(recognizer, "word_count", None), getattr(recognizer, "map_bytes", None)
    return MapSize(words, count_array_bytes(recognizer) if size is None else size)


def count_array_bytes(holder: object) -> int:
    """Count the bytes of all NumPy arrays that an object holds, each once however many references it has.

    Searches containers, and objects of the same package: those of other packages may lead anywhere. The `memory_bytes`
    of an object that has them are taken without a search.
    """
    package = _package(holder)
    seen: set[int] = set()
    buffers: dict[int, int] = {}
    known = 0
    waiting = [holder]
    while waiting:
        item = waiting.pop()
        if id(item) in seen:
            continue
        seen.add(id(item))
        if isinstance(item, np.ndarray):
            owner = _memory_owner(item)
            buffers[id(owner)] = owner.nbytes
        elif isinstance(item, dict):
            waiting += [*item.keys(), *item.values()]
        elif isinstance(item, list | tuple | set | frozenset | deque):
            waiting += item
        elif _package(item) == package and hasattr(item, "memory_bytes"):
            known += item.memory_bytes
        elif _package(item) == package:
            waiting += _attributes(item)
    return known + sum(buffers.values())


def _package(holder: object) -> str:
    return type(holder).__module__.split(".")[0]


def _memory_owner(array: np.ndarray) -> np.ndarray:
    """Return the array that owns the memory of a view."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _attributes(item: object) -> list[object]:
    slots = [getattr(item, name) for name in getattr(type(item), "__slots__", ()) if hasattr(item, name)]
    return [*getattr(item, "__dict__", {}).values(), *slots]
