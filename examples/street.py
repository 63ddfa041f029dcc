"""The drive that the numbered examples share: two laps of a simulated street.

Everything follows from its spec: the same one gives the same bits, and a drive that is there is not rendered again.
"""

import argparse
from pathlib import Path

from slam.simulation import SimulationConfig, simulate


def output_folder(path: str) -> Path:
    """Make the folder of the results; for argparse, so that one that cannot be made is a line."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path}: cannot be made, {error.strerror}; choose another folder") from error
    return Path(path)


def arguments(doc: str | None) -> argparse.ArgumentParser:
    """Make the parser of an example, whose docstring is the help."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=output_folder, default="runs/examples", help="folder of the results")
    parser.add_argument("--width", type=int, default=620, help="of the images, pixels")
    parser.add_argument("--speed", type=float, default=10.0, help="of the car, m/s; it sees ten images in a second")
    return parser


def street(given: argparse.Namespace) -> Path:
    """Render the drive into the folder of the results and return its root, in KITTI's layout."""
    width, height = given.width, given.width * 376 // 1241
    spec = SimulationConfig("circle", 2, 200.0, 0, given.speed, width=width, height=height, difficulty="standard")
    return simulate(spec, given.out / f"drive_{given.width}_{given.speed:g}")
