"""Put odometry and matches of other programs into the chain, and compare all combinations in one table.

    python examples/compare_parts.py [DRIVE] [--trajectory orb_slam3=poses.txt ...] [--out runs/examples]

DRIVE is a stereo recording with ground truth; without it a street is simulated. Each trajectory (KITTI or TUM poses,
such as `odometry.txt` of `benchmarks/orb_slam3.py`) is an odometry beside the one of the system. The matches come from
a descriptor in NumPy: every image as 32 x 8 normalised brightness values, compared by their cosine. The table, with a
line for each odometry, recogniser and back end, is also in compare_parts/results.csv and compare_parts/report.html.
"""

import shutil
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from rich.console import Console
from street import arguments, street

from slam.benchmark.sweep import BenchmarkOptions, run_benchmark
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_for_odometry

MIN_AGE = 50  # images: later ones show what the camera still sees
MIN_COSINE = 0.9


def write_matches(drive, path: Path) -> None:
    """Match each image with the most similar one that is old enough, and write query, match and score."""
    vectors, lines = [], ["query,match,score"]
    for query in range(len(drive)):
        cells = cv2.resize(drive[query].left, (32, 8), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
        vectors.append((cells - cells.mean()) / (np.linalg.norm(cells - cells.mean()) + 1e-9))
        cosines = np.array(vectors[: max(query - MIN_AGE, 0)]) @ vectors[-1] if query > MIN_AGE else np.empty(0)
        if len(cosines) and cosines.max() > MIN_COSINE:
            lines.append(f"{query},{cosines.argmax()},{cosines.max():.6f}")
    path.write_text("\n".join(lines) + "\n")


parser = arguments(__doc__)
parser.add_argument("drive", nargs="?", type=Path, help="stereo recording with ground truth; default: a street")
parser.add_argument("--sequence", help="name of the sequence, where the recording has several")
parser.add_argument("--trajectory", action="append", default=[], metavar="NAME=FILE", help="an odometry from a file")
given = parser.parse_args()

source = (given.drive or street(given)).resolve()
folder = given.out / "compare_parts"
folder.mkdir(parents=True, exist_ok=True)
write_matches(open_for_odometry(DatasetSpec(source, given.sequence), mono=False), folder / "brightness.csv")
for trajectory in given.trajectory:
    name, _, file = trajectory.partition("=")
    shutil.copyfile(file, folder / f"{name}.txt")
sweep = {
    "odometry": ["stereo", *(f"file:{trajectory.partition('=')[0]}.txt" for trajectory in given.trajectory)],
    "paradigms": ["tracked-words", "file:brightness.csv"],
    "robust": ["none", "pcm+gnc"],
    "sources": [{"path": str(source), "name": "drive"} | ({"sequence": given.sequence} if given.sequence else {})],
}
(folder / "sweep.toml").write_text(tomli_w.dumps(sweep))
options = BenchmarkOptions(folder / "sweep.toml", folder, workers=0)
raise SystemExit(0 if run_benchmark(options, Console(stderr=True), Console()) else 1)
