"""Parts that are frozen and thawed are what they were, to the bit."""

import json
import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from place_recognition.image_processing.features import LocalFeatures
from place_recognition.map.growing import GrowingArray
from place_recognition.map.image_store import FeatureStore
from slam.map_store import freezing
from slam.map_store.freezing import Freezer, Thawer


@pytest.fixture(autouse=True)
def _these_are_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(freezing, "_OURS", (*freezing._OURS, __name__.split(".")[0]))


class Part:
    """Something that changes, with a function that no file could hold."""

    built = 0

    def __init__(self, double: Any = lambda x: 2 * x) -> None:
        Part.built += 1
        self.double = double
        self.content: Any = None
        self.other: Part | None = None


@dataclass(frozen=True)
class Setting:
    name: str
    twin: Any = field(default=None)


class Pair(NamedTuple):
    first: int
    second: Any


def there_and_back(thing: Any, fresh: Any = None) -> Any:
    freezer = Freezer()
    written = json.dumps(freezer.freeze(thing), allow_nan=False)
    return Thawer([array.copy("K") for array in freezer.arrays]).thaw(json.loads(written), fresh)


PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
NESTED = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner) | st.tuples(inner, inner) | st.dictionaries(st.integers() | st.text(), inner)
        | st.lists(inner, max_size=3).map(lambda items: deque(items, maxlen=5))
    ),
    max_leaves=20,
)  # fmt: skip


@given(NESTED)
def test_plain_things_come_back(thing: Any):
    back = there_and_back(thing)
    assert back == thing
    assert repr(back) == repr(thing)  # -0.0 and 0, True and 1, kinds of containers


@given(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex64]), hnp.array_shapes()
    )
)
def test_arrays_come_back_to_the_bit(array: np.ndarray):
    for one in (array, np.asfortranarray(array), array[::-1]):
        back = there_and_back(one)
        assert back.dtype == one.dtype
        assert back.tobytes() == one.tobytes()


def test_what_is_no_number_comes_back():
    back = there_and_back([math.nan, math.inf, -math.inf, np.float32(0.1), b"\x00\xff", {3, 1}, range(2, 9, 3)])
    assert math.isnan(back[0])
    assert back[1:] == [math.inf, -math.inf, np.float32(0.1), b"\x00\xff", {1, 3}, range(2, 9, 3)]
    assert type(back[3]) is np.float32


def test_a_part_goes_into_a_new_one_without_its_constructor():
    part, fresh = Part(), Part()
    part.content = {"a": [np.arange(3), Pair(1, Setting("x"))]}
    built = Part.built
    back = there_and_back(part, fresh)
    assert back is fresh
    assert Part.built == built
    assert back.double(4) == 8
    assert back.content["a"][1] == Pair(1, Setting("x"))
    np.testing.assert_array_equal(back.content["a"][0], [0, 1, 2])


def test_what_is_shared_is_shared_again():
    part = Part()
    part.content = [1]
    part.other = Part()
    part.other.content = part.content
    part.other.other = part
    fresh = Part()
    fresh.other = Part()
    back = there_and_back(part, fresh)
    back.content.append(2)
    assert back.other.content == [1, 2]
    assert back.other.other is back


def test_two_parts_do_not_go_into_one():
    shared, fresh, part = Part(), Part(), Part()
    fresh.content = [shared, shared]
    part.content = [Part(), Part()]
    part.content[0].content, part.content[1].content = 1, 2
    with pytest.raises(ValueError, match="no builtins:function where there was one"):
        there_and_back(part)  # nothing to keep the functions from
    back = there_and_back(part, fresh)
    assert [inner.content for inner in back.content] == [1, 2]


def test_a_frozen_setting_is_never_changed():
    default = Setting("default")
    part, fresh = Part(), Part()
    part.content, fresh.content = Setting("other"), default
    assert there_and_back(part, fresh).content == Setting("other")
    assert default == Setting("default")


@pytest.mark.parametrize(
    "name", ["os:system", "subprocess:Popen", "slam.nowhere:Thing", "slam.cli:sys", "builtins:eval"]
)
def test_a_file_cannot_name_what_is_not_ours(name: str):
    with pytest.raises(ValueError, match="no part of this version"):
        Thawer([]).thaw({"object": name, "with": [], "n": 0})


@pytest.mark.parametrize(
    "damaged", [{}, {"same": 3}, {"array": 9, "n": 0}, {"tuple": 4, "n": 0}, {"what": [], "n": 1}, []]
)
def test_what_was_never_frozen_is_refused(damaged: Any):
    with pytest.raises(ValueError, match="does not hold what was written"):
        Thawer([]).thaw(damaged)


def test_growing_arrays_and_stored_images_come_back():
    rows: GrowingArray[np.float64] = GrowingArray(np.float64)
    images, new = FeatureStore(5, in_memory=3), FeatureStore(5, in_memory=3)
    rng = np.random.default_rng(0)
    for _ in range(7):  # more than stay in memory
        rows.extend(rng.random((2, 4)))
        unit = rng.standard_normal((5, 8)).astype(np.float32)
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        some = rng.random((5, 2)).astype(np.float32)
        images.add(LocalFeatures(100 * some, 1 + some[:, 0], some[:, 1], unit))
    again, stored = there_and_back((rows, images), (GrowingArray(np.float64), new))
    np.testing.assert_array_equal(again.rows, rows.rows)
    again.extend(np.ones((1, 4)))
    assert len(again) == len(rows) + 1
    assert len(stored) == 7
    for k in range(7):
        np.testing.assert_array_equal(stored[k].quantised, images[k].quantised)
        np.testing.assert_array_equal(stored[k].pixels, images[k].pixels)
