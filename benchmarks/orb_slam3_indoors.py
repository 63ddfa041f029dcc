"""ORB-SLAM3 with one camera or a depth camera on a recording in TUM RGB-D's layout: the peer of `indoors.py`.

    python benchmarks/orb_slam3_indoors.py FOLDER OUT --sensor mono|depth --vocabulary FILE

Runs in an environment of its own, as `orb_slam3.py` does. FOLDER has rgb.txt, perhaps depth.txt, and a camera.toml with
fx, fy, cx, cy and, perhaps, distortion (radtan) and
depth_scale. OUT gets `tracked.tum`, the pose of each frame that was tracked, at the
moment when it was; `key_frames.tum`, those of the final map; and `milliseconds.txt`.
"""

import argparse
import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
from orb_slam3 import SETTINGS

FEATURES = 1000  # of ORB-SLAM3's own settings for TUM RGB-D
BASELINE_M = 0.08  # likewise: `bf` over fx of its settings
DEPTH_SETTINGS = """RGBD.DepthMapFactor: 1.0
DepthMapFactor: 1.0
"""
MAX_OFFSET_S = 0.02  # between an image and its depth


def read_list(path: Path) -> tuple[np.ndarray, list[Path]]:
    """Read times (N,), seconds, and files of a list of the layout."""
    rows = [line.split()[:2] for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    return np.array([float(seconds) for seconds, _ in rows]), [path.parent / name for _, name in rows]


def read_depth(path: Path, scale: float) -> np.ndarray:
    """Read depth (H, W) float32, metres; 0 where there is none."""
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32) / np.float32(scale)


def tum_row(seconds: float, pose: np.ndarray) -> str:
    """Format a pose (4, 4) as a line of TUM."""
    R, t = pose[:3, :3], pose[:3, 3]
    vector = cv2.Rodrigues(R)[0].ravel()
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    q = (*np.sin(angle / 2) * axis, np.cos(angle / 2))
    return " ".join(f"{value:.9f}" for value in (seconds, *t, *q))


def main() -> None:
    """Track a recording at its own rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sensor", choices=("mono", "depth"), required=True)
    parser.add_argument("--vocabulary", type=Path, required=True)
    given = parser.parse_args()
    import pyorbslam3

    camera = tomllib.loads((given.folder / "camera.toml").read_text())
    times, images = read_list(given.folder / "rgb.txt")
    first = cv2.imread(str(images[0]), cv2.IMREAD_GRAYSCALE)
    numbers = {name: camera[name] for name in ("fx", "fy", "cx", "cy")}
    numbers |= {"bf": BASELINE_M * camera["fx"], "fps": 1.0 / np.median(np.diff(times))}
    texts = {name: repr(float(value)) for name, value in numbers.items()}
    settings = given.out / "settings.yaml"
    height, width = first.shape
    text = SETTINGS.format(width=width, height=height, features=FEATURES, **texts)
    for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.get("distortion", ()), strict=False):
        text = text.replace(f"Camera.{name}: 0.0\n", "") + f"Camera.{name}: {float(value)!r}\n"
    settings.write_text(text + (DEPTH_SETTINGS if given.sensor == "depth" else ""))
    depths = read_list(given.folder / "depth.txt") if given.sensor == "depth" else None
    sensor = pyorbslam3.Sensor.RGBD if depths else pyorbslam3.Sensor.MONOCULAR
    slam, rows, spent_ms = pyorbslam3.Slam(given.vocabulary, settings, sensor), [], []
    for seconds, file, pause_s in zip(times, images, np.diff(times, append=times[-1]), strict=True):
        image, start = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), time.perf_counter()
        if depths:
            near = int(np.abs(depths[0] - seconds).argmin())
            if abs(depths[0][near] - seconds) > MAX_OFFSET_S:
                continue
            depth = read_depth(depths[1][near], camera.get("depth_scale", 5000.0))
            start = time.perf_counter()
            result = slam.track_rgbd(image, depth, float(seconds))
        else:
            result = slam.track_monocular(image, float(seconds))
        spent_ms.append(1e3 * (time.perf_counter() - start))
        if result.pose_valid:
            rows.append(tum_row(seconds, np.array(result.pose_wc)))
        time.sleep(max(0.0, pause_s - 1e-3 * spent_ms[-1]))
    slam.shutdown()
    slam.save_keyframe_trajectory_tum(str(given.out / "key_frames.tum"))
    (given.out / "tracked.tum").write_text("".join(f"{row}\n" for row in rows))
    np.savetxt(given.out / "milliseconds.txt", spent_ms, fmt="%.3f")


if __name__ == "__main__":
    main()
