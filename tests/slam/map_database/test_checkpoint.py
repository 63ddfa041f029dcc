"""States become JSON and arrays, and come back as they were, to the bit."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slam.map_database.checkpoint import deserialize, serialize


def there_and_back(state: Any) -> Any:
    structure, arrays = serialize(state)
    written = json.dumps(structure, allow_nan=False)
    return deserialize(json.loads(written), [array.copy("K") for array in arrays])


PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
NESTED = st.recursive(
    PLAIN, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20
)  # fmt: skip


@given(NESTED)
def test_plain_states_are_restored(state: Any):
    back = there_and_back(state)
    assert back == state
    assert repr(back) == repr(state)  # -0.0 and 0, True and 1


@given(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex64]), hnp.array_shapes()
    )
)
def test_arrays_are_restored_bit_for_bit(array: np.ndarray):
    for one in (array, np.asfortranarray(array), array[::-1]):
        back = there_and_back({"array": one})["array"]
        assert back.dtype == one.dtype
        assert back.tobytes() == one.tobytes()


def test_numbers_outside_json_are_restored():
    back = there_and_back([math.nan, math.inf, -math.inf, np.float32(0.1), np.float64(0.1)])
    assert math.isnan(back[0])
    assert back[1:3] == [math.inf, -math.inf]
    assert [type(value) for value in back[3:]] == [np.float32, np.float64]
    assert back[3:] == [np.float32(0.1), np.float64(0.1)]


def test_tuples_come_back_as_lists():
    assert there_and_back({"pair": (1, (2, "x"))}) == {"pair": [1, [2, "x"]]}


@pytest.mark.parametrize("strange", [{1: 2}, {1, 2}, object(), b"bytes", {"inner": [range(3)]}])
def test_objects_that_are_no_plain_state_are_refused(strange: Any):
    with pytest.raises(TypeError, match="expected plain values, arrays, lists and dicts with text keys"):
        serialize(strange)


@pytest.mark.parametrize(
    "damaged", [{}, {"array": 9}, {"scalar": "x"}, {"fields": 4}, {"what": []}, {"array": 0, "scalar": 0}, [{}]]
)
def test_structures_that_were_never_serialized_are_refused(damaged: Any):
    with pytest.raises(ValueError, match="expected the state of a component"):
        deserialize(damaged, [])


def test_a_structure_nested_too_deep_is_refused():
    deep: Any = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(ValueError, match="expected the state of a component"):
        deserialize(deep, [])
