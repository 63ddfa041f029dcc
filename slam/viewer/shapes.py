"""NumPy arrays as rerun archetypes: colours, sizes and subsampling of what the viewer draws."""

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from place_recognition.evaluation.matrix import SimilarityMatrix
from slam.mapping.fusion import Surface
from slam.record import PointCloud
from slam.report import colours
from slam.viewer.viewer import FrameView

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_JPEG_QUALITY = 60  # 54 kB for a 1241 x 376 image of a street; 75 would take 70 kB
_MAX_TRACKS = 400  # drawn in an image
_MAX_MAP_POINTS = 300_000  # drawn of each map
_MAX_MATRIX_SIDE_PX = 500
_NUM_DASHES = 300  # of the ground truth
_LIFT_M = np.array([0.0, 0.5, 0.0])  # up is -y: dots float above the line, which would hide them


def encode_jpeg(image: Image) -> rr.EncodedImage:
    """Compress an image, (H, W) uint8, as JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")


def render_matrix(matrix: SimilarityMatrix) -> rr.EncodedImage:
    """Draw a similarity matrix (row: query, column: earlier image), bright where it is large.

    Where several pairs share a pixel, the largest value is shown. The scale begins at the 90th percentile, so that nine
    in ten pairs are dark and the lines of the revisits stand out.
    """
    images = len(matrix.values)
    fold = max(-(-images // _MAX_MATRIX_SIDE_PX), 1)  # images that share a cell
    side = -(-images // fold)
    padded = np.full((side * fold, side * fold), np.nan, np.float32)
    padded[:images, :images] = matrix.values
    cells = np.fmax.reduce(np.fmax.reduce(padded.reshape(side, fold, side, fold), axis=3), axis=1)
    known = cells[np.isfinite(cells)]
    low, high = np.percentile(known, [90.0, 99.8]) if len(known) else (0.0, 1.0)
    grey = np.clip((np.nan_to_num(cells, nan=low) - low) / max(high - low, 1e-9), 0.0, 1.0)
    _, data = cv2.imencode(".png", (255 * grey).astype(np.uint8))
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/png")


def line_drawer(colour: str) -> Callable[[Array], rr.LineStrips3D]:
    """Return a function that draws positions (N, 3), metres, as one line."""

    def draw(positions: Array) -> rr.LineStrips3D:
        return rr.LineStrips3D([positions], colors=[colours.rgb(colour)], radii=rr.Radius.ui_points(1.4))

    return draw


def draw_landmarks(points: Array) -> rr.Points3D:
    """Draw landmarks (N, 3), metres, as small grey dots."""
    return rr.Points3D(points, colors=[150, 150, 150], radii=rr.Radius.ui_points(0.8))


def draw_dashed_line(positions: Array) -> rr.LineStrips3D:
    """Draw positions (N, 3), metres, as a dashed grey line: rerun has no dashes, so each dash is a line."""
    length = max(len(positions) // (2 * _NUM_DASHES), 1) + 1
    pieces = [positions[k : k + length] for k in range(0, len(positions), 2 * (length - 1))]
    return rr.LineStrips3D(pieces, colors=[colours.rgb(colours.GROUND_TRUTH)], radii=rr.Radius.ui_points(1.2))


def draw_tracks(view: FrameView) -> rr.Arrows2D:
    """Draw tracks as arrows from the previous to the current pixel: inliers green, the others red."""
    shown = slice(None, None, len(view.pixels_current) // _MAX_TRACKS + 1)
    start, end, agrees = view.pixels_previous[shown], view.pixels_current[shown], view.inliers[shown]
    good, bad = colours.rgb(colours.ACCEPTED), colours.rgb(colours.REJECTED)
    return rr.Arrows2D(
        origins=start, vectors=end - start, colors=np.where(agrees[:, None], good, bad).astype(np.uint8),
        radii=rr.Radius.ui_points(1.0),
    )  # fmt: skip


def draw_loops(pairs: Iterable[tuple[int, int]], poses: Array, colour: str) -> tuple[rr.Arrows3D, rr.Points3D]:
    """Draw loops (query, match) on poses (N, 4, 4), metres, as arrows from query to match.

    Queries are dots as well: the arrow of a well closed loop is too short to be seen.
    """
    known = np.array([pair for pair in pairs if max(pair) < len(poses)], dtype=np.int64).reshape(-1, 2)
    ends = poses[:, :3, 3][known]
    look = {"colors": colours.rgb(colour), "radii": rr.Radius.ui_points(1.2)}
    arrows = rr.Arrows3D(origins=ends[:, 0], vectors=ends[:, 1] - ends[:, 0], **look)
    return arrows, rr.Points3D(ends[:, 0] - _LIFT_M, colors=colours.rgb(colour), radii=rr.Radius.ui_points(4.0))


def draw_cloud(points: PointCloud, colour: str) -> rr.Points3D:
    """Draw a map in one colour, as bright as its points are in the images."""
    shown = slice(None, None, len(points.points) // _MAX_MAP_POINTS + 1)
    brightness = 0.25 + 0.75 * points.grey[shown, None] / 255.0
    tinted = (brightness * np.array(colours.rgb(colour))).astype(np.uint8)
    return rr.Points3D(points.points[shown], colors=tinted, radii=rr.Radius.ui_points(0.8))


def draw_mesh(surface: Surface) -> rr.Mesh3D:
    """Draw a triangle mesh, as bright as it is in the images."""
    return rr.Mesh3D(
        vertex_positions=surface.points.astype(np.float32),
        vertex_colors=np.repeat(surface.grey[:, None], 3, axis=1),
        triangle_indices=surface.triangles,
    )


def draw_matches(pixels: Array) -> rr.Points2D:
    """Draw matched pixels (K, 2); the k-th point has the same colour in both images of a pair."""
    hues = np.linspace(0, 179, len(pixels), endpoint=False).astype(np.uint8)
    hsv = np.stack([hues, np.full_like(hues, 200), np.full_like(hues, 255)], axis=1)
    rgb = cv2.cvtColor(hsv[None], cv2.COLOR_HSV2RGB)[0] if len(hues) else hsv
    return rr.Points2D(pixels, colors=rgb, radii=rr.Radius.ui_points(3.0))


def subsample(rows: Array, max_rows: int) -> Array:
    """Return every n-th row, with n such that at most `max_rows` are left."""
    return rows[:: len(rows) // max_rows + 1]
