"""Details of each row of the loop log: its two images, their matches, and what each stage decided.

Every image is stored once, even if several rows show it; matches are numbers that the page draws over the images.
"""

import base64
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.report.formatting import format_value, loop_outcome, metric_value
from slam.report.loop_explanation import describe_outcome, describe_stages
from slam.run_result import LoopEventRow, LoopRow, MatchedPixels, RunRecord, StageRow

Image = NDArray[np.uint8]
ImageSource = Callable[[int], Image | None]
"""Returns the left image, (H, W) uint8, of a frame, or None if it cannot be read."""

MAX_IMAGE_CHARACTERS = 14_000_000  # a page of 5,000 frames and 2,000 rows then stays below 25 MB
_CHARACTERS_PER_PIXEL = 0.13  # of street scenes at the quality below, in base64
_WEBP_QUALITY = 35
_WIDTH_LIMITS_PX = (320.0, 620.0)  # narrower images show too little, wider ones do not fit a page
_MAX_MATCHES = 100  # drawn of a pair; more hide the images
_NUM_EXAMPLES = 3  # loops shown without opening a row
_BATCH_SIZE = 64  # images encoded at a time


@dataclass(frozen=True)
class Album:
    """Small images of frames, each stored once.

    Attributes:
        width, height: size of the original images, pixels.
        pictures: WebP in base64 of each frame.
    """

    width: int = 0
    height: int = 0
    pictures: dict[int, str] = field(default_factory=dict)

    def shows(self, row: LoopRow) -> bool:
        """Return whether the album has both images of a row."""
        return row.query in self.pictures and row.match in self.pictures


def loop_details(record: RunRecord, images: ImageSource, budget: int = MAX_IMAGE_CHARACTERS) -> dict[str, object]:
    """Return the details of all rows of the loop log, as the page's script reads them.

    Args:
        record: record of the run.
        images: source of the images; called from several threads.
        budget: maximum number of characters of all images; if they need more, some rows have no images.

    Returns:
        width, height and pictures of the `Album`; for each row its frames, outcome, title, description of each stage,
        caption, and in `lines` the pixels of each match to draw: x, y in the query's image, x, y in the match's.
    """
    pictured = make_album(record.loops, images, budget)
    stages = {(stage.query, stage.match): stage for stage in record.stages}
    events: dict[tuple[int, int], list[LoopEventRow]] = {}
    for event in record.events:
        events.setdefault((event.query, event.match), []).append(event)
    matched = {(pair.query, pair.match): pair for pair in record.matched}
    paradigm = format_value(metric_value(record.metrics, "places.paradigm"))
    rows = []
    for row in record.loops:
        key = row.query, row.match
        pair = matched.get(key)
        lines = _lines(pair) if pair and pictured.shows(row) else np.empty((0, 4), np.int64)
        rows.append(
            {
                "query": int(row.query),
                "match": int(row.match),
                "outcome": loop_outcome(row),
                "title": describe_outcome(row),
                "stages": list(describe_stages(paradigm, row, stages.get(key, StageRow(*key)), events.get(key, ()))),
                "caption": _caption(row, pair, len(lines), pictured),
                "lines": lines.ravel().tolist(),
            }
        )
    return {"width": pictured.width, "height": pictured.height, "pictures": pictured.pictures, "rows": rows}


def make_album(rows: Sequence[LoopRow], images: ImageSource, budget: int = MAX_IMAGE_CHARACTERS) -> Album:
    """Encode small images of as many rows as the budget of characters permits; few rows get larger images.

    Accepted matches come first, and among them a coarse selection of the whole drive comes before the rest.
    """
    frames = list(dict.fromkeys(frame for row in _by_interest(rows) for frame in (int(row.query), int(row.match))))
    first = next((image for frame in frames if (image := images(frame)) is not None), None)
    if first is None:
        return Album()
    height, width = first.shape
    wide = math.sqrt(budget / len(frames) / _CHARACTERS_PER_PIXEL * width / height)
    scale = min(1.0, float(np.clip(wide, *_WIDTH_LIMITS_PX)) / width)
    pictures: dict[int, str] = {}
    for frame, picture in _encode_all(frames, images, scale):
        budget -= len(picture)
        if budget < 0:
            break
        pictures[frame] = picture
    return Album(width, height, {frame: pictures[frame] for frame in sorted(pictures)})


def _encode_all(frames: Sequence[int], images: ImageSource, scale: float) -> Iterator[tuple[int, str]]:
    """Yield each frame with its small image, in order; images that cannot be read are left out."""

    def encode(frame: int) -> str:
        image = images(frame)
        return "" if image is None else _encode(image, scale)

    with ThreadPoolExecutor() as pool:
        for start in range(0, len(frames), _BATCH_SIZE):
            batch = frames[start : start + _BATCH_SIZE]
            yield from (
                (frame, picture) for frame, picture in zip(batch, pool.map(encode, batch), strict=True) if picture
            )


def example_pairs(rows: Sequence[LoopRow], images: ImageSource) -> list[tuple[LoopRow, str, str]]:
    """Return a few evenly chosen rows with their images, query and match, in base64."""
    chosen = [rows[k] for k in sorted({round(k) for k in np.linspace(0, len(rows) - 1, _NUM_EXAMPLES)})] if rows else []
    found = [(row, images(row.query), images(row.match)) for row in chosen]
    scaled = [
        (row, a, b, min(1.0, _WIDTH_LIMITS_PX[1] / a.shape[1]))
        for row, a, b in found
        if a is not None and b is not None
    ]
    return [(row, _encode(a, scale), _encode(b, scale)) for row, a, b, scale in scaled]


def _encode(image: Image, scale: float) -> str:
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".webp", small, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])
    return base64.b64encode(data.tobytes()).decode()


def _by_interest(rows: Sequence[LoopRow]) -> list[LoopRow]:
    """Sort accepted rows before others, and each kind from coarse to fine: by the reversed bits of the position."""
    order = sorted(range(len(rows)), key=lambda k: (not rows[k].accepted, f"{k:032b}"[::-1]))
    return [rows[k] for k in order]


def _lines(pair: MatchedPixels) -> NDArray[np.int64]:
    """Return evenly chosen matches (K, 4), rounded to pixels."""
    both = np.concatenate([pair.pixels_query, pair.pixels_match], axis=1)
    chosen = np.unique(np.linspace(0, len(both) - 1, min(len(both), _MAX_MATCHES)).round().astype(np.int64))
    return np.rint(both[chosen]).astype(np.int64)


def _caption(row: LoopRow, pair: MatchedPixels | None, drawn: int, pictured: Album) -> str:
    if not pictured.pictures:
        return "The images could not be read when this page was made."
    if not pictured.shows(row):
        return "The images of this pair are not in this page, to keep it small."
    shown = f"Frame {row.query} above, frame {row.match} below."
    if pair is None or not drawn:
        return f"{shown} No matches are drawn: none agree with one geometry."
    count = len(pair.pixels_query)
    some = "all" if drawn == count else str(drawn)
    return f"{shown} Drawn: {some} of the {count} matches that agree with {pair.agree_with}."
