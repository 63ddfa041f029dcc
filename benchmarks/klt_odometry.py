"""A stereo odometry of a page, the control of `peers.py`: corners, KLT tracking and PnP, with OpenCV alone.

    python benchmarks/klt_odometry.py LEFT RIGHT CALIB TIMES OUT

The arguments are those of every program that `peers.py` runs; it describes them. Each motion is estimated from one
image pair to the next left image, without key frames, map or loops: what a better odometry adds is to be seen against
this one.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from peer_contract import StereoDrive, make_parser, take_drive

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_CORNERS, CORNER_QUALITY, MIN_CORNER_DISTANCE_PX = 1000, 0.01, 12
WINDOW_PX, PYRAMID_LEVELS = (21, 21), 4
MAX_RETURN_ERROR_PX = 0.5  # of a point that is tracked there and back
MAX_EPIPOLAR_ERROR_PX, MIN_DISPARITY_PX = 1.0, 1.0
MAX_REPROJECTION_ERROR_PX, MIN_INLIERS = 1.0, 10


def track(image: Image, other: Image, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Track points (N, 2), pixels, into another image; returns them and which came back to where they were."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(image, other, points, None, winSize=WINDOW_PX, maxLevel=PYRAMID_LEVELS)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(other, image, there, None, winSize=WINDOW_PX, maxLevel=PYRAMID_LEVELS)
    near = np.linalg.norm(back - points, axis=1) < MAX_RETURN_ERROR_PX
    return there, near & found.ravel().astype(bool) & returned.ravel().astype(bool)


def triangulate(left: Image, right: Image, K: Array, disparity_at_1m_px: float) -> tuple[Array, Array]:
    """Find corners of a pair: pixels (N, 2) in the left image and points (N, 3) in the left camera, metres."""
    corners = cv2.goodFeaturesToTrack(left, MAX_CORNERS, CORNER_QUALITY, MIN_CORNER_DISTANCE_PX)
    if corners is None:
        return np.empty((0, 2), np.float32), np.empty((0, 3))
    pixels = corners.reshape(-1, 2)
    partners, tracked = track(left, right, pixels)
    disparity = pixels[:, 0] - partners[:, 0]
    level = np.abs(pixels[:, 1] - partners[:, 1]) < MAX_EPIPOLAR_ERROR_PX
    good = tracked & level & (disparity > MIN_DISPARITY_PX)
    pixels, depths = pixels[good], disparity_at_1m_px / disparity[good]
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
    return pixels, rays * depths[:, None]


def solve_motion(points: Array, pixels: Array, K: Array) -> Array | None:
    """Find T_previous_current (4, 4) from points (N, 3) of the previous camera seen at pixels (N, 2) by the current."""
    if len(points) < MIN_INLIERS:
        return None
    solved, rotation, translation, inliers = cv2.solvePnPRansac(
        points, pixels, K, None, reprojectionError=MAX_REPROJECTION_ERROR_PX, iterationsCount=500
    )
    if not solved or inliers is None or len(inliers) < MIN_INLIERS:
        return None
    rows = inliers.ravel()
    rotation, translation = cv2.solvePnPRefineLM(points[rows], pixels[rows], K, None, rotation, translation)
    T_current_previous = np.eye(4)
    T_current_previous[:3, :3], T_current_previous[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    return np.asarray(np.linalg.inv(T_current_previous))


def estimate(drive: StereoDrive) -> list[Array]:
    """Estimate T_first_camera (4, 4), metres, of each pair; a motion that is not found is repeated."""
    P_left, P_right = drive.read_projections()
    K, disparity_at_1m_px = P_left[:, :3], P_left[0, 3] - P_right[0, 3]
    poses, motion, previous = [np.eye(4)], np.eye(4), None
    for left, right in drive.read_pairs():
        if previous is not None:
            found = _find_motion(previous, left, K)
            motion = motion if found is None else found
            poses.append(poses[-1] @ motion)
        previous = (left, *triangulate(left, right, K, disparity_at_1m_px))
    return poses


def _find_motion(previous: tuple[Image, Array, Array], left: Image, K: Array) -> Array | None:
    image, pixels, points = previous
    if len(pixels) < MIN_INLIERS:
        return None
    tracked, good = track(image, left, pixels)
    return solve_motion(points[good], tracked[good].astype(np.float64), K)


if __name__ == "__main__":
    cv2.setRNGSeed(0)
    given_drive = take_drive(make_parser(__doc__).parse_args())
    given_drive.write_poses("odometry.txt", estimate(given_drive))
