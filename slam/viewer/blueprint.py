"""Layout of a recording in the rerun viewer: maps, camera image, latest loop and curves."""

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LIVE_ONLY = ["- /world/map_before/**", "- /world/dense_before/**", "- /world/dense_after/**"]
_BEFORE = ["+ /world/odometry/**", "+ /world/map_before/**", "+ /world/ground_truth/**"]
_AFTER = ["+ /world/corrected/**", "+ /world/map_after/**", "+ /world/ground_truth/**", "+ /world/loops/**"]
_DENSE_BEFORE = ["+ /world/dense_before/**", "+ /world/ground_truth/**"]
_DENSE_AFTER = ["+ /world/dense_after/**", "+ /world/ground_truth/**"]
_DARK = [16, 18, 22]


def blueprint(width: int, height: int, positions: Array | None, dense: bool = False) -> rrb.Blueprint:
    """Lay out map, camera image (width x height), latest loop and curves; with `dense` also a tab of dense maps.

    The 3D views look down on positions (N, 3), metres; without positions rerun chooses the viewpoint.
    """
    eye = None if positions is None or len(positions) < 2 else _overview(positions)
    whole = _map("Drive", ["+ /world/**", *_LIVE_ONLY], eye)
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
        _map("Before: odometry", _BEFORE, eye), _map("After: corrected", _AFTER, eye), name="Before and after"
    )
    drive = rrb.Horizontal(whole, right, column_shares=[5, 4], name="Drive")
    return rrb.Blueprint(
        rrb.Tabs(
            *([_dense_maps(eye)] if dense else []),
            drive,
            before_after,
            rrb.TextLogView(origin="loop/log", name="Loop log"),
            active_tab=0,
        ),
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _dense_maps(eye: rrb.EyeControls3D | None) -> rrb.Horizontal:
    return rrb.Horizontal(
        _map("Before: dense map by odometry", _DENSE_BEFORE, eye),
        _map("After: dense map, corrected", _DENSE_AFTER, eye),
        name="Dense map",
    )


def _map(name: str, contents: list[str], eye: rrb.EyeControls3D | None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(origin="world", contents=contents, name=name, background=_DARK, eye_controls=eye)


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
