"""Parts of the system as plain values and arrays, and back, bit for bit: what a checkpoint is made of.

Not pickle: nothing is called by a name that stands in a file. Objects of our own packages come back without a call of
their constructor, attribute by attribute; all else a part holds (functions, objects of libraries) stays as it was in
the part that is thawed, which has been built from the same configuration. Parts that share an object share it again.
"""

import math
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_OURS = ("odometry", "place_recognition", "slam")
_PLAIN = (str, int, bool, type(None))


class Freezer:
    """Takes parts apart. What it has seen once it refers to from then on.

    Attributes:
        arrays: all arrays of what was frozen, in the order in which they were met; not copied.
    """

    def __init__(self) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._seen: dict[int, int] = {}
        self._held: list[object] = []  # an id is an object's own only while that lives

    def freeze(self, thing: object) -> Any:
        """Plain values that JSON can write; arrays are numbers of `arrays`."""
        if isinstance(thing, float):
            return thing if math.isfinite(thing) else {"float": repr(thing)}
        if isinstance(thing, _PLAIN):
            return thing
        if isinstance(thing, np.generic) and not isinstance(thing, np.void):
            return {"scalar": self._array(np.asarray(thing))}
        if id(thing) in self._seen:
            return {"same": self._seen[id(thing)]}
        return self._new(thing)

    def _new(self, thing: object) -> Any:
        number = self._seen[id(thing)] = len(self._seen)
        self._held.append(thing)
        for kind, take_apart in _TAKE_APART.items():
            if type(thing) is kind:
                return {kind.__name__: take_apart(self, thing), "n": number}
        if isinstance(thing, np.ndarray):
            return {"array": self._array(thing), "n": number}
        if not _is_ours(thing):
            return {"kept": number, "kind": _name(type(thing))}
        if isinstance(thing, tuple):
            return {"named": _name(type(thing)), "with": self._items(thing), "n": number}
        return {"object": _name(type(thing)), "with": self._pairs(_state(thing)), "n": number}

    def _array(self, array: NDArray[Any]) -> int:
        self.arrays.append(array)
        return len(self.arrays) - 1

    def _pairs(self, items: Mapping[Any, object]) -> list[Any]:
        return [[self.freeze(key), self.freeze(value)] for key, value in items.items()]

    def _items(self, items: Iterable[object]) -> list[Any]:
        return [self.freeze(item) for item in items]


_TAKE_APART: dict[type, Callable[[Freezer, Any], Any]] = {
    list: Freezer._items,
    tuple: Freezer._items,
    set: Freezer._items,
    frozenset: Freezer._items,
    dict: Freezer._pairs,
    range: lambda freezer, thing: [thing.start, thing.stop, thing.step],
    deque: lambda freezer, thing: [thing.maxlen, freezer._items(thing)],
    bytes: lambda freezer, thing: freezer._array(np.frombuffer(thing, np.uint8)),
}


class Thawer:
    """Puts parts together again, into parts newly built from the same configuration."""

    def __init__(self, arrays: list[NDArray[Any]]) -> None:
        self._arrays = arrays
        self._known: dict[int, Any] = {}
        self._taken: set[int] = set()

    def thaw(self, frozen: Any, fresh: object = None) -> Any:
        """What was frozen; objects that change go into the place of `fresh`, where that is of their kind.

        Raises:
            ValueError: this is nothing that was frozen, or `fresh` is of another kind.
        """
        try:
            return self._thaw(frozen, fresh)
        except (KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"it does not hold what was written ({error!r})") from error

    def _thaw(self, frozen: Any, fresh: object) -> Any:
        if isinstance(frozen, (float, *_PLAIN)):
            return frozen
        if not isinstance(frozen, dict) or not frozen:
            raise TypeError(f"{type(frozen).__name__} without content")
        if "float" in frozen:
            return float(frozen["float"])
        if "scalar" in frozen:
            return self._arrays[frozen["scalar"]][()]
        if "same" in frozen:
            return self._known[frozen["same"]]
        if "kept" in frozen:
            return self._keep(frozen, fresh)
        if "object" in frozen:
            return self._object(frozen, fresh)
        if "named" in frozen:
            self._known[frozen["n"]] = tuple.__new__(_kind(frozen["named"]), self._items(frozen["with"], fresh))
            return self._known[frozen["n"]]
        return self._container(frozen, fresh)

    def _keep(self, frozen: Any, fresh: object) -> object:
        if fresh is None:
            raise ValueError(f"there is no {frozen['kind']} where there was one: it is of another configuration")
        self._known[frozen["kept"]] = fresh
        return fresh

    def _container(self, frozen: Any, fresh: object) -> Any:
        """Thaw what is of Python's own kinds; lists, dicts and sets may hold themselves, so they are known at once."""
        kind, number = next(iter(frozen)), frozen["n"]
        known, content = self._known, frozen[kind]
        if kind == "array":
            known[number] = self._arrays[content]
        elif kind == "range":
            known[number] = range(*content)
        elif kind == "bytes":
            known[number] = self._arrays[content].tobytes()
        elif kind == "list":
            known[number] = []
            known[number] += self._items(content, fresh)
        elif kind == "dict":
            known[number] = {}
            known[number].update(self._pairs(content, fresh))
        elif kind == "deque":
            known[number] = deque(maxlen=content[0])
            known[number].extend(self._items(content[1], fresh))
        else:
            known[number] = {"tuple": tuple, "set": set, "frozenset": frozenset}[kind](self._items(content, fresh))
        return known[number]

    def _object(self, frozen: Any, fresh: object) -> Any:
        kind = _kind(frozen["object"])
        alike = type(fresh) is kind
        frozen_kind = is_dataclass(kind) and kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
        own = alike and not frozen_kind and id(fresh) not in self._taken
        thing = fresh if own else object.__new__(kind)
        self._taken.add(id(thing))
        self._known[frozen["n"]] = thing
        _revive(thing, self._pairs(frozen["with"], _state(fresh) if alike else {}))
        return thing

    def _items(self, items: list[Any], fresh: object) -> list[Any]:
        likes = list(fresh) if isinstance(fresh, list | tuple | deque) else []
        return [self._thaw(item, likes[k] if k < len(likes) else None) for k, item in enumerate(items)]

    def _pairs(self, pairs: list[Any], fresh: object) -> dict[Any, Any]:
        likes = fresh if isinstance(fresh, Mapping) else {}
        thawed = ((self._thaw(key, None), value) for key, value in pairs)
        return {key: self._thaw(value, likes.get(key)) for key, value in thawed}


def _is_ours(thing: object) -> bool:
    return type(thing).__module__.split(".")[0] in _OURS and not isinstance(thing, type) and not callable(thing)


def _state(thing: object) -> dict[str, object]:
    """Attributes of an object, or what it says that it is made of (`__getstate__`)."""
    state = thing.__getstate__()
    if isinstance(state, tuple):  # Python's own way to tell of slots
        state = {name: value for part in state if part for name, value in part.items()}
    return dict(state or {})  # type: ignore[call-overload]


def _revive(thing: object, state: dict[str, object]) -> None:
    set_state = getattr(thing, "__setstate__", None)
    if set_state is not None:
        set_state(state)
        return
    for name, value in state.items():
        object.__setattr__(thing, name, value)  # frozen dataclasses too


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _kind(name: str) -> type:
    """A class of ours by its name; only of modules that the program has imported by itself."""
    module, _, qualified = name.partition(":")
    if module.split(".")[0] not in _OURS or module not in sys.modules:
        raise ValueError(f"it names {name}, which is no part of this version")
    kind = getattr(sys.modules[module], qualified, None)
    if not isinstance(kind, type) or kind.__module__ != module:
        raise ValueError(f"it names {name}, which is no part of this version")
    return kind
