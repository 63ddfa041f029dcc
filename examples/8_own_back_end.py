"""Add a robust back end of your own: a function that decides which loops to keep, and one line in `BACK_ENDS`.

    python examples/8_own_back_end.py [--out runs/examples]

Leaves 8_own_back_end.png: a drive of two laps with false loops, before and after. The back end trims: it fits, drops
the loops that fit worst, and fits again.
"""

import argparse

import numpy as np
from false_loops import two_laps
from street import output_folder

from slam.evaluation.outlier_injection import OutlierConfig, inject_outliers
from slam.pose_graph.robust.backends import BACK_ENDS, BackEndResult, solve
from slam.pose_graph.robust.gnc import least_squares
from slam.report.pose_graph_figure import draw_pose_graph
from slam.report.style import save_png


def trimmed(problem, screening):
    """Fit the gated loops, and drop the worst one again and again until all are within the chi-square limit."""
    kept = screening.passed.copy()
    poses = problem.start
    while kept.any():
        poses = least_squares(problem, kept, poses)
        chi2 = np.where(kept, problem.loops.chi2(poses), 0.0)
        # Only the worst one at a time: true loops may look wrong as long as false ones bend the map.
        wrong = chi2 > max(screening.max_inlier_chi2, 0.5 * chi2.max())
        if not wrong.any():
            return BackEndResult(poses, kept.astype(float), ())
        kept &= ~wrong
    return BackEndResult(problem.start, kept.astype(float), ())


BACK_ENDS["trimmed"] = trimmed

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=output_folder, default="runs/examples", help="folder of the results")
parser.add_argument("--share", type=float, default=0.3, help="share of false loops among all loops")
given = parser.parse_args()

clean = two_laps(seed=0)
mixed = inject_outliers(clean, clean.start, OutlierConfig("random", given.share))
for name in ("none", "trimmed", "pcm+gnc"):
    result = solve(mixed.problem, name)
    true, false = result.kept[mixed.true].sum(), result.kept[~mixed.true].sum()
    print(f"{name}: keeps {true} of {mixed.true.sum()} true loops and {false} of {(~mixed.true).sum()} false ones")

given.out.mkdir(parents=True, exist_ok=True)
figure = draw_pose_graph("trimmed", mixed.problem, solve(mixed.problem, "trimmed"), None)
save_png(figure, given.out / "8_own_back_end.png")
