"""Drift and time of each stage of the monocular odometry on drives in KITTI's layout, with the left images alone.

    revisit simulate blocks --difficulty standard --laps 1 --length 1500 --seed 31 --out blocks31    (and other seeds)
    python benchmarks/mono_odometry.py blocks31 00
    python benchmarks/mono_odometry.py CLIPS 05 06 01 07

ATE and end error are those after Sim(3) alignment of all poses, in per cent of the path length. "unit" is the length of
a metre in the odometry's unit in each eighth of the drive: its change is the drift of the scale. Images are decoded
before the clock starts; "cpu" is the processor time of all threads, which depends less on other work of the machine
than wall-clock time.
"""

import numpy as np
from command_line import run_script
from odometry_drives import Array, Drive, StageTimes, chain_poses, measure, path_length_m

from odometry import MonoOdometry, Motion
from odometry.mono import mono_frontend, mono_tracking
from odometry.mono.mono_bundle_adjustment import MonoBundle
from slam.evaluation.trajectory_errors import trajectory_errors

STAGES = (
    (mono_frontend, "detect_corners", "detection"),
    (mono_frontend, "track_points", "following"),
    (mono_tracking, "estimate_pose", "motion"),
    (MonoBundle, "add", "bundle"),
)
_PARTS = 8


def track(drive: Drive, times: StageTimes) -> list[Motion]:
    """Run the odometry on a drive and record its times."""
    odometry, motions = MonoOdometry(drive.camera()), []
    for image in drive.lefts():
        motions.append(times.frame(odometry.track, image))
    return motions


def unit(poses: Array, truth: Array) -> str:
    """Return the length of a metre, in the unit of the odometry, in each part of the drive."""
    lengths = [np.linalg.norm(np.diff(each[:, :3, 3], axis=0), axis=1) for each in (poses, truth)]
    parts = np.array_split(np.arange(len(lengths[0])), _PARTS)
    return " ".join(f"{lengths[0][part].sum() / lengths[1][part].sum():.3f}" for part in parts)


def report(drive: Drive, times: StageTimes) -> None:
    """Measure one sequence and print its rows."""
    times.clear()
    motions, truth = track(drive, times), drive.truth()
    poses, measured = chain_poses(motions), [m for m in motions[2:] if not m.predicted]
    errors = trajectory_errors(poses, truth, "sim3")
    print(f"\n{drive.root.name} {drive.name}: {len(drive)} frames, {path_length_m(truth):.0f} m")
    print(
        f"    ATE {errors.ate_m:.2f} m, {100 * (errors.ate_m or 0.0) / path_length_m(truth):.2f} %"
        f"  end {errors.end_error_percent:.2f} %  t_rel {errors.t_rel_percent or np.nan:.2f} %"
        f"  r_rel {errors.r_rel_deg_per_100m or np.nan:.3f} deg/100 m\n    unit {unit(poses, truth)}"
    )
    print(
        f"    predicted {sum(m.predicted for m in motions)}  tracks {np.mean([len(m.inliers) for m in measured]):.0f}"
        f"  inliers {100 * np.mean([m.inliers.mean() for m in measured]):.0f} %"
        f"  residual {np.nanmedian([m.residual_px for m in measured]):.3f} px"
    )
    times.print()


if __name__ == "__main__":
    run_script(lambda: measure(__doc__, STAGES, track, report))
