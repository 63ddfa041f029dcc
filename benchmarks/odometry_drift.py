"""Drift of the stereo odometry on drives in KITTI's layout, and the time of each of its stages.

    python benchmarks/odometry_drift.py ROOT 05 06 01 [--threads 2]

ROOT holds `sequences/NN/{image_0,image_1,calib.txt}` and `poses/NN.txt`. Images are decoded before the clock starts.
Drift is the error of the last position in per cent of the path length, without alignment. "cpu" is the processor time
of all threads, which depends less on other work of the machine than wall-clock time. NEES is the normalised error
squared for each degree of freedom, of motions over some images, against the covariance that the pose graph gives them
(odometry's own and the drift model): 1 if it is consistent, less if it is too large, more if it is too small. Other
programs on the same drives: peers.py.
"""

import numpy as np
from command_line import run_script
from odometry_drives import Drive, StageTimes, chain_poses, end_error, measure, path_length_m

from odometry import Motion, StereoOdometry, se3
from odometry.stereo import second_view, stereo_frontend, stereo_tracking
from odometry.stereo.sliding_window import SlidingWindow
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel

STAGES = (
    (stereo_frontend, "detect_corners", "detection"),
    (second_view, "match_right", "left to right, new"),
    (stereo_frontend, "track_points", "following"),
    (second_view, "refine_right", "left to right, old"),
    (stereo_tracking, "estimate_motion", "motion"),
    (SlidingWindow, "refine", "window"),
    (stereo_tracking, "ransac_motion", "ransac"),
    (stereo_tracking, "match_descriptors", "descriptors"),
)
STRETCHES = (1, 10, 20, 50, 100, 200)  # images


def track(drive: Drive, times: StageTimes) -> list[Motion]:
    """Run the odometry on a drive and record its times."""
    odometry, motions = StereoOdometry(drive.camera()), []
    for left, right in drive.pairs():
        motions.append(times.frame(odometry.track, left, right))
    return motions


def nees(motions: list[Motion], truth: np.ndarray, stretch: int) -> float:
    """Return the mean NEES of a degree of freedom over stretches of images; NaN if the drive is shorter than one."""
    chain = OdometryChain(OdometryDriftModel())
    for motion in motions[1:]:
        chain.append(motion.T_previous_current, motion.covariance)
    values = []
    for first in range(0, len(truth) - stretch, max(stretch // 4, 1)):
        estimate = chain.between(first, first + stretch)
        error = se3.log(se3.inverse(estimate.T_first_second) @ se3.inverse(truth[first]) @ truth[first + stretch])
        values.append(error @ np.linalg.solve(estimate.covariance, error) / len(error))
    return float(np.mean(values)) if values else float("nan")


def report(drive: Drive, times: StageTimes) -> None:
    """Measure one sequence and print its rows."""
    times.clear()
    motions, truth = track(drive, times), drive.truth()
    poses, measured = chain_poses(motions), [m for m in motions[1:] if not m.predicted]
    turn = np.degrees(se3.angle(se3.inverse(poses[-1]) @ truth[-1]))
    length = path_length_m(truth)
    print(f"\n{drive.name}: {len(drive)} frames, {length:.0f} m  drift {end_error(poses, truth):.2f} %")
    tracks = np.mean([len(m.inliers) for m in measured])
    print(
        f"    rotation {turn:.2f} deg  predicted {len(motions) - 1 - len(measured)}  tracks {tracks:.0f}"
        f"  inliers {100 * np.mean([m.inliers.mean() for m in measured]):.0f} %"
        f"  residual {np.median([m.residual_px for m in measured]):.3f} px"
    )
    consistency = "  ".join(f"{stretch}: {nees(motions, truth, stretch):.2f}" for stretch in STRETCHES)
    print(f"    NEES over images  {consistency}")
    times.print()


if __name__ == "__main__":
    run_script(lambda: measure(__doc__, STAGES, track, report))
