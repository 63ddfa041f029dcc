"""Accuracy with and without the sliding window, and consistency of the covariances, on simulated drives.

    revisit simulate blocks --difficulty standard --laps 1 --length 1500 --seed 31 --out blocks31    (and other seeds)
    python benchmarks/odometry_window.py blocks31 blocks32 blocks33 [--frames 400]

t_rel and r_rel follow the KITTI rule. NEES is the normalised error squared of motions composed over some images, whose
covariances are composed as if the motions were independent: its mean is 6 if the covariances are consistent, less if
they are too large, more if they are too small.
"""

import argparse
from dataclasses import replace

import numpy as np
from command_line import existing, run_script
from odometry_drives import Array, Drive, end_error, run

from odometry import Motion, StereoOdometryConfig, se3
from slam.evaluation.trajectory_errors import trajectory_errors

STRETCHES = (1, 5, 20, 50, 100)  # images
_LEARNING_FRAMES = 30  # at the start, that do not count: the calibration is still being estimated


def nees(motions: list[Motion], truth: Array, stretch: int) -> float:
    """Return the mean normalised error squared of stretches of `stretch` images, which overlap by half."""
    values = []
    for start in range(_LEARNING_FRAMES, len(motions) - stretch, max(stretch // 2, 1)):
        T, covariance = np.eye(4), np.zeros((6, 6))
        for motion in motions[start + 1 : start + stretch + 1]:
            T = T @ motion.T_previous_current
            covariance = se3.compose_covariance(covariance, motion.T_previous_current, motion.covariance)
        error = se3.log(se3.inverse(T) @ se3.inverse(truth[start]) @ truth[start + stretch])
        values.append(error @ np.linalg.solve(covariance, error))
    return float(np.mean(values)) if values else float("nan")


def report(drive: Drive, frames_in_window: int) -> None:
    """Print the row of one drive and one window."""
    config = StereoOdometryConfig()
    window = replace(config.window, max_frames=frames_in_window or config.window.max_frames)
    poses, motions = run(drive, replace(config, window=window))
    truth = drive.truth()
    errors = trajectory_errors(poses, truth)
    honest = " ".join(f"{nees(motions, truth, stretch):5.1f}" for stretch in STRETCHES)
    print(
        f"{drive.root.name:<12} {'off' if frames_in_window else f'{window.max_frames} frames':<9}"
        f"{errors.t_rel_percent or np.nan:6.2f}  {errors.r_rel_deg_per_100m or np.nan:13.3f}"
        f"  {end_error(poses, truth):5.2f}  {sum(m.predicted for m in motions):9d}   {honest}",
        flush=True,
    )


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roots", nargs="+", type=existing)
    parser.add_argument("--sequence", default="00")
    parser.add_argument("--frames", type=int, default=1_000_000)
    arguments = parser.parse_args()
    lengths = " ".join(f"{stretch:5d}" for stretch in STRETCHES)
    print(f"{'drive':<12} {'window':<9}t_rel %  r_rel deg/100 m  end %  predicted   NEES over {lengths} images")
    for root in arguments.roots:
        for frames_in_window in (0, 2):  # the default; two frames are what the motion has adjusted already
            report(Drive(root, arguments.sequence, arguments.frames), frames_in_window)


if __name__ == "__main__":
    run_script(main)
