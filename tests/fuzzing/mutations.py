"""Valid files, damaged as copying, editing and malice damage them."""

import random
import re
from collections.abc import Callable, Sequence

TOKEN = re.compile(rb"[-+.\w]+")

# What readers stumble over: numbers at and beyond the ends, marks of the formats, characters of many kinds.
HARD_WORDS = (
    *(b"nan", b"-inf", b"1e999", b"1e308", b"-1e308", b"1e-320", b"0", b"-0", b"-1", b"1e9", b"2147483648", b"1_0"),
    *(b"0x1F", b"9" * 20, b"9" * 400, b"9" * 5000, b"1.5", b"", b" ", b"\t", b",", b";", b"#", b'"', b'"""', b"'"),
    *(b"\\", b"\n", b"\r", b"=", b"[", b"[[", b"{", b"}", b":", b"- ", b"&a", b"*a", b"!!python/name:os.system"),
    *(b"true", b"null", b"../..", b"/", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3", b"\x1b[31m", b"\x7f"),
    *("\u2028".encode(), "\u0661".encode(), "\u00e4".encode(), "\U0001f600".encode(), b"\xed\xa0\x80"),
)
HARD_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1)
MOST_BYTES = 1 << 16


def mutated(rng: random.Random, seeds: Sequence[bytes]) -> bytes:
    """One of some valid files with one to five changes."""
    data = bytearray(rng.choice(seeds))
    for _ in range(1 + min(int(rng.expovariate(0.9)), 4)):
        rng.choice(CHANGES)(rng, data)
    if rng.random() < 0.05:
        other = rng.choice(seeds)
        data[rng.randint(0, len(data)) :] = other[rng.randint(0, len(other)) :]
    return bytes(data[:MOST_BYTES])


def _flip(rng: random.Random, data: bytearray) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _set_byte(rng: random.Random, data: bytearray) -> None:
    if data:
        data[rng.randrange(len(data))] = rng.randrange(256)


def _cut_end(rng: random.Random, data: bytearray) -> None:
    del data[rng.randint(0, len(data)) :]


def _cut(rng: random.Random, data: bytearray) -> None:
    start = rng.randint(0, len(data))
    del data[start : start + rng.randint(1, 40)]


def _repeat(rng: random.Random, data: bytearray) -> None:
    start = rng.randint(0, len(data))
    data[start:start] = data[start : start + rng.randint(1, 40)] * rng.choice((1, 1, 2, 100))


def _insert_word(rng: random.Random, data: bytearray) -> None:
    start = rng.randint(0, len(data))
    data[start:start] = rng.choice(HARD_WORDS)


def _replace_word(rng: random.Random, data: bytearray) -> None:
    """Another word, at the next place from a random one on that has a word."""
    found = TOKEN.search(data, rng.randint(0, len(data)))
    if found:
        data[found.start() : found.end()] = rng.choice(HARD_WORDS)


def _set_integer(rng: random.Random, data: bytearray) -> None:
    size, order = rng.choice((1, 2, 4, 8)), rng.choice(("little", "big"))
    start = rng.randint(0, max(len(data) - size, 0))
    value = (rng.choice(HARD_INTEGERS) + rng.randint(-1, 1)) % 256**size
    data[start : start + size] = value.to_bytes(size, order)  # type: ignore[arg-type]


def _change_lines(rng: random.Random, data: bytearray) -> None:
    """Drop a line, write it twice, or swap two."""
    lines = bytes(data).split(b"\n")
    one, other, what = rng.randrange(len(lines)), rng.randrange(len(lines)), rng.randrange(3)
    if what == 0:
        del lines[one]
    elif what == 1:
        lines.insert(other, lines[one])
    else:
        lines[one], lines[other] = lines[other], lines[one]
    data[:] = b"\n".join(lines)


CHANGES: tuple[Callable[[random.Random, bytearray], None], ...] = (
    _flip, _set_byte, _cut_end, _cut, _repeat, _insert_word, _insert_word, _replace_word, _replace_word, _replace_word,
    _set_integer, _change_lines, _change_lines,
)  # fmt: skip
