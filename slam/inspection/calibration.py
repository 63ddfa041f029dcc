"""Can these numbers be a camera's? And do they hold in the images, where a pair's rows must be common?"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.inspection.finding import DRIVING, Finding, Use, bad, doubtful, good

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_USUAL_VIEW, _POSSIBLE_VIEW = (35.0, 120.0), (5.0, 170.0)  # degrees across
_CENTRED, _INSIDE = 0.12, 0.5  # of width and height, principal point off the middle
_SQUARE = 0.05  # by how much fx and fy may differ
_USUAL_BASELINE = (0.03, 2.0)  # m
_FEATURES, _RATIO, _INLIER_PX = 1000, 0.8, 2.0
_ENOUGH = 50  # matches, in all pairs together
_GOOD_ROWS_PX, _POSSIBLE_ROWS_PX = 0.7, 2.0  # off the common row, median; the odometry lets matches be so far off
_AHEAD = 0.8  # share of matches that must have a disparity of the right sign


def judge_camera(camera: StereoCamera, is_pair: bool) -> list[Finding]:
    """Judge the intrinsics, and the baseline where there is one."""
    findings = [_view(camera), _centre(camera), _pixels(camera)]
    return [*findings, _baseline(camera)] if is_pair else findings


def _view(camera: StereoCamera) -> Finding:
    degrees = float(2 * np.degrees(np.arctan(camera.width / (2 * camera.fx))))
    text = f"{degrees:.0f} degrees across (fx = {camera.fx:.1f} for {camera.width} pixels)"
    if not _POSSIBLE_VIEW[0] < degrees < _POSSIBLE_VIEW[1]:
        return bad("field of view", f"{text}: no camera is like that; mend fx", DRIVING, degrees=degrees)
    if not _USUAL_VIEW[0] < degrees < _USUAL_VIEW[1]:
        return doubtful("field of view", f"{text}: unusual; is fx of images of this size?", degrees=degrees)
    return good("field of view", text, degrees=degrees)


def _centre(camera: StereoCamera) -> Finding:
    off = [(camera.cx + 0.5) / camera.width - 0.5, (camera.cy + 0.5) / camera.height - 0.5]
    worst = float(np.abs(off).max())
    text = f"principal point {off[0]:+.0%} of the width and {off[1]:+.0%} of the height off the middle"
    if worst > _INSIDE:
        return bad("principal point", f"{text}, outside of the image; mend cx, cy", DRIVING, off=off)
    if worst > _CENTRED:
        return doubtful("principal point", f"{text}; are cx, cy of images of this size?", off=off)
    return good("principal point", text, off=off)


def _pixels(camera: StereoCamera) -> Finding:
    ratio = camera.fx / camera.fy
    text = f"fx / fy = {ratio:.3f}"
    if abs(ratio - 1.0) > _SQUARE:
        return doubtful("pixels", f"{text}: they are not square; were the images stretched?", ratio=ratio)
    return good("pixels", text, ratio=ratio)


def _baseline(camera: StereoCamera) -> Finding:
    low, high = _USUAL_BASELINE
    text = f"baseline {camera.baseline:.3f} m"
    if not low <= camera.baseline <= high:
        return doubtful("baseline", f"{text}: unusual; is it in metres?", metres=camera.baseline)
    return good("baseline", text, metres=camera.baseline)


def judge_rows(pairs: Sequence[tuple[Image, Image]]) -> Finding:
    """Measure in pairs of images whether left and right show the same things in the same rows."""
    steps = [match_rows(left, right) for left, right in pairs]
    moved = np.concatenate(steps) if steps else np.empty((0, 2))
    if len(moved) < _ENOUGH:
        return doubtful(
            "rows", f"{len(moved)} matches between left and right: too few to measure the rows", matches=len(moved)
        )
    disparity, row = moved.T
    off, bias, ahead = float(np.median(np.abs(row))), float(np.median(row)), float((disparity > -1.0).mean())
    figures = {"median_px": off, "bias_px": bias, "share_ahead": ahead, "matches": len(moved)}
    text = f"matches between left and right are {off:.2f} px off the common row (median of {len(moved)})"
    if ahead < _AHEAD:
        trouble = f"{1 - ahead:.0%} of the matches lie to the wrong side; swap left and right"
        return bad("rows", trouble, (Use.STEREO,), **figures)
    if off > _POSSIBLE_ROWS_PX:
        return bad("rows", f"{text}: not rectified; calibrate again, or mend it", (Use.STEREO,), **figures)
    if off > _GOOD_ROWS_PX:
        return doubtful("rows", f"{text}; a new calibration would help", **figures)
    return good("rows", text, **figures)


def match_rows(left: Image, right: Image) -> Array:
    """Disparity and shift across rows (N, 2), pixels, of what is found in both images of a pair, wherever it is."""
    sift = cv2.SIFT.create(_FEATURES)
    (points, described), (others, other_described) = (sift.detectAndCompute(image, None) for image in (left, right))
    if len(points) < 8 or len(others) < 8:
        return np.empty((0, 2))
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    there, back = matcher.knnMatch(described, other_described, 2), matcher.match(other_described, described)
    partner = {match.queryIdx: match.trainIdx for match in back}
    mutual = [
        (match.queryIdx, match.trainIdx)
        for match, second in there
        if match.distance < _RATIO * second.distance and partner.get(match.trainIdx) == match.queryIdx
    ]
    if len(mutual) < 8:
        return np.empty((0, 2))
    a, b = (
        np.array([p[i].pt for i in ids]) for p, ids in zip((points, others), zip(*mutual, strict=True), strict=True)
    )
    cv2.setRNGSeed(0)
    _, inliers = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, _INLIER_PX, 0.999)
    if inliers is None:
        return np.empty((0, 2))
    moved = (a - b)[inliers.ravel() == 1]
    return np.asarray(moved, np.float64)
