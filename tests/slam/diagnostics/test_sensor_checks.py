"""Each check reports what it measures, and its bounds are where they are said to be."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry.camera import StereoCamera
from slam.diagnostics.findings import Finding, Inspection, Status, Use, report_fault, report_ok, report_warning
from slam.diagnostics.sensor_checks import (
    ImageStatistics,
    check_camera,
    check_images,
    check_pair_brightness,
    check_rectification,
    check_static_area,
    check_timestamps,
    match_displacements,
    measure_image,
)

from ..datasets.rig import IDEAL, RIGS, Walls


def by_topic(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.topic: finding for finding in findings}


def camera(width: int = 640, height: int = 480, degrees: float = 60.0, **numbers: float) -> StereoCamera:
    f = width / (2 * np.tan(np.radians(degrees / 2)))
    fields = {"fx": f, "fy": f, "cx": (width - 1) / 2, "cy": (height - 1) / 2, "baseline": 0.3} | numbers
    return StereoCamera(**fields, width=width, height=height)


@pytest.mark.parametrize(
    ("degrees", "status"),
    [
        (60, Status.OK),
        (36, Status.OK),
        (119, Status.OK),
        (34, Status.WARNING),
        (121, Status.WARNING),
        (4, Status.FAULT),
    ],
)
def test_the_field_of_view_is_that_of_the_camera(degrees: float, status: Status) -> None:
    found = by_topic(check_camera(camera(degrees=degrees), True))["field of view"]
    assert found.status is status
    assert found.figures["degrees"] == pytest.approx(degrees)


@settings(max_examples=40, deadline=None)
@given(x=st.floats(-0.4, 0.4), y=st.floats(-0.4, 0.4))
def test_the_principal_point_is_measured_from_the_middle(x: float, y: float) -> None:
    found = by_topic(check_camera(camera(cx=319.5 + 640 * x, cy=239.5 + 480 * y), False))["principal point"]
    np.testing.assert_allclose(found.figures["off"], [x, y], atol=1e-9)
    assert found.status is (Status.WARNING if max(abs(x), abs(y)) > 0.12 else Status.OK)


def test_a_principal_point_outside_of_the_image_rules_out_slam_and_not_places() -> None:
    found = by_topic(check_camera(camera(cx=700.0), False))["principal point"]
    assert found.status is Status.FAULT
    assert set(found.forbids) == {Use.STEREO, Use.MONO}


@pytest.mark.parametrize(
    ("baseline", "guess"),
    [
        (53.7, "0.537 m if centimetres were given or 0.054 m if millimetres were given"),
        (120.0, "1.200 m if centimetres were given or 0.120 m if millimetres were given"),
        (0.537 / 700.0, "0.537 m if P[3] is the baseline itself, not -fx times it"),
        (1e6, ""),
    ],
)
def test_the_unit_of_an_unusual_baseline_is_guessed(baseline: float, guess: str) -> None:
    text = by_topic(check_camera(camera(fx=700.0, baseline=baseline), True))["baseline"].text
    assert (f"It is {guess}: correct the calibration" in text) == bool(guess)
    assert "is it in metres?" in text


@pytest.mark.parametrize(("baseline", "status"), [(0.02, Status.WARNING), (0.54, Status.OK), (300.0, Status.WARNING)])
def test_the_baseline_counts_for_pairs_alone(baseline: float, status: Status) -> None:
    assert by_topic(check_camera(camera(baseline=baseline), True))["baseline"].status is status
    assert "baseline" not in by_topic(check_camera(camera(baseline=baseline), False))


@settings(max_examples=30, deadline=None)
@given(rate=st.floats(1.0, 60.0), count=st.integers(3, 200))
def test_an_even_rate_is_measured_and_has_no_pauses(rate: float, count: int) -> None:
    found = by_topic(check_timestamps(100.0 + np.arange(count) / rate))
    assert found["rate"].figures["rate_hz"] == pytest.approx(rate, rel=1e-6)
    assert found["rate"].figures["seconds"] == pytest.approx((count - 1) / rate)
    assert found["pauses"].figures["pauses"] == 0
    assert found["rate"].status is (Status.WARNING if rate < 4.0 * (1 - 1e-9) else found["rate"].status)


@settings(max_examples=30, deadline=None)
@given(at=st.integers(0, 47), pause=st.floats(0.5, 50.0))
def test_the_longest_pause_is_named_with_its_place(at: int, pause: float) -> None:
    times = np.arange(50) / 10
    times[at + 1 :] += pause
    found = by_topic(check_timestamps(times))["pauses"]
    assert (found.status, found.figures["pauses"]) == (Status.WARNING, 1)
    assert found.figures["longest_s"] == pytest.approx(pause + 0.1)
    assert found.figures["after_s"] == pytest.approx(at / 10)


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_image_has_no_rate(count: int) -> None:
    assert check_timestamps(np.arange(count, dtype=float)) == []


def test_images_are_measured_for_what_they_are() -> None:
    rng = np.random.default_rng(0)
    good = rng.integers(40, 220, (40, 60), dtype=np.uint8)
    assert measure_image(good, None) == ImageStatistics((40, 60), False, False, False, False)
    assert measure_image(good, good.copy()).is_repeated
    assert not measure_image(good, good[:, ::-1]).is_repeated
    assert measure_image(good // 12, None).is_dark
    assert measure_image(np.full((40, 60), 255, np.uint8), None).is_overexposed
    assert measure_image(np.full((40, 60), 127, np.uint8), None).is_blank


def test_the_share_of_bad_images_decides() -> None:
    fine = ImageStatistics((40, 60), False, False, False, False)
    dark = ImageStatistics((40, 60), True, False, False, False)
    for count, status in ((1, Status.OK), (3, Status.WARNING), (40, Status.FAULT)):
        images = [dark] * count + [fine] * (40 - count)
        light = [finding for finding in check_images(images, images) if "dark" in finding.text]
        assert [finding.status for finding in light] == [status]
        assert light[0].figures["share"] == pytest.approx(count / 40)


def test_images_of_two_sizes_are_named() -> None:
    images = [ImageStatistics(shape, False, False, False, False) for shape in ((40, 60), (48, 64))]
    sizes = by_topic(check_images(images, []))["sizes"]
    assert (sizes.status, sizes.figures["sizes"]) == (Status.WARNING, "60 x 40, 64 x 48")


@pytest.mark.parametrize("shift", [(6, 0), (6, 3), (-9, 0)])
def test_displacements_are_those_of_the_images(shift: tuple[int, int]) -> None:
    """A wall that appears shifted in the right image."""
    left, _ = Walls().pair(IDEAL, np.eye(4))
    right = np.roll(left, (-shift[1], -shift[0]), axis=(0, 1))
    moved = match_displacements(left, right)
    assert len(moved) > 100
    np.testing.assert_allclose(np.median(moved, axis=0), shift, atol=0.1)


def test_blank_images_have_no_matches_and_that_is_a_warning() -> None:
    blank = np.full((240, 320), 127, np.uint8)
    assert match_displacements(blank, blank).shape == (0, 2)
    found = check_rectification([(blank, blank)])
    assert (found.status, found.figures["matches"]) == (Status.WARNING, 0)


@pytest.mark.parametrize("quality", [None, 60])
def test_a_right_image_that_is_a_copy_of_the_left_one_rules_out_stereo(quality: int | None) -> None:
    left, right = Walls().pair(IDEAL, np.eye(4))
    copy = left if quality is None else cv2.imdecode(cv2.imencode(".jpg", left, [1, quality])[1], 0)
    found = check_rectification([(left, copy)] * 2)
    assert (found.status, found.forbids) == (Status.FAULT, (Use.STEREO,))
    assert "left and right show the same image" in found.text
    assert check_rectification([(left, right)] * 2).status is Status.OK


@pytest.mark.parametrize(
    ("gain", "offset", "status"),
    [(1.0, 0, Status.OK), (0.93, 5, Status.OK), (0.6, 0, Status.WARNING), (1.0, 25, Status.WARNING)],
)
def test_a_pair_of_two_exposures_is_a_warning(gain: float, offset: float, status: Status) -> None:
    left, right = Walls().pair(IDEAL, np.eye(4))
    found = check_pair_brightness([(left, cv2.convertScaleAbs(right, alpha=gain, beta=offset))])
    assert found.status is status
    assert found.figures["contrast_ratio"] == pytest.approx(gain, abs=0.1)


def test_the_same_images_give_the_same_finding() -> None:
    pairs = [Walls().pair(RIGS["ideal"], np.eye(4))]
    assert check_rectification(pairs) == check_rectification(pairs)


def test_a_use_is_possible_unless_a_fault_forbids_it() -> None:
    findings = (report_ok("a", "fine"), report_warning("b", "poor"), report_fault("c", "no", (Use.MONO,)))
    inspection = Inspection("x", "kitti", findings)
    assert inspection.possible_uses == (Use.STEREO, Use.PLACES)
    assert inspection.reasons_against(Use.MONO) == ["no"]
    assert inspection.reasons_against(Use.STEREO) == []


def test_a_large_share_that_never_changes_is_a_warning() -> None:
    assert check_static_area(0.001).status is Status.OK
    finding = check_static_area(0.25)
    assert finding.status is Status.WARNING
    assert "25.0% of the image area" in finding.text
    assert "--mask" in finding.text
