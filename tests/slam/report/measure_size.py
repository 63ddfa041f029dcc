"""How large the report of a long drive is, how long it takes to write, and how long a browser takes to open it.

Run from the root: `python -m tests.slam.report.measure_size [FOLDER_OF_IMAGES]`. The drive is fabricated: 5,000
frames, and 2,000 rows in the loop log that show 4,000 different images. The images are noise that compresses like
photographs, or those of a folder, one after the other, shifted so that each is different.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from slam.report.html_report import write_report
from slam.report.loop_details import make_album
from slam.run_result import LoopRow, RunRecord

from . import fabricate
from .browser import NO_BROWSER, Browser, browser, has_browser

FRAMES, ROWS = 5000, 2000
INLIERS = 150
RUNS = 3


def long_drive() -> RunRecord:
    """Fabricate a drive whose loop log shows as many different images as it can; every seventh loop is none."""
    rows = []
    for query in np.linspace(FRAMES // 2, FRAMES - 1, ROWS).astype(int).tolist():
        true = query % 7 > 0
        reason = "kept with weight 1.00: 0.7 sigma from the optimised map" if true else "9 landmarks agree, expected 20"
        seen = INLIERS if true else 9
        value = 1.0 if true else float("nan")
        rows.append(LoopRow(query, query - FRAMES // 2, 12.3, True, 300, seen, true, true, value, value, true, reason))
    return fabricate.with_evidence(replace(fabricate.record(FRAMES), loops=tuple(rows)))


def folder_images(folder: Path) -> Callable[[int], np.ndarray]:
    """Make any number of different images from those of a folder."""
    known = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.iterdir())]
    return lambda index: np.roll(known[index % len(known)], 31 * (index // len(known)), axis=1)


def seconds_to_open(shown: Browser, path: Path) -> tuple[float, float]:
    """Until the page has been drawn, and from there until a row has opened its images; each the best of a few."""
    opened, pairs = [], []
    for _ in range(RUNS):
        opened.append(shown.open(path))
        start = time.perf_counter()
        shown.run("document.querySelector('#loop-log .open').click()")
        pairs.append(time.perf_counter() - start)
    return min(opened), min(pairs)


def main() -> None:
    """Write a report, open it, print."""
    images = folder_images(Path(sys.argv[1])) if len(sys.argv) > 1 else fabricate.street
    record = long_drive()
    table = Table("what", "measured", title=f"A report of {FRAMES} frames and {ROWS} rows")
    pictured = make_album(record.loops, images)
    table.add_row("rows with their images", str(sum(map(pictured.shows, record.loops))))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        start = time.perf_counter()
        write_report(record, path, images, {})
        table.add_row("seconds to write", f"{time.perf_counter() - start:.1f}")
        table.add_row("megabytes", f"{path.stat().st_size / 1e6:.1f}")
        if has_browser():
            with browser() as shown:
                opened, pair = seconds_to_open(shown, path)
            table.add_row("seconds to open", f"{opened:.2f}")
            table.add_row("seconds to open a row for the first time", f"{pair:.2f}")
        else:
            table.add_row("seconds to open", NO_BROWSER)
    Console().print(table)


if __name__ == "__main__":
    main()
