"""One false loop can ruin a map: least squares against a robust back end, on a pose graph without images.

    python examples/5_false_loops.py [--out runs/examples]

Leaves 5_false_loops.png. The graph is made here: two laps round a square with noisy odometry, true loops and false
ones. `revisit optimize GRAPH.g2o` does the same for any stored graph; `examples/false_loops.py` tries all back ends.
"""

import argparse

import numpy as np
from street import output_folder

from odometry import se3
from slam.evaluation.trajectory_errors import absolute_trajectory_error
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.pose_graph import PoseGraph
from slam.report import style
from slam.report.style import new_figure, save_png, style_axes

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=output_folder, default="runs/examples", help="folder of the results")
parser.add_argument("--false-loops", type=int, default=10, help="how many are put in")
parser.add_argument("--seed", type=int, default=0, help="of the noise and the false loops")
given = parser.parse_args()

rng, lap = np.random.default_rng(given.seed), 160
turn, straight = se3.exp(np.array([0, np.pi / 8, 0, 0, 0, 1.0])), se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))
motions = [turn if k % 40 >= 36 else straight for k in range(2 * lap)]  # 1 m for each step; four steps turn a corner
truth = [np.eye(4)]
for motion in motions:
    truth.append(truth[-1] @ motion)

step = np.diag(np.square([1e-3] * 3 + [0.01] * 3))  # covariances, rotation first: rad^2, m^2
loop = np.diag(np.square([2e-3] * 3 + [0.03] * 3))
drift = np.array([0, 6e-4, 0, 0, 0, 0])  # a false turn that odometry measures in every step


def noise(covariance):
    """Draw a small motion of this covariance."""
    return se3.exp(rng.multivariate_normal(np.zeros(6), covariance))


graph = PoseGraph()
for motion in motions:
    graph.add_odometry(motion @ se3.exp(drift) @ noise(step), step)
for query in range(lap + 4, 2 * lap, 8):  # the same place one lap before
    T_match_query = se3.inverse(truth[query - lap]) @ truth[query] @ noise(loop)
    graph.add_loop(LoopClosure(query, query - lap, T_match_query, loop, inliers=50))
for _ in range(given.false_loops):  # two places that only look alike
    match, query = sorted(rng.choice(len(truth), 2, replace=False))
    graph.add_loop(LoopClosure(int(query), int(match), noise(loop), loop, inliers=50))

given.out.mkdir(parents=True, exist_ok=True)
figure = new_figure(11.0, 4.2)
estimates = {"odometry": graph.odometry_poses()} | {name: graph.optimize(name).poses for name in ("none", "pcm+gnc")}
for ax, (name, poses) in zip(figure.subplots(1, 3), estimates.items(), strict=True):
    ate = absolute_trajectory_error(poses, np.array(truth))
    print(f"{name}: ATE {ate:.2f} m after SE(3) alignment")
    style_axes(ax)
    ax.plot(*np.array(truth)[:, [0, 2], 3].T, color=style.GROUND_TRUTH, ls="--", label="ground truth")
    ax.plot(
        *poses[:, [0, 2], 3].T,
        color=style.ODOMETRY if name == "odometry" else style.CORRECTED,
        label=name,
    )
    ax.set(title=f"{name}: ATE {ate:.2f} m", xlabel="x [m]", ylabel="z [m]", aspect="equal")
    ax.legend(frameon=False, loc="lower right")
save_png(figure, given.out / "5_false_loops.png")
