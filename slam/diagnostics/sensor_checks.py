"""Checks of what the camera delivers: its calibration, its images (light, contrast, copies) and their timestamps."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.klt_tracking import brightness_difference, is_level
from place_recognition.image_processing.matching import mutual_matches
from slam.datasets.formats.recording import MIN_SIDE_PX
from slam.diagnostics.findings import ALL_USES, SLAM_USES, Finding, Use, report_fault, report_ok, report_warning

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Calibration.
_USUAL_VIEW_DEG, _POSSIBLE_VIEW_DEG = (35.0, 120.0), (5.0, 170.0)  # horizontal field of view
# Distance of the principal point from the image centre, in shares of width and height: usual, and inside the image.
_MAX_USUAL_OFFSET, _MAX_POSSIBLE_OFFSET = 0.12, 0.5
_MAX_ASPECT_DIFFERENCE = 0.05  # of fx / fy from 1
_USUAL_BASELINE_M = (0.03, 2.0)
_UNITS_M = {"centimetres": 0.01, "millimetres": 0.001}  # that calibrations are made in
_FEATURES, _MAX_RATIO, _MAX_EPIPOLAR_PX = 1000, 0.8, 2.0  # SIFT features, Lowe's ratio, distance of an inlier
_MIN_IMAGE_MATCHES = 8  # that determine a fundamental matrix
_MIN_MATCHES = 50  # in all pairs together, for a median
# Median distance from the common row. Odometry accepts matches up to 3 px from their row.
_MAX_GOOD_ROWS_PX, _MAX_POSSIBLE_ROWS_PX = 0.7, 2.0
_MIN_DISPARITY_PX = -1.0  # of a match on the right side; points at infinity scatter about 0
_MIN_SPREAD_PX = 0.3  # of the largest disparities: noise alone, as between copies of one image
_MIN_POSITIVE_SHARE = 0.8  # of matches with a disparity of the right sign
_MAX_SWAPPED_SHARE = 0.2  # of them, in a pair that is swapped
_MAX_FROZEN_SHARE = 0.2  # of right images that equal the one before, although the left ones do not
# Images.
_MAX_DARK, _MIN_BRIGHT = 30, 250  # grey values
_MAX_BRIGHT_SHARE = 0.25  # of the pixels; with more, an image is over-exposed
_MIN_DEVIATION = 4.0  # grey values, standard deviation of an image that is not blank
_MAX_STATIC_RATIO = 0.005  # of the image area, that is no bonnet or text
_HARMLESS_SHARE = 0.05  # of the images
# Timestamps.
_PAUSE_RATIO = 3.0  # a pause is a step longer than this many median steps
_MIN_RATE_HZ = 4.0  # at less, successive images from a car have too little in common


@dataclass(frozen=True)
class ImageStatistics:
    """Properties of one image.

    Attributes:
        shape: (height, width).
        is_dark: whether nine tenths of the pixels are nearly black.
        is_overexposed: whether a quarter of the pixels is white.
        is_blank: whether the image has no contrast.
        is_repeated: whether it equals the image before.
    """

    shape: tuple[int, int]
    is_dark: bool
    is_overexposed: bool
    is_blank: bool
    is_repeated: bool


def check_camera(camera: StereoCamera, is_pair: bool) -> list[Finding]:
    """Check the intrinsics, and the baseline of a pair."""
    findings = [_check_field_of_view(camera), _check_principal_point(camera), _check_pixels(camera)]
    return [*findings, _check_baseline(camera)] if is_pair else findings


def _check_field_of_view(camera: StereoCamera) -> Finding:
    degrees = float(2 * np.degrees(np.arctan(camera.width / (2 * camera.fx))))
    text = f"{degrees:.0f} degrees across (fx = {camera.fx:.1f} for {camera.width} pixels)"
    if not _POSSIBLE_VIEW_DEG[0] < degrees < _POSSIBLE_VIEW_DEG[1]:
        return report_fault("field of view", f"{text}: impossible; correct fx", SLAM_USES, degrees=degrees)
    if not _USUAL_VIEW_DEG[0] < degrees < _USUAL_VIEW_DEG[1]:
        return report_warning("field of view", f"{text}: unusual; is fx of images of this size?", degrees=degrees)
    return report_ok("field of view", text, degrees=degrees)


def _check_principal_point(camera: StereoCamera) -> Finding:
    off = [(camera.cx + 0.5) / camera.width - 0.5, (camera.cy + 0.5) / camera.height - 0.5]
    worst = float(np.abs(off).max())
    text = f"principal point {off[0]:+.0%} of the width and {off[1]:+.0%} of the height off the middle"
    if worst > _MAX_POSSIBLE_OFFSET:
        return report_fault("principal point", f"{text}, outside of the image; correct cx, cy", SLAM_USES, off=off)
    if worst > _MAX_USUAL_OFFSET:
        return report_warning("principal point", f"{text}; are cx, cy of images of this size?", off=off)
    return report_ok("principal point", text, off=off)


def _check_pixels(camera: StereoCamera) -> Finding:
    ratio = camera.fx / camera.fy
    text = f"fx / fy = {ratio:.3f}"
    if abs(ratio - 1.0) > _MAX_ASPECT_DIFFERENCE:
        return report_warning("pixels", f"{text}: they are not square; were the images stretched?", ratio=ratio)
    return report_ok("pixels", text, ratio=ratio)


def _check_baseline(camera: StereoCamera) -> Finding:
    low, high = _USUAL_BASELINE_M
    text = f"baseline {camera.baseline:.3f} m"
    if not low <= camera.baseline <= high:
        return report_warning(
            "baseline", f"{text}: unusual; is it in metres?{_guess_unit(camera)}", metres=camera.baseline
        )
    return report_ok("baseline", text, metres=camera.baseline)


def _guess_unit(camera: StereoCamera) -> str:
    """What an unusual baseline would be if it were given in another unit, and the remedy; empty if unusual too.

    A projection matrix holds -fx times the baseline; some hold the baseline itself in that place.
    """
    low, high = _USUAL_BASELINE_M
    readings = {f"{unit} were given": camera.baseline * metres for unit, metres in _UNITS_M.items()}
    if camera.baseline < low:
        readings = {"P[3] is the baseline itself, not -fx times it": camera.baseline * camera.fx}
    usual = [f"{metres:.3f} m if {case}" for case, metres in readings.items() if low <= metres <= high]
    return f" It is {' or '.join(usual)}: correct the calibration" if usual else ""


def check_rectification(pairs: Sequence[tuple[Image, Image]]) -> Finding:
    """Check in pairs of images that the same points are in the same rows, and farther left in the right image."""
    displacements = [match_displacements(left, right) for left, right in pairs]
    moved = np.concatenate(displacements) if displacements else np.empty((0, 2))
    if len(moved) < _MIN_MATCHES:
        return report_warning(
            "rows", f"{len(moved)} matches between left and right: too few to measure the rows", matches=len(moved)
        )
    disparity, row = moved.T
    off, bias = float(np.median(np.abs(row))), float(np.median(row))
    ahead = float((disparity > _MIN_DISPARITY_PX).mean())
    figures = {"median_px": off, "bias_px": bias, "share_ahead": ahead, "matches": len(moved)}
    text = f"matches between left and right are {off:.2f} px off the common row (median of {len(moved)})"
    if ahead < _MIN_POSITIVE_SHARE:
        remedy = (
            "swap left and right" if ahead < _MAX_SWAPPED_SHARE else "left and right are not of one moment; use --mono"
        )
        trouble = f"{1 - ahead:.0%} of the matches lie to the wrong side; {remedy}"
        return report_fault("rows", trouble, (Use.STEREO,), **figures)
    if float(np.percentile(np.abs(disparity), 95)) < _MIN_SPREAD_PX:
        trouble = "left and right show the same image: no match has a disparity; give the right camera's, or use --mono"
        return report_fault("rows", trouble, (Use.STEREO,), **figures)
    if off > _MAX_POSSIBLE_ROWS_PX:
        return report_fault("rows", f"{text}: not rectified; correct the calibration", (Use.STEREO,), **figures)
    if off > _MAX_GOOD_ROWS_PX:
        return report_warning("rows", f"{text}; a new calibration would help", **figures)
    return report_ok("rows", text, **figures)


def check_pair_brightness(pairs: Sequence[tuple[Image, Image]]) -> Finding:
    """Check in pairs of images that both cameras are equally bright."""
    if not pairs:
        return report_ok("brightness", "no pair of images to compare")
    measured = np.array([brightness_difference(left, right) for left, right in pairs])
    gain, difference = (float(value) for value in np.median(measured, axis=0))
    contrast, brighter = 1 / max(gain, 1e-3), -difference
    text = f"the right image has {contrast:.2f} of the left one's contrast and is {brighter:+.0f} grey levels brighter"
    if is_level(gain, difference):
        return report_ok("brightness", text, contrast_ratio=contrast, mean_difference=brighter)
    text += ": it is levelled; give both cameras one exposure"
    return report_warning("brightness", text, contrast_ratio=contrast, mean_difference=brighter)


def match_displacements(left: Image, right: Image) -> Array:
    """Displacements (N, 2), left minus right pixel, of matched SIFT features that agree with one epipolar geometry.

    Unlike the odometry's stereo matching, the search is not limited to rows and positive disparities, so that it also
    measures pairs that are not rectified or swapped.
    """
    (left_pixels, left_descriptors), (right_pixels, right_descriptors) = map(_detect, (left, right))
    matches = mutual_matches(left_descriptors, right_descriptors, _MAX_RATIO)
    if len(matches) < _MIN_IMAGE_MATCHES:
        return np.empty((0, 2))
    a, b = left_pixels[matches[:, 0]], right_pixels[matches[:, 1]]
    cv2.setRNGSeed(0)  # the same finding for the same images
    _, inliers = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, _MAX_EPIPOLAR_PX, 0.999)
    if inliers is None:
        return np.empty((0, 2))
    return np.asarray((a - b)[inliers.ravel() == 1], np.float64)


def _detect(image: Image) -> tuple[Array, NDArray[np.float32]]:
    """Pixels (N, 2) and descriptors (N, 128) of unit length of SIFT features."""
    key_points, descriptors = cv2.SIFT.create(_FEATURES).detectAndCompute(image, None)
    if not key_points:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    lengths = np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-12)
    return np.array([point.pt for point in key_points]), np.ascontiguousarray(descriptors / lengths, np.float32)


def measure_image(image: Image, before: Image | None) -> ImageStatistics:
    """Measure an image (H, W) uint8, and compare it with the image before it, if there is one."""
    return ImageStatistics(
        shape=(image.shape[0], image.shape[1]),
        is_dark=bool(np.percentile(image, 90) < _MAX_DARK),
        is_overexposed=bool((image >= _MIN_BRIGHT).mean() > _MAX_BRIGHT_SHARE),
        is_blank=bool(image.std() < _MIN_DEVIATION),
        is_repeated=before is not None and np.array_equal(image, before),
    )


def check_images(images: Sequence[ImageStatistics], successors: Sequence[ImageStatistics]) -> list[Finding]:
    """Check the light, the contrast, the repetitions and the sizes of images.

    Args:
        images: all measured images.
        successors: those of them whose predecessor was measured too.
    """
    return [
        _check_sizes(images),
        _check_share("light", [image.is_dark for image in images], "dark: more light or a longer exposure would help"),
        _check_share(
            "light", [image.is_overexposed for image in images], "over-exposed: a shorter exposure would help"
        ),
        _check_share(
            "blanks", [image.is_blank for image in images], "blank: was the lens covered, or the camera not ready?"
        ),
        _check_share(
            "repetitions", [image.is_repeated for image in successors], "the same as the one before: remove the copies"
        ),
    ]


def check_right_repetitions(flags: Sequence[bool]) -> Finding:
    """Check whether the right camera stood still while the left one went on.

    Args:
        flags: for each right image with a predecessor whether it equals that one, and the left image does not.
    """
    share = float(np.mean(flags)) if flags else 0.0
    text = f"{share:.0%} of the right images are the same as the one before, although the left ones are not"
    if share > _MAX_FROZEN_SHARE:
        return report_fault("right camera", f"{text}: it has stopped; use --mono", (Use.STEREO,), share=share)
    if share > 0:
        return report_warning("right camera", f"{text}: it stops at times", share=share)
    return report_ok("right camera", text, share=share)


def check_static_area(ratio: float) -> Finding:
    """Report the share of the image area that never changes while the camera moves."""
    text = f"{ratio:.1%} of the image area never changes while the camera moves"
    if ratio > _MAX_STATIC_RATIO:
        advice = "found and left out while driving; a bonnet or a text that is known is left out at once with --mask"
        return report_warning("static parts", f"{text}: {advice}", ratio=ratio)
    return report_ok("static parts", text, ratio=ratio)


def _check_sizes(images: Sequence[ImageStatistics]) -> Finding:
    shapes = sorted({image.shape for image in images})
    text = ", ".join(f"{width} x {height}" for height, width in shapes)
    if shapes and min(map(min, shapes)) < MIN_SIDE_PX:
        trouble = f"images of {text} pixels: too small; give images of at least {MIN_SIDE_PX} x {MIN_SIDE_PX}"
        return report_fault("sizes", trouble, ALL_USES, sizes=text)
    if len(shapes) > 1:
        return report_warning(
            "sizes", f"images of several sizes, {text}; only places can be recognised in them", sizes=text
        )
    return report_ok("sizes", f"{text} pixels, in all {len(images)} images looked at", sizes=text)


def _check_share(topic: str, flags: Sequence[bool], trouble: str) -> Finding:
    share = float(np.mean(flags)) if flags else 0.0
    word = trouble.split(":", maxsplit=1)[0]
    if share > 1.0 - _HARMLESS_SHARE:
        return report_fault(topic, f"{share:.0%} of the images are {trouble}", ALL_USES, share=share)
    if share > _HARMLESS_SHARE:
        return report_warning(topic, f"{share:.0%} of the images are {trouble}", share=share)
    return report_ok(topic, f"{share:.0%} of the images are {word}", share=share)


def check_timestamps(times: Array) -> list[Finding]:
    """Check the rate and the pauses of times (N,), seconds, increasing."""
    if len(times) < 2:
        return []
    steps = np.diff(times)
    median_s = float(np.median(steps))
    return [_check_rate(times, median_s), _check_pauses(steps, median_s, times)]


def _check_rate(times: Array, median_s: float) -> Finding:
    seconds = float(times[-1] - times[0])
    text = f"{1 / median_s:.1f} images a second, {seconds:.1f} s in all"
    figures = {"rate_hz": 1 / median_s, "seconds": seconds}
    if 1 / median_s < _MIN_RATE_HZ:
        return report_warning("rate", f"{text}: slow; successive images must still show the same things", **figures)
    return report_ok("rate", text, **figures)


def _check_pauses(steps: Array, median_s: float, times: Array) -> Finding:
    pauses = np.flatnonzero(steps > _PAUSE_RATIO * median_s)
    if not len(pauses):
        return report_ok("pauses", f"none: no step above {steps.max():.3f} s", pauses=0, longest_s=float(steps.max()))
    worst = int(pauses[np.argmax(steps[pauses])])
    return report_warning(
        "pauses",
        f"{len(pauses)}, the longest of {steps[worst]:.2f} s after image {worst}; motion is extrapolated across them",
        pauses=len(pauses),
        longest_s=float(steps[worst]),
        after_s=float(times[worst] - times[0]),
    )
