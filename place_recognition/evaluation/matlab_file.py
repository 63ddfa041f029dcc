"""Matrices in MATLAB files of the versions 5 to 7.2, by the format that MathWorks publishes (MAT-File Format, 2019).

SciPy reads these too, but trusts them: a damaged byte can make it end the process. Here every size is checked against
the bytes that there are.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Order = Literal["<", ">"]
Bytes = bytes | memoryview

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
# Kinds of numbers in the file, and classes of matrices in the program.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_SPARSE, _FULL = 5, range(6, 16)
_MOST_CELLS = 1 << 27  # of a sparse matrix, which a few bytes can claim to be as large as they like


@dataclass(frozen=True)
class Element:
    """A piece of a file: what kind it is of, and its bytes."""

    kind: int
    data: Bytes


@dataclass(frozen=True)
class Variable:
    """What a file says of a variable.

    Attributes:
        name: of it.
        shape: rows, columns, ...
        kind: class of the matrix.
        parts: its numbers.
        order: of their bytes.
    """

    name: str
    shape: tuple[int, ...]
    kind: int
    parts: tuple[Element, ...]
    order: Order

    def positive(self) -> NDArray[np.bool_]:
        """Which of its numbers (rows, columns, ...) are above 0; of complex ones which real parts.

        Raises:
            ValueError: it holds none, or others than its shape asks for.
        """
        if self.kind == _SPARSE:
            return self._sparse()
        if self.kind not in _FULL:
            raise ValueError(f"expected a matrix of numbers, found {self.name} of class {self.kind}")
        numbers = self._part(0)
        if len(numbers) != math.prod(self.shape):
            raise ValueError(f"expected {self.shape} numbers in {self.name}, found {len(numbers)}")
        return np.greater(numbers, 0).reshape(self.shape, order="F")

    def _sparse(self) -> NDArray[np.bool_]:
        rows, starts, values = self._part(0), self._part(1), self._part(2)
        if len(self.shape) != 2 or math.prod(self.shape) > _MOST_CELLS or len(starts) != self.shape[1] + 1:
            raise ValueError(f"expected a sparse matrix of up to {_MOST_CELLS} cells, found {self.shape}")
        ends = starts.astype(np.int64)
        count = int(ends[-1])
        if ends[0] != 0 or (np.diff(ends) < 0).any() or not count <= min(len(rows), len(values)):
            raise ValueError(f"expected {len(values)} numbers in the columns of {self.name}, found {count}")
        places = rows[:count].astype(np.int64)
        if ((places < 0) | (places >= self.shape[0])).any():
            raise ValueError(f"expected rows of {self.name} below {self.shape[0]}, found others")
        full = np.zeros(self.shape, np.bool_)
        full[places, np.repeat(np.arange(self.shape[1]), np.diff(ends))] = values[:count] > 0
        return full

    def _part(self, index: int) -> NDArray[Any]:
        if index >= len(self.parts):
            raise ValueError(f"expected the numbers of {self.name}, found none")
        return _numbers(self.parts[index], self.order)


def read_variables(path: Path) -> tuple[Variable, ...]:
    """Variables of a file, whatever they hold.

    Raises:
        ValueError: it is no such file, or damaged.
    """
    data = path.read_bytes()
    order = _byte_order(data)
    try:
        return tuple(_variable(body, order) for body in _matrices(memoryview(data)[_HEADER:], order))
    except (struct.error, zlib.error, IndexError) as error:
        raise ValueError(f"expected a variable, found {error}") from error


def _byte_order(data: bytes) -> Order:
    orders: dict[bytes, Order] = {b"IM": "<", b"MI": ">"}
    mark = data[_HEADER - 2 : _HEADER]
    if mark not in orders:
        raise ValueError(f"expected the mark of such a file at byte {_HEADER - 2}, found {mark!r}")
    return orders[mark]


def _matrices(data: Bytes, order: Order) -> Iterator[Bytes]:
    for element in _elements(data, order):
        if element.kind == _COMPRESSED:
            yield from _matrices(_inflated(element.data, order), order)
        elif element.kind == _MATRIX:
            yield element.data


def _inflated(data: Bytes, order: Order) -> bytes:
    """The one element in a compressed one: as many bytes as it says it has, and no more."""
    stream = zlib.decompressobj()
    tag = stream.decompress(data, 8)
    kind, size = struct.unpack(f"{order}II", tag)
    if kind == _COMPRESSED:
        raise ValueError("expected a variable that is compressed once, found one compressed again")
    return tag + stream.decompress(stream.unconsumed_tail, size) if size else tag


def _elements(data: Bytes, order: Order) -> Iterator[Element]:
    """The pieces that lie one after the other."""
    view, at = memoryview(data), 0
    while at < len(view):
        kind, size = struct.unpack_from(f"{order}II", view, at)
        start, padded = at + 8, size if kind == _COMPRESSED else -(-size // 8) * 8
        if kind >> 16:  # a small one, whose bytes stand in its tag
            kind, size, start, padded = kind & 0xFFFF, kind >> 16, at + 4, 0
        if start + size > len(view) or (start == at + 4 and size > 4):
            raise ValueError(f"expected an element of {size} bytes, found {len(view) - start}")
        yield Element(kind, view[start : start + size])
        at += 8 + padded


def _variable(body: Bytes, order: Order) -> Variable:
    pieces = tuple(_elements(body, order))
    if len(pieces) < 3:
        raise ValueError(f"expected flags, sizes and a name of a variable, found {len(pieces)} elements")
    flags, shape, name, *parts = pieces
    kind = int(_numbers(flags, order)[0]) & 0xFF
    sizes = tuple(_numbers(shape, order).tolist())
    if len(sizes) < 2 or min(sizes) < 0:
        raise ValueError(f"expected the sizes of a matrix, found {sizes}")
    return Variable(bytes(name.data).decode("ascii", "replace"), sizes, kind, tuple(parts), order)


def _numbers(element: Element, order: Order) -> NDArray[Any]:
    if element.kind not in _NUMBERS:
        raise ValueError(f"expected numbers, found an element of kind {element.kind}")
    dtype = np.dtype(order + _NUMBERS[element.kind])
    if len(element.data) % dtype.itemsize:
        raise ValueError(f"expected numbers of {dtype.itemsize} bytes, found {len(element.data)} bytes")
    return np.frombuffer(element.data, dtype)
