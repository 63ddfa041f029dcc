"""What the viewer shows, in the terms of rerun: archetypes of NumPy arrays, growing entities, layout of the views."""

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from odometry.se3 import inverse, transform
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from slam.mapping.tsdf import Surface
from slam.report import style
from slam.run_result import PointCloud
from slam.viewer.viewer import FrameView

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_JPEG_QUALITY = 60  # 54 kB for a 1241 x 376 image of a street; 75 would take 70 kB
_MAX_TRACKS = 400  # drawn in an image
_MAX_MAP_POINTS = 300_000  # drawn of each map
_MAX_MATRIX_SIDE_PX = 500
_NUM_DASHES = 300  # of the ground truth
_MAX_REPLACED_ROWS = 1000  # of a line that is logged again with every loop
_MAX_REPLACED_LANDMARKS = 10_000  # 0.1 MB each time
_MIN_MOVED_SHARE = 0.02
_MAX_DRAWN_LOOPS = 500  # of each kind, evenly chosen: all are logged again with every pair that is shown
_LIFT_M = np.array([0.0, 0.5, 0.0])  # up is -y: dots float above the line, which would hide them
# Entities of each view.
_LIVE_ONLY = ["- /world/map_before/**", "- /world/dense_before/**", "- /world/dense_after/**"]
_BEFORE = ["+ /world/odometry/**", "+ /world/map_before/**", "+ /world/ground_truth/**"]
_AFTER = ["+ /world/corrected/**", "+ /world/map_after/**", "+ /world/ground_truth/**", "+ /world/loops/**"]
_DENSE_BEFORE = ["+ /world/dense_before/**", "+ /world/ground_truth/**"]
_DENSE_AFTER = ["+ /world/dense_after/**", "+ /world/ground_truth/**"]
_DARK = [16, 18, 22]  # background of all views, RGB


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
        return rr.LineStrips3D([positions], colors=[style.rgb(colour)], radii=rr.Radius.ui_points(1.4))

    return draw


def draw_landmarks(points: Array) -> rr.Points3D:
    """Draw landmarks (N, 3), metres, as small grey dots."""
    return rr.Points3D(points, colors=[150, 150, 150], radii=rr.Radius.ui_points(0.8))


def draw_dashed_line(positions: Array) -> rr.LineStrips3D:
    """Draw positions (N, 3), metres, as a dashed grey line: rerun has no dashes, so each dash is a line."""
    length = max(len(positions) // (2 * _NUM_DASHES), 1) + 1
    pieces = [positions[k : k + length] for k in range(0, len(positions), 2 * (length - 1))]
    return rr.LineStrips3D(pieces, colors=[style.rgb(style.GROUND_TRUTH)], radii=rr.Radius.ui_points(1.2))


def draw_tracks(view: FrameView) -> rr.Arrows2D:
    """Draw tracks as arrows from the previous to the current pixel: inliers green, the others red."""
    shown = slice(None, None, len(view.pixels_current) // _MAX_TRACKS + 1)
    start, end, agrees = view.pixels_previous[shown], view.pixels_current[shown], view.inliers[shown]
    good, bad = style.rgb(style.ACCEPTED), style.rgb(style.REJECTED)
    return rr.Arrows2D(
        origins=start, vectors=end - start, colors=np.where(agrees[:, None], good, bad).astype(np.uint8),
        radii=rr.Radius.ui_points(1.0),
    )  # fmt: skip


def draw_loops(pairs: Iterable[tuple[int, int]], poses: Array, colour: str) -> tuple[rr.Arrows3D, rr.Points3D]:
    """Draw loops (query, match) on poses (N, 4, 4), metres, as arrows from query to match.

    Queries are dots as well: the arrow of a well closed loop is too short to be seen. Of many loops some are drawn.
    """
    known = np.array([pair for pair in pairs if max(pair) < len(poses)], dtype=np.int64).reshape(-1, 2)
    known = known[:: len(known) // _MAX_DRAWN_LOOPS + 1]
    ends = poses[:, :3, 3][known]
    look = {"colors": style.rgb(colour), "radii": rr.Radius.ui_points(1.2)}
    arrows = rr.Arrows3D(origins=ends[:, 0], vectors=ends[:, 1] - ends[:, 0], **look)
    return arrows, rr.Points3D(ends[:, 0] - _LIFT_M, colors=style.rgb(colour), radii=rr.Radius.ui_points(4.0))


def draw_cloud(points: PointCloud, colour: str) -> rr.Points3D:
    """Draw a map in one colour, as bright as its points are in the images."""
    shown = slice(None, None, len(points.points) // _MAX_MAP_POINTS + 1)
    brightness = 0.25 + 0.75 * points.grey[shown, None] / 255.0
    tinted = (brightness * np.array(style.rgb(colour))).astype(np.uint8)
    return rr.Points3D(points.points[shown], colors=tinted, radii=rr.Radius.ui_points(0.8))


def draw_mesh(surface: Surface) -> rr.Mesh3D:
    """Draw a triangle mesh, in the colours of the images."""
    return rr.Mesh3D(
        vertex_positions=surface.points.astype(np.float32),
        vertex_colors=surface.color,
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


class GrowingEntity:
    """Rows (N, 3), metres, shown under one entity path and its parts.

    A viewer shows what was logged last to a path, so adding a row means to log all rows again. Here only the newest
    rows are logged again; once they are more than `max_rows` they become a part of their own that stays as it is. The
    file thus grows linearly with the length of the recording, not with its square.
    """

    def __init__(
        self, recording: rr.RecordingStream, path: str, draw: Callable[[Array], object], max_rows: int
    ) -> None:
        self._recording = recording
        self._path = path
        self._draw = draw
        self._max_rows = max_rows
        self._parts = 0
        self._newest = np.empty((0, 3))

    def append(self, rows: Array) -> None:
        """Add rows (M, 3)."""
        self._newest = np.concatenate([self._newest, rows])
        if len(self._newest) > self._max_rows:
            self._recording.log(f"{self._path}/part_{self._parts:03d}", self._draw(self._newest))
            self._parts += 1
            self._newest = self._newest[-1:]  # the next part begins where this one ends: a line has no gap
        self._recording.log(self._path, self._draw(self._newest))

    def replace(self, rows: Array, max_rows: int = _MAX_REPLACED_ROWS) -> None:
        """Show rows (M, 3) instead of all earlier ones, subsampled if there are more than `max_rows`."""
        self.clear()
        if len(rows):
            stride = len(rows) // max_rows + 1
            self._recording.log(f"{self._path}/part_000", self._draw(np.concatenate([rows[::stride], rows[-1:]])))
            self._parts, self._newest = 1, rows[-1:]

    def conclude(self, rows: Array) -> None:
        """Show the final rows (M, 3), all of them under the path itself."""
        self.clear()
        self._recording.log(self._path, self._draw(rows))

    def clear(self) -> None:
        """Remove everything from the view."""
        for part in range(self._parts):
            self._recording.log(f"{self._path}/part_{part:03d}", rr.Clear(recursive=False))
        self._recording.log(self._path, rr.Clear(recursive=False))
        self._parts, self._newest = 0, np.empty((0, 3))


class MovableLandmarks:
    """Landmarks of key frames, which move with them when a loop corrects the trajectory."""

    def __init__(self, entity: GrowingEntity) -> None:
        self._entity = entity
        self._frames: list[int] = []
        self._poses: list[Array] = []  # by which they are shown
        self._points: list[Array] = []  # in the camera frame

    def append(self, frame: int, T_world_camera: Array, points: Array) -> None:
        """Add landmarks (M, 3) of a key frame, metres, world frame."""
        self._frames.append(frame)
        self._poses.append(T_world_camera)
        self._points.append(transform(inverse(T_world_camera), points))
        self._entity.append(points)

    def correct(self, poses: Array) -> None:
        """Move all landmarks to the corrected trajectory (N, 4, 4), metres.

        All have to be logged again, so that this waits until the trajectory has moved by a fiftieth of its extent. The
        scale of one camera is not corrected before the end of the run.
        """
        if not self._frames:
            return
        corrected = poses[self._frames]
        moved = np.linalg.norm(corrected[:, :3, 3] - np.array(self._poses)[:, :3, 3], axis=1).max()
        if moved >= _MIN_MOVED_SHARE * np.ptp(poses[:, :3, 3], axis=0).max():
            self._poses = list(corrected)
            points = [transform(T, points) for T, points in zip(corrected, self._points, strict=True)]
            self._entity.replace(np.concatenate(points), _MAX_REPLACED_LANDMARKS)

    def clear(self) -> None:
        """Remove all landmarks from the view."""
        self._entity.clear()


def blueprint(width: int, height: int, positions: Array | None, dense: bool = False) -> rrb.Blueprint:
    """Lay out map, camera image (width x height), latest loop and curves; with `dense` also a tab of dense maps.

    The 3D views look down on positions (N, 3), metres; without positions rerun chooses the viewpoint.
    """
    viewpoint = None if positions is None or len(positions) < 2 else _overview(positions)
    whole = _map("Drive", ["+ /world/**", *_LIVE_ONLY], viewpoint)
    pair = rrb.Horizontal(
        _image("Latest loop: query", "loop/query", (width / 2, height / 2)),
        _image("Latest loop: match", "loop/match", (width / 2, height / 2)),
        rrb.Spatial2DView(origin="places", name="Votes: query down, match across", background=_DARK),
        column_shares=[3, 3, 2],
    )
    right = rrb.Vertical(
        _image("Camera and tracks", "world/camera/image", (width, height)),
        pair,
        _curves(),
        row_shares=[3, 2, 5],
        name="Now",
    )
    before_after = rrb.Horizontal(
        _map("Before: odometry", _BEFORE, viewpoint),
        _map("After: corrected", _AFTER, viewpoint),
        name="Before and after",
    )
    drive = rrb.Horizontal(whole, right, column_shares=[5, 4], name="Drive")
    return rrb.Blueprint(
        rrb.Tabs(
            *([_dense_maps(viewpoint)] if dense else []),
            drive,
            before_after,
            rrb.TextLogView(origin="loop/log", name="Loop log"),
            active_tab=0,
        ),
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _dense_maps(viewpoint: rrb.EyeControls3D | None) -> rrb.Horizontal:
    return rrb.Horizontal(
        _map("Before: dense map by odometry", _DENSE_BEFORE, viewpoint),
        _map("After: dense map, corrected", _DENSE_AFTER, viewpoint),
        name="Dense map",
    )


def _map(name: str, contents: list[str], viewpoint: rrb.EyeControls3D | None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(origin="world", contents=contents, name=name, background=_DARK, eye_controls=viewpoint)


def _image(name: str, origin: str, size: tuple[float, float]) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=[0.0, size[0]], y_range=[0.0, size[1]])
    return rrb.Spatial2DView(origin=origin, name=name, background=_DARK, visual_bounds=bounds)


def _curves() -> rrb.Grid:
    return rrb.Grid(
        _curve("Inlier tracks", "plots/inliers"),
        _curve("Loop score", "plots/score"),
        _curve("Stages [ms]", "plots/stages"),
        _curve("Position error [m], aligned", "plots/error"),
        grid_columns=2,
    )


def _curve(name: str, origin: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.Corner2D.LeftTop)


def _overview(positions: Array) -> rrb.EyeControls3D:
    """Look from behind and above; up in the world is -y."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    centre, size = (low + high) / 2, max(float((high - low).max()), 10.0)
    return rrb.EyeControls3D(position=centre + size * np.array([0.0, -1.2, -0.6]), look_target=centre)
