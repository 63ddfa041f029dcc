"""How did the camera move? Stereo odometry alone, against the ground truth.

    python examples/2_odometry.py [--out runs/examples]

Leaves 2_odometry.png: the trajectory, and how its error grows. Odometry adds small errors without end; the other
examples take them away again.
"""

import numpy as np
from street import arguments, street

from odometry.stereo.stereo_odometry import StereoOdometry
from slam.datasets.formats.registry import open_dataset
from slam.evaluation.trajectory_errors import absolute_trajectory_error, distances_along, end_error
from slam.report import style
from slam.report.style import new_figure, save_png, style_axes

given = arguments(__doc__).parse_args()
drive = open_dataset(street(given))

odometry = StereoOdometry(drive.camera)
poses = []  # T_world_camera; the world is the first camera
for frame in drive:
    motion = odometry.track(frame.left, frame.right, frame.timestamp)
    poses.append(poses[-1] @ motion.T_previous_current if poses else np.eye(4))
estimate, truth = np.array(poses), drive.ground_truth

ate, end = absolute_trajectory_error(estimate, truth), end_error(estimate, truth)
distance_m = distances_along(truth)
share = end / distance_m[-1]
print(f"after {distance_m[-1]:.0f} m: ATE {ate:.2f} m after SE(3) alignment, end error {end:.2f} m ({share:.2%})")

figure = new_figure(9.0, 4.2)
plan, error = figure.subplots(1, 2)
plan.plot(truth[:, 0, 3], truth[:, 2, 3], color=style.GROUND_TRUTH, ls="--", label="ground truth")
plan.plot(estimate[:, 0, 3], estimate[:, 2, 3], color=style.ODOMETRY, label="odometry")
plan.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title=f"ATE {ate:.2f} m, SE(3) alignment")
plan.legend(frameon=False)
error.plot(distance_m, np.linalg.norm(estimate[:, :3, 3] - truth[:, :3, 3], axis=1), color=style.ODOMETRY)
error.set(xlabel="distance travelled [m]", ylabel="position error, starts made equal [m]", title="the error grows")
for ax in (plan, error):
    style_axes(ax)
save_png(figure, given.out / "2_odometry.png")
