"""metrics.json holds numbers, or null with a reason."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.errors import DataError
from slam.io.metrics import SCHEMA, read_metrics, write_metrics

leaves = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
values = st.recursive(leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=10)
names = st.text().filter(lambda name: name not in ("notes", "schema"))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("metrics") / "metrics.json"


@settings(max_examples=25, deadline=None)
@given(metrics=st.dictionaries(names, values))
def test_metrics_come_back(file: Path, metrics: dict[str, object]) -> None:
    write_metrics(file, metrics)
    assert read_metrics(file) == {"schema": SCHEMA} | metrics | {"notes": {}}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float32("-inf"), np.float64("nan")])
def test_what_is_no_number_becomes_null_with_a_note(file: Path, value: float) -> None:
    write_metrics(file, {"odometry": {"ate_m": value, "parts": [1.0, value]}})
    read = read_metrics(file)
    assert read["odometry"] == {"ate_m": None, "parts": [1.0, None]}
    assert read["notes"].keys() == {"odometry.ate_m", "odometry.parts.1"}


def test_a_given_reason_is_kept(file: Path) -> None:
    notes = {"odometry.ate_m": "there is no ground truth"}
    write_metrics(file, {"odometry": {"ate_m": float("nan")}, "notes": notes})
    assert read_metrics(file)["notes"] == notes


def test_numpy_values_become_plain_ones(file: Path) -> None:
    write_metrics(file, {"a": np.int64(3), "b": np.bool_(True), "c": np.arange(3), "d": (np.float32(0.5),)})
    read = read_metrics(file)
    assert (read["a"], read["b"], read["c"], read["d"]) == (3, True, [0, 1, 2], [0.5])


def test_the_order_of_keys_is_that_of_the_schema(file: Path) -> None:
    write_metrics(file, {"extra": 1, "loops": {}, "frames": 2, "notes": {}, "corrected": {}, "odometry": {}})
    order = ["schema", "frames", "odometry", "corrected", "loops", "extra", "notes"]
    assert list(read_metrics(file)) == order


def test_the_same_metrics_give_the_same_bytes(file: Path) -> None:
    write_metrics(file, {"seed": 1, "source": Path("drive")})
    first = file.read_bytes()
    write_metrics(file, {"source": Path("drive"), "seed": 1})
    assert file.read_bytes() == first


def test_the_file_is_strict_json(file: Path) -> None:
    write_metrics(file, {"x": float("nan")})
    assert json.loads(file.read_text(), parse_constant=pytest.fail)["x"] is None


@pytest.mark.parametrize("text", ["", "{", "[1]"])
def test_another_file_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "metrics.json").write_text(text)
    with pytest.raises(DataError, match=r"metrics.json: expected"):
        read_metrics(tmp_path / "metrics.json")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"metrics.json: expected the metrics of a run, found .*No such file"):
        read_metrics(tmp_path / "metrics.json")
