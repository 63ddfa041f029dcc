"""Details of each row of the loop log: what each stage decided in words, and its two images with their matches.

Every image is stored once, even if several rows show it; matches are numbers that the page draws over the images.
"""

import base64
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.report.formatting import format_value, loop_outcome, metric_value
from slam.run_result import LoopEventRow, LoopRow, MatchedPixels, RunRecord, StageRow

Image = NDArray[np.uint8]
ImageSource = Callable[[int], Image | None]
"""Returns the left image, (H, W) uint8, of a frame, or None if it cannot be read."""

MAX_ROWS = 2000  # of the loop log in a page; loops.csv has them all
MAX_IMAGE_CHARACTERS = 14_000_000  # a page of so many rows then stays below 25 MB
_CHARACTERS_PER_PIXEL = 0.13  # of street scenes at the quality below, in base64
_WEBP_QUALITY = 35
_WIDTH_LIMITS_PX = (320.0, 620.0)  # narrower images show too little, wider ones do not fit a page
_MAX_MATCHES = 100  # drawn of a pair; more hide the images
_NUM_EXAMPLES = 3  # loops shown without opening a row
_BATCH_SIZE = 64  # images encoded at a time
_NOT_REACHED = "not reached"  # by a match that an earlier stage rejected


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


def describe_outcome(row: LoopRow) -> str:
    """Return in one line whether the loop was closed."""
    return f"Frame {row.query} with frame {row.match}: {'closed' if row.in_graph else 'not closed'}."


def describe_stages(
    paradigm: str, row: LoopRow, stage: StageRow, events: Iterable[LoopEventRow] = ()
) -> Iterator[tuple[str, str]]:
    """Yield the name of each stage and its decision in words; the name is empty for further lines of a stage.

    Args:
        paradigm: name of the recogniser.
        row: row of the loop log.
        stage: measurements of each stage for this row.
        events: decisions of the online pose graph about it, in the order in which they were made.
    """
    reason = row.reason.removeprefix("not accepted: ")
    accepted = "accepted as a revisit" if row.accepted else f"not accepted as a revisit: {reason}"
    yield "recogniser", f"{paradigm}: score {row.score:.3g}, {accepted}"
    yield "epipolar check", _epipolar(stage)
    yield "relative pose", _relative_pose(row, stage)
    yield "drift gate", _gate(stage)
    decisions = [f"frame {event.frame}: {event.reason}" for event in events] or [_NOT_REACHED]
    for number, decision in enumerate(decisions):
        yield "" if number else "online graph", decision
    yield "final map", _back_end(row)
    if row.truth is not None:
        wrong = "not a revisit, or a wrong relative pose" if row.verified else "not a revisit"
        yield "ground truth", ("a true revisit" if row.truth else wrong) + _error(stage)


def _error(stage: StageRow) -> str:
    if math.isnan(stage.translation_error_m):
        return ""
    return f"; error of the relative pose {stage.translation_error_m:.3f} m, {stage.rotation_error_deg:.3f} deg"


def _epipolar(stage: StageRow) -> str:
    if stage.epipolar_inliers is None:
        return "not checked" if stage.epipolar_verified else "failed"
    amount = "enough" if stage.epipolar_verified else "too few"
    return f"{stage.epipolar_inliers} matches agree with one epipolar geometry, {amount}"


def _relative_pose(row: LoopRow, stage: StageRow) -> str:
    if row.verified:
        return (
            f"{row.inliers} of {row.matches} landmark matches agree; the camera moved {_axes(stage)} m and turned "
            f"{stage.rotation_deg:.2f} deg "
            f"(one sigma {stage.position_sigma_m:.3f} m, {stage.rotation_sigma_deg:.3f} deg)"
        )
    if not row.accepted:
        return f"{_NOT_REACHED}: the recogniser did not accept the match"
    return f"not found: {row.reason} ({row.inliers} of {row.matches} landmark matches agree)"


def _axes(stage: StageRow) -> str:
    axes = (("right", "left", stage.x_m), ("down", "up", stage.y_m), ("forward", "back", stage.z_m))
    return ", ".join(f"{abs(value):.2f} {plus if value >= 0 else minus}" for plus, minus, value in axes)


def _gate(stage: StageRow) -> str:
    if stage.gate_passed is None:
        return _NOT_REACHED
    return f"{'passed' if stage.gate_passed else 'rejected'}: {stage.gate_reason}"


def _back_end(row: LoopRow) -> str:
    if math.isnan(row.weight):
        return _NOT_REACHED
    # The reason counts sigmas on the scale that the back end has estimated, the residual on the stated one.
    return f"{row.reason} (weight {row.weight:.2f}, residual {row.residual:.2f} sigma by the stated covariances)"


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
    album = make_album(record.loops, images, budget)
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
        lines = _lines(pair) if pair and album.shows(row) else np.empty((0, 4), np.int64)
        rows.append(
            {
                "query": int(row.query),
                "match": int(row.match),
                "outcome": loop_outcome(row),
                "title": describe_outcome(row),
                "stages": list(describe_stages(paradigm, row, stages.get(key, StageRow(*key)), events.get(key, ()))),
                "caption": _caption(row, pair, len(lines), album),
                "lines": lines.ravel().tolist(),
            }
        )
    return {"width": album.width, "height": album.height, "pictures": album.pictures, "rows": rows}


def select_rows(rows: Sequence[LoopRow], max_rows: int = MAX_ROWS) -> tuple[LoopRow, ...]:
    """Select the rows of the loop log that a page shows, in their order.

    Where there are too many, up to half of them are accepted matches that were not kept, or are false; the others are
    kept ones, evenly chosen, before what the recogniser did not accept.
    """
    if len(rows) <= max_rows:
        return tuple(rows)
    odd = [row for row in rows if row.accepted and (not row.in_graph or row.truth is False)]
    first = _by_interest(odd)[: max_rows // 2]
    chosen = {id(row) for row in first}
    for row in _by_interest(rows):
        if len(chosen) == max_rows:
            break
        chosen.add(id(row))
    return tuple(row for row in rows if id(row) in chosen)


def make_album(rows: Sequence[LoopRow], images: ImageSource, budget: int = MAX_IMAGE_CHARACTERS) -> Album:
    """Encode small images of as many rows as the budget of characters permits; few rows get larger images.

    Accepted matches come first, and among them a coarse selection of the whole recording comes before the rest.
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


def _caption(row: LoopRow, pair: MatchedPixels | None, drawn: int, album: Album) -> str:
    if not album.pictures:
        return "The images could not be read when this page was made."
    if not album.shows(row):
        return "The images of this pair are not in this page, to keep it small."
    shown = f"Frame {row.query} above, frame {row.match} below."
    if pair is None or not drawn:
        return f"{shown} No matches are drawn: none agree with one geometry."
    count = len(pair.pixels_query)
    some = "all" if drawn == count else str(drawn)
    return f"{shown} Drawn: {some} of the {count} matches that agree with {pair.agree_with}."
