"""No camera file and no table, whatever is in it, does more than be read or be refused by name."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slam.datasets.calibration_yaml import find_calibration
from slam.datasets.camera_toml import read_camera_toml
from slam.datasets.formats.euroc import read_sensor_yaml
from slam.datasets.formats.rosbag_messages import ENCODINGS, decode_image
from slam.datasets.formats.timestamped_lists import (
    CSV_NANOSECONDS,
    SPACE_SEPARATED_SECONDS,
    read_image_list,
    read_timestamped_rows,
)
from slam.errors import DataError

WORDS = ["fx", "fy", "cx", "cy", "baseline", "model", "distortion", "right_camera", "T_left_right", "fps", "left"]
VALUES = st.one_of(
    st.floats(), st.integers(), st.booleans(), st.sampled_from(["radtan", "equidistant", "", "none"]),
    st.lists(st.floats(-2, 2), max_size=16),
)  # fmt: skip
TABLES = st.dictionaries(st.sampled_from(WORDS), VALUES | st.dictionaries(st.sampled_from(WORDS), VALUES))
quick = settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@quick
@given(table=TABLES)
def test_any_camera_file_is_read_or_refused_by_name(tmp_path: Path, table: dict[str, object]) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(tomli_w.dumps({"fx": 200, "fy": 200, "cx": 160, "cy": 120} | table))
    assert_read_or_refused(path, lambda: read_camera_toml(path).rectification((320, 240)))


@quick
@given(data=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_read_or_refused_by_name(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(data)
    for read in (
        lambda: read_camera_toml(path),
        lambda: read_sensor_yaml(path),
        lambda: read_timestamped_rows(path, CSV_NANOSECONDS, 8),
        lambda: read_image_list(path, tmp_path, SPACE_SEPARATED_SECONDS),
    ):
        assert_read_or_refused(path, read)


CELLS = st.one_of(st.integers(), st.floats(), st.text("0123456789.,-e# nan\0", max_size=12)).map(str)


@quick
@given(rows=st.lists(st.lists(CELLS, max_size=9), max_size=6))
def test_any_table_is_read_or_refused_by_name(tmp_path: Path, rows: list[list[str]]) -> None:
    path = tmp_path / "data.csv"
    path.write_text("\n".join(",".join(row) for row in rows))
    for read in (
        lambda: read_timestamped_rows(path, CSV_NANOSECONDS, 8),
        lambda: read_image_list(path, tmp_path, CSV_NANOSECONDS),
    ):
        assert_read_or_refused(path, read)


SENSORS = st.dictionaries(
    st.sampled_from(["T_BS", "intrinsics", "distortion_model", "distortion_coefficients"]),
    st.one_of(VALUES, st.none(), st.dictionaries(st.sampled_from(["data", "cols"]), VALUES | st.none())),
)


@quick
@given(table=SENSORS)
def test_any_sensor_is_read_or_refused_by_name(tmp_path: Path, table: dict[str, object]) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(yaml.safe_dump(table))
    assert_read_or_refused(path, lambda: read_sensor_yaml(path))


CALIBRATION_WORDS = [
    "M1", "D1", "M2", "D2", "R", "T", "R1", "P1", "R2", "P2", "camera_matrix", "distortion_coefficients",
    "image_width", "image_size", "Camera.fx", "Camera.fy", "Camera.cx", "Camera.cy", "Camera.k1", "Camera.bf",
    "Camera.fps", "Stereo.b", "Camera.width", "Stereo.T_c1_c2", "cam0", "cam1", "intrinsics", "distortion_coeffs",
    "resolution", "T_cn_cnm1", "data",
]  # fmt: skip
MATRICES = st.sampled_from([9, 3, 4, 12, 16]).flatmap(lambda n: st.lists(st.floats(-500, 500), min_size=n, max_size=n))
CALIBRATION_VALUES = st.one_of(VALUES, MATRICES, st.none(), st.just([1, 0, 0, 0, 1, 0, 0, 0, 1]))


@quick
@given(
    table=st.dictionaries(
        st.sampled_from(CALIBRATION_WORDS),
        CALIBRATION_VALUES | st.dictionaries(st.sampled_from(CALIBRATION_WORDS), CALIBRATION_VALUES),
    )
)
def test_any_calibration_in_yaml_is_read_or_refused_by_name(tmp_path: Path, table: dict[str, object]) -> None:
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(table))

    def read() -> None:
        found = find_calibration(tmp_path)
        if found is not None:
            found.rectification((320, 240))

    assert_read_or_refused(tmp_path / "calibration.yaml", read)


def test_yaml_that_expands_to_a_million_values_is_refused_at_once(tmp_path: Path) -> None:
    lines = ["a0: &a0 [1,1,1,1,1,1,1,1,1,1]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
    path = tmp_path / "sensor.yaml"
    path.write_text("\n".join([*lines, "intrinsics: *a8", "T_BS: *a8"]))
    with pytest.raises(DataError, match=r"sensor.yaml: expected"):
        read_sensor_yaml(path)


SMALL = st.integers(0, 6)


@quick
@given(
    encoding=st.sampled_from([*ENCODINGS, "", "32FC1"]), height=SMALL, width=SMALL, step=st.integers(0, 30),
    data=st.binary(max_size=150), is_bigendian=st.booleans(),
)  # fmt: skip
def test_any_message_is_an_image_or_is_refused(height: int, width: int, **message: object) -> None:
    try:
        image = decode_image(SimpleNamespace(height=height, width=width, **message))
    except ValueError:
        return
    assert (image.shape, image.dtype) == ((height, width), np.uint8)


@quick
@given(data=st.binary(max_size=100), start=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"BM"]))
def test_any_compressed_message_is_an_image_or_is_refused(data: bytes, start: bytes) -> None:
    try:
        image = decode_image(SimpleNamespace(format="png", data=start + data))
    except ValueError:
        return
    assert (image.ndim, image.dtype) == (2, np.uint8)


def assert_read_or_refused(path: Path, read: Callable[[], object]) -> None:
    try:
        read()
    except DataError as error:
        assert str(path.parent) in str(error)  # noqa: PT017 - both outcomes are right
