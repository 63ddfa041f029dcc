"""The whole pipeline, frame by frame: odometry drifts, places are recognised and verified, the graph is corrected.

    python examples/4_close_loops.py [--out runs/examples]

Leaves 4_close_loops.png: trajectory and map by odometry alone, and after the loops were closed (Figure 4.1 of the
chapter). `revisit run` does the same with a report, a recording and all files.
"""

import numpy as np
from street import arguments, street

from slam.components import build_components
from slam.config import RunConfig
from slam.datasets.formats.registry import open_dataset
from slam.evaluation.trajectory_errors import absolute_trajectory_error
from slam.report import style
from slam.report.style import new_figure, save_png, style_axes
from slam.system import Slam

given = arguments(__doc__).parse_args()
drive = open_dataset(street(given))

config = RunConfig()
slam = Slam(build_components(drive.camera, config))
poses, candidates = [], []
for frame in drive:
    now = slam.process(frame)
    poses.append(now.T_world_camera_odometry)
    candidates += now.candidates
late, optimized = slam.finish(config.robust)
closed = [candidate.belief for candidate in (*candidates, *late) if candidate.closed]

before, after, truth = np.array(poses), optimized.poses, drive.ground_truth
panels = (
    ("odometry alone", before, style.ODOMETRY),
    (f"{optimized.kept.sum()} loops", after, style.CORRECTED),
)

figure = new_figure(10.0, 5.2)
axes = figure.subplots(1, 2, sharex=True, sharey=True)
for ax, (name, estimate, colour) in zip(axes, panels, strict=True):
    ate = absolute_trajectory_error(estimate, truth)
    print(f"{name}: ATE {ate:.2f} m after SE(3) alignment")
    cloud = slam.components.landmarks.cloud(estimate)  # points are kept in the frame of their camera: they move with it
    style_axes(ax)
    ax.plot(cloud.points[::5, 0], cloud.points[::5, 2], ".", color="black", ms=0.8, alpha=0.3, rasterized=True)
    ax.plot(truth[:, 0, 3], truth[:, 2, 3], color=style.GROUND_TRUTH, ls="--", label="ground truth")
    ax.plot(estimate[:, 0, 3], estimate[:, 2, 3], color=colour, label=name)
    for belief in closed:
        ax.plot(*estimate[[belief.query, belief.match]][:, [0, 2], 3].T, color=style.ACCEPTED, lw=0.6)
    ax.set(title=f"{name}: ATE {ate:.2f} m, SE(3) alignment", xlabel="x [m]", aspect="equal")
    ax.legend(frameon=False, loc="upper right")
x, z = truth[:, 0, 3], truth[:, 2, 3]
axes[0].set(ylabel="z [m]", xlim=(x.min() - 25, x.max() + 25), ylim=(z.min() - 25, z.max() + 25))
save_png(figure, given.out / "4_close_loops.png")
