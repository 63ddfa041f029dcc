"""What a row of the ledger opens: its two images, where they agree, and what each stage said.

Every image is stored once, however many rows show it, and matches are numbers that the page draws over it.
"""

import base64
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.record import LoopEventRow, LoopRow, MatchedPixels, RunRecord, StageRow
from slam.report.reading import text, value, verdict
from slam.telling import headline, told

Image = NDArray[np.uint8]
ImageSource = Callable[[int], Image | None]
"""The left image (H, W) uint8 of a frame, or None where it is not at hand."""

BUDGET = 14_000_000  # characters of images: with all the rest a page of 5,000 frames and 2,000 rows is below 25 MB
_CHARACTERS_PER_PIXEL = 0.13  # of street scenes at the quality below
_QUALITY = 35
_WIDTHS = (320.0, 620.0)  # pixels: narrower one sees nothing, wider a page does not show it
_LINES = 100  # matches drawn of a pair; more hide the images
_PAIRS = 3  # loops shown without asking
_BATCH = 64  # images made at a time


@dataclass(frozen=True)
class Album:
    """Small images, each stored once.

    Attributes:
        width, height: of the images they were made from, pixels.
        pictures: frame to WebP in base64.
    """

    width: int = 0
    height: int = 0
    pictures: dict[int, str] = field(default_factory=dict)

    def shows(self, row: LoopRow) -> bool:
        """Whether both images of a row are here."""
        return row.query in self.pictures and row.match in self.pictures


def evidence(record: RunRecord, images: ImageSource, budget: int = BUDGET) -> dict[str, object]:
    """What the page needs to open any row of the ledger.

    Args:
        record: of the drive.
        images: where they come from; called from several threads.
        budget: characters that the images may take up; where they are too many, some rows open without.

    Returns:
        width, height and pictures of the `Album`; for each row its frames, fate, title, words by stage, caption, and
        in `lines` the pixels (x and y in the query's image, x and y in the match's) of each match to draw.
    """
    pictured = album(record.loops, images, budget)
    stages = {(stage.query, stage.match): stage for stage in record.stages}
    events: dict[tuple[int, int], list[LoopEventRow]] = {}
    for event in record.events:
        events.setdefault((event.query, event.match), []).append(event)
    matched = {(pair.query, pair.match): pair for pair in record.matched}
    paradigm = text(value(record.metrics, "places.paradigm"))
    rows = []
    for row in record.loops:
        key = row.query, row.match
        pair = matched.get(key)
        lines = _lines(pair) if pair and pictured.shows(row) else np.empty((0, 4), np.int64)
        rows.append(
            {
                "query": int(row.query),
                "match": int(row.match),
                "fate": verdict(row),
                "title": headline(row),
                "told": list(told(paradigm, row, stages.get(key, StageRow(*key)), events.get(key, ()))),
                "caption": _caption(row, pair, len(lines), pictured),
                "lines": lines.ravel().tolist(),
            }
        )
    return {"width": pictured.width, "height": pictured.height, "pictures": pictured.pictures, "rows": rows}


def album(rows: Sequence[LoopRow], images: ImageSource, budget: int = BUDGET) -> Album:
    """Small images of as many rows as the budget of characters permits, larger ones where there are few.

    Matches that were taken for revisits come first, and of these some from everywhere before all of one stretch.
    """
    frames = list(dict.fromkeys(frame for row in _by_interest(rows) for frame in (int(row.query), int(row.match))))
    first = next((image for frame in frames if (image := images(frame)) is not None), None)
    if first is None:
        return Album()
    height, width = first.shape
    wide = math.sqrt(budget / len(frames) / _CHARACTERS_PER_PIXEL * width / height)
    scale = min(1.0, float(np.clip(wide, *_WIDTHS)) / width)
    pictures: dict[int, str] = {}
    for frame, picture in _made(frames, images, scale):
        budget -= len(picture)
        if budget < 0:
            break
        pictures[frame] = picture
    return Album(width, height, {frame: pictures[frame] for frame in sorted(pictures)})


def _made(frames: Sequence[int], images: ImageSource, scale: float) -> Iterator[tuple[int, str]]:
    """Each frame with its small image in order; those that are not at hand are left out."""

    def make(frame: int) -> str:
        image = images(frame)
        return "" if image is None else _small(image, scale)

    with ThreadPoolExecutor() as pool:
        for start in range(0, len(frames), _BATCH):
            batch = frames[start : start + _BATCH]
            yield from ((frame, made) for frame, made in zip(batch, pool.map(make, batch), strict=True) if made)


def some_pairs(rows: Sequence[LoopRow], images: ImageSource) -> list[tuple[LoopRow, str, str]]:
    """A few rows, evenly chosen, with their images, query and match, in base64."""
    chosen = [rows[k] for k in sorted({round(k) for k in np.linspace(0, len(rows) - 1, _PAIRS)})] if rows else []
    found = [(row, images(row.query), images(row.match)) for row in chosen]
    scaled = [(row, a, b, min(1.0, _WIDTHS[1] / a.shape[1])) for row, a, b in found if a is not None and b is not None]
    return [(row, _small(a, scale), _small(b, scale)) for row, a, b, scale in scaled]


def _small(image: Image, scale: float) -> str:
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".webp", small, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return base64.b64encode(data.tobytes()).decode()


def _by_interest(rows: Sequence[LoopRow]) -> list[LoopRow]:
    """Revisits before other matches; each from coarse to fine over the drive: by the reversed bits of the position."""
    order = sorted(range(len(rows)), key=lambda k: (not rows[k].accepted, f"{k:032b}"[::-1]))
    return [rows[k] for k in order]


def _lines(pair: MatchedPixels) -> NDArray[np.int64]:
    """Some of the matches (K, 4), evenly chosen, to the pixel."""
    both = np.concatenate([pair.pixels_query, pair.pixels_match], axis=1)
    chosen = np.unique(np.linspace(0, len(both) - 1, min(len(both), _LINES)).round().astype(np.int64))
    return np.rint(both[chosen]).astype(np.int64)


def _caption(row: LoopRow, pair: MatchedPixels | None, drawn: int, pictured: Album) -> str:
    if not pictured.pictures:
        return "The images were not at hand when this page was made."
    if not pictured.shows(row):
        return "The images of this pair are not in this page, to keep it small."
    shown = f"Frame {row.query} above, frame {row.match} below."
    if pair is None or not drawn:
        return f"{shown} No match is drawn: none is known that agrees with one geometry."
    count = len(pair.pixels_query)
    some = "all" if drawn == count else str(drawn)
    return f"{shown} Drawn: {some} of the {count} matches that agree with {pair.agree_with}."
