"""Run a fixed set of commands with two versions of the code, and compare every result value by value.

    python benchmarks/compare_versions.py record OLD_CHECKOUT --out before
    python benchmarks/compare_versions.py record . --out after
    python benchmarks/compare_versions.py compare before after

The set: a simulated drive by stereo and by one camera, place recognition with all six paradigms, four pose graphs in
2D and 3D with false loops, a second drive through the map of the first, images located in that map, a run killed
midway and resumed, a run reprocessed from its map, and a dense map. `--real DIR` adds recordings in KITTI layout.

The comparison is exact, or to a `--tolerance`, with the largest difference printed. It leaves out what no two runs
share (times, memory, paths, versions) and pictures. Columns and keys that have been renamed are mapped by the tables
below; of texts that give a reason the numbers are compared.
"""

import argparse
import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from command_line import existing, run_script

PARADIGMS = (
    "sequence-histograms",
    "dynamic-sequences",
    "hierarchical-places",
    "tracked-words",
    "pixel-sequences",
    "global-descriptor",
)
ENTRY = """
from importlib import import_module
from importlib.util import find_spec
# The command line was one module once, and is a folder now.
import_module("slam.cli.app" if find_spec("slam.cli").submodule_search_locations else "slam.cli").main()
"""
# Old name of a column or key -> its name now, by file.
RENAMED: dict[str, dict[str, str]] = {
    "loop_stages.csv": {
        "turn_deg": "rotation_deg",
        "sigma_m": "position_sigma_m",
        "sigma_deg": "rotation_sigma_deg",
        "gate_residual": "gate_sigma",
        "x": "x_m",
        "y": "y_m",
        "z": "z_m",
    },
    "frames.csv": {"residual": "residual_px"},
    "poses.csv": {
        "found": "localized",
        "beside": "matched_image",
        "world": "map_id",
        "x": "x_m",
        "y": "y_m",
        "z": "z_m",
        "sigma_m": "position_sigma_m",
        "sigma_deg": "rotation_sigma_deg",
    },
    "drive.json": {
        "spec": "config",
        "relight": "change_illumination",
        "alike": "perceptual_aliasing",
        "moving_cars": "cars_per_360m",
        "clean": "ideal_sensor",
        "length": "length_m",
        "speed": "speed_m_per_s",
        "frame_rate": "frame_rate_hz",
        "lateral_offset": "lateral_offset_m",
        "rectification_error": "rectification_error_px",
        "lens_error": "lens_error_px",
    },
}
# Columns that have become a table of their own: loop_events.csv.
REMOVED = {"loop_stages.csv": {"online"}}
# What differs from one run to the next, or is a picture or a page made of the other files.
SKIPPED = {
    "report.html",
    "run.log",
    "recording.rrd",
    "dense.rrd",
    "map.db",
    "config.toml",
    "provenance.json",
    "dense.html",
}
PICTURES = {".png", ".jpg", ".svg"}
VOLATILE = re.compile(
    r"schema|^format$|command|versions|source|recording|^ground_truth$|timing|_ms$|_mb$|seconds|per_second|bytes|^run$"
    r"|^stage_ms|^ms_|map_file|features_ms"
)
SECONDS_BEFORE_KILL = 9.0


class Version:
    """A checkout of the project, whose command line writes into one folder."""

    def __init__(self, checkout: Path, out: Path) -> None:
        self.out = out
        self._environment = os.environ | {"PYTHONPATH": str(checkout.resolve()), "XDG_CACHE_HOME": str(out / "cache")}

    def command(self, *words: object) -> list[str]:
        """Words that start the command line in a process of its own."""
        return [sys.executable, "-c", ENTRY, *map(str, words)]

    def run(self, *words: object) -> None:
        """Run one command, unless an earlier call of this script has finished it."""
        name = words[words.index("--out") + 1] if "--out" in words else self.out / "-".join(map(str, words[:1]))
        done = Path(f"{name}.done")
        done.parent.mkdir(parents=True, exist_ok=True)
        if done.exists():
            return
        begin = time.perf_counter()
        print("revisit", *words, flush=True)
        finished = subprocess.run(self.command(*words), env=self._environment, capture_output=True, text=True)
        if finished.returncode:
            sys.exit(f"{' '.join(map(str, words))}: exit code {finished.returncode}\n{finished.stderr[-3000:]}")
        done.write_text(f"{time.perf_counter() - begin:.1f}\n")

    def kill(self, *words: object) -> None:
        """Start one command and kill it midway."""
        process = subprocess.Popen(
            self.command(*words), env=self._environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(SECONDS_BEFORE_KILL)
        process.send_signal(signal.SIGKILL)
        process.wait()


def record(version: Version, real: Path | None, graphs: Path | None) -> None:
    """Run the whole set."""
    out = version.out
    out.mkdir(parents=True, exist_ok=True)
    drive = out / "drive"
    version.run("simulate", "blocks", "--laps", 2, "--length", 150, "--seed", 7, "--out", drive)
    one, other = halves(drive, out)
    version.run("run", drive, "--out", out / "stereo")
    version.run("run", drive, "--mono", "--camera-height", 1.65, "--out", out / "mono", "--no-record")
    for name in PARADIGMS:
        version.run("places", drive, "--sequence", "00", "--paradigm", name, "--out", out / f"places-{name}")
    version.run("run", one, "--out", out / "first", "--no-record", "--paradigm", "hierarchical-places")
    version.run("run", other, "--map", out / "first", "--out", out / "second", "--no-record")
    version.run("locate", out / "first", other / "sequences/00/image_0", "--out", out / "located/poses.csv")
    if not (out / "resumed.done").exists():
        version.kill("run", drive, "--out", out / "resumed", "--no-record")
    version.run("run", drive, "--out", out / "resumed", "--no-record", "--resume")
    version.run("reprocess", out / "stereo", "--out", out / "reprocessed", "--no-record", "--robust", "gnc")
    version.run("dense", out / "stereo")
    for graph in sorted(graphs.glob("*.g2o")) if graphs else ():
        version.run("optimize", graph, "--out", out / f"optimized-{graph.stem}")
    for clip in sorted(real.glob("sequences/*")) if real else ():
        mono = () if (clip / "image_1").exists() else ("--mono",)
        words = ("run", real, "--sequence", clip.name, *mono, "--no-record")
        version.run(*words, "--out", out / f"real-{clip.name}")


def halves(drive: Path, out: Path) -> tuple[Path, Path]:
    """Both halves of a drive as drives of their own, with links to its images."""
    sequence = "sequences/00"
    times = (drive / sequence / "times.txt").read_text().splitlines()
    middle = len(times) // 2
    parts = []
    for name, frames in (("one", range(middle)), ("other", range(middle, len(times)))):
        part = out / name
        parts.append(part)
        if part.exists():
            continue
        for camera in ("image_0", "image_1"):
            (part / sequence / camera).mkdir(parents=True)
            for number, frame in enumerate(frames):
                image = drive.resolve() / sequence / camera / f"{frame:06d}.png"
                (part / sequence / camera / f"{number:06d}.png").symlink_to(image)
        shutil.copy(drive / sequence / "calib.txt", part / sequence / "calib.txt")
        (part / sequence / "times.txt").write_text("".join(f"{times[frame]}\n" for frame in frames))
    return parts[0], parts[1]


def add_false_loops(graph: Path, out: Path, share: float, seed: int) -> None:
    """Write a g2o graph with random loops: the identity between random vertices, as many as `share` of its loops."""
    lines = graph.read_text().splitlines()
    rng = np.random.default_rng(seed)
    edges = [line.split() for line in lines if line.startswith("EDGE")]
    loops = [edge for edge in edges if abs(int(edge[1]) - int(edge[2])) != 1]
    last = max(int(edge[2]) for edge in edges)
    template = loops[0]
    motion = ["0"] * 3 if template[0] == "EDGE_SE2" else ["0"] * 6 + ["1"]
    false = []
    for _ in range(int(share * len(loops))):
        first, second = sorted(rng.choice(last, 2, replace=False))
        false.append(" ".join([template[0], str(first), str(second), *motion, *template[3 + len(motion) :]]))
    out.write_text("\n".join([*lines, *false]) + "\n")


@dataclass
class Comparison:
    """What a comparison has found.

    Attributes:
        tolerance: numbers that differ by less than this share of the larger one, or of 1, count as rounding.
        differences: lines, one for each place.
        rounded: number of numbers that differ by rounding.
        largest: largest of these differences.
    """

    tolerance: float
    differences: list[str] = field(default_factory=list)
    rounded: int = 0
    largest: float = 0.0

    def compare(self, before: Any, after: Any, place: str) -> None:
        """Compare two nested values."""
        if isinstance(before, dict) and isinstance(after, dict):
            self._compare_dicts(before, after, place)
        elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            for number, (one, other) in enumerate(zip(before, after, strict=True)):
                self.compare(one, other, f"{place}[{number}]")
        elif isinstance(before, np.ndarray) and isinstance(after, np.ndarray):
            self._compare_arrays(before, after, place)
        elif before != after and not self._is_rounding(before, after):
            self.differences.append(f"{place}: {before!r:.80} -> {after!r:.80}")

    def _compare_dicts(self, before: dict[str, Any], after: dict[str, Any], place: str) -> None:
        for key in before:
            inner = f"{place}/{key}"
            if VOLATILE.search(str(key)):
                continue
            if key not in after:
                self.differences.append(f"{inner}: missing")
            elif str(key).endswith("reason") or place.endswith("/notes"):
                self.compare(numbers_in(before[key]), numbers_in(after[key]), inner)
            else:
                self.compare(before[key], after[key], inner)

    def _compare_arrays(self, before: np.ndarray, after: np.ndarray, place: str) -> None:
        if before.shape != after.shape or before.dtype.kind != after.dtype.kind:
            self.differences.append(f"{place}: {before.dtype} {before.shape} -> {after.dtype} {after.shape}")
        elif before.dtype.kind != "f":
            if not np.array_equal(before, after):
                self.differences.append(f"{place}: other values")
        else:
            self._compare_floats(before, after, place)

    def _compare_floats(self, before: np.ndarray, after: np.ndarray, place: str) -> None:
        other = ~((before == after) | (np.isnan(before) & np.isnan(after)))
        error = np.abs(before - after)[other] / np.maximum(1.0, np.abs(before)[other])
        if not error.size:
            return
        if np.isfinite(error).all() and error.max() <= self.tolerance:
            self.rounded, self.largest = self.rounded + error.size, max(self.largest, float(error.max()))
        else:
            self.differences.append(f"{place}: {error.size} numbers differ, by at most {error.max():.3g}")

    def _is_rounding(self, before: object, after: object) -> bool:
        try:
            one, other = float(str(before)), float(str(after))
        except ValueError:
            return False
        error = abs(one - other) / max(1.0, abs(one))
        if error > self.tolerance:
            return False
        self.rounded, self.largest = self.rounded + 1, max(self.largest, error)
        return True


def compare(before: Path, after: Path, tolerance: float) -> int:
    """Print each difference; return how many there are."""
    comparison, compared = Comparison(tolerance), 0
    for path in compared_files(before):
        name, other = path.relative_to(before), after / path.relative_to(before)
        if other.exists():
            compared += 1
            compare_files(path, other, str(name), comparison)
        else:
            comparison.differences.append(f"{name}: missing in {after}")
    for path in compared_files(after):
        if not (before / path.relative_to(after)).exists():
            print(f"{path.relative_to(after)}: only in {after} (not counted)")
    for line in comparison.differences[:200]:
        print(line)
    print(
        f"{compared} files compared, {len(comparison.differences)} differences;"
        f" {comparison.rounded} numbers differ by rounding, by at most {comparison.largest:.2g}"
    )
    return len(comparison.differences)


def compared_files(root: Path) -> list[Path]:
    """Files with results that two versions must share."""
    return sorted(path for path in root.rglob("*") if path.is_file() and is_compared(path.relative_to(root)))


def is_compared(name: Path) -> bool:
    """Whether a file of this name holds such results."""
    is_linked = name.parts[0] in {"one", "other", "cache"}
    is_picture = name.suffix in PICTURES and name.parts[0] != "drive"
    return not is_linked and not is_picture and name.suffix != ".done" and name.name not in SKIPPED


def compare_files(before: Path, after: Path, place: str, comparison: Comparison) -> None:
    """Compare two files by their values, or by their bytes where the format is not known."""
    reader = READERS.get(before.suffix)
    if reader is not None:
        comparison.compare(reader(before), reader(after), place)
    elif before.read_bytes() != after.read_bytes():
        comparison.differences.append(f"{place}: other bytes")


def numbers_in(text: object) -> list[str]:
    """Numbers of a text, or of a list of texts: the words may have changed, the numbers may not."""
    return re.findall(r"\d+(?:\.\d+)?", str(text))


def read_columns(path: Path) -> dict[str, list[str]]:
    """Columns of a CSV file under today's names."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    names = [RENAMED.get(path.name, {}).get(name, name) for name in rows[0]]
    kept = [k for k, name in enumerate(names) if name not in REMOVED.get(path.name, set())]
    return {names[k]: [row[k] for row in rows[1:]] for k in kept}


def read_json(path: Path) -> Any:
    """Content of a JSON file under today's names."""
    return rename_keys(json.loads(path.read_text()), RENAMED.get(path.name, {}))


def rename_keys(content: Any, names: dict[str, str]) -> Any:
    """The same nested values under new names."""
    if isinstance(content, dict):
        return {names.get(key, key): rename_keys(value, names) for key, value in content.items()}
    return [rename_keys(value, names) for value in content] if isinstance(content, list) else content


def read_words(path: Path) -> dict[str, Any]:
    """Words and numbers of a text file: g2o, KITTI and TUM poses, settings of a grid."""
    numbers, words = [], []
    for word in path.read_text().split():
        try:
            numbers.append(float(word))
        except ValueError:
            words.append(word)
    return {"numbers": np.array(numbers), "words": words}


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Vertices of a binary PLY file, and what follows them; comments do not count."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in header.decode().splitlines()]
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    begin = next(k for k, line in enumerate(lines) if line[:2] == ["element", "vertex"])
    properties = []
    for line in lines[begin + 1 :]:
        if line[0] != "property":
            break
        properties.append((line[2], PLY_TYPES[line[1]]))
    vertices = np.frombuffer(body, np.dtype(properties), count)
    columns = {name: vertices[name] for name, _ in properties}
    return columns | {"rest": np.frombuffer(body[vertices.nbytes :], np.uint8)}


PLY_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4", "uint": "<u4"}
READERS: dict[str, Callable[[Path], Any]] = {
    ".json": read_json,
    ".csv": read_columns,
    ".npz": lambda path: dict(np.load(path, allow_pickle=False)),
    ".ply": read_ply,
    **dict.fromkeys((".txt", ".tum", ".g2o", ".yaml", ".toml"), read_words),
}


def main() -> None:
    """Record the results of one version, or compare two records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    recorder = commands.add_parser("record")
    recorder.add_argument("checkout", type=existing, help="folder of the version")
    recorder.add_argument("--out", type=Path, required=True, help="folder for its results; a second call goes on")
    recorder.add_argument("--real", type=existing, help="recordings in KITTI layout")
    recorder.add_argument("--graphs", type=existing, help="folder of g2o files")
    recorder.set_defaults(
        act=lambda given: record(Version(given.checkout, given.out.resolve()), given.real, given.graphs)
    )
    spoiler = commands.add_parser("spoil", help="write graphs with random loops")
    spoiler.add_argument("graphs", type=existing, nargs="+")
    spoiler.add_argument("--out", type=Path, required=True)
    spoiler.add_argument("--share", type=float, default=0.3)
    spoiler.set_defaults(
        act=lambda given: [
            add_false_loops(graph, given.out / f"{graph.stem}-false.g2o", given.share, seed=7) for graph in given.graphs
        ]
    )
    comparer = commands.add_parser("compare")
    comparer.add_argument("before", type=existing)
    comparer.add_argument("after", type=existing)
    comparer.add_argument("--tolerance", type=float, default=0.0, help="share by which numbers may differ; 0 for bits")
    comparer.set_defaults(act=lambda given: sys.exit(bool(compare(given.before, given.after, given.tolerance))))
    arguments = parser.parse_args()
    arguments.act(arguments)


if __name__ == "__main__":
    run_script(main)
