"""Compiled rasterisation with four samples per pixel: which triangle is visible at each sample.

Edges are planes through the centre of projection (Olano and Greer, Triangle scan conversion using 2D homogeneous
coordinates, 1997): a sample is inside when its ray is on the inner side of all three, and 1/z is linear in the image,
so triangles that reach behind the camera need no clipping. Neighbours share bit-equal edges: no cracks.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

SAMPLES = 4
# A rotated grid: no two samples of a pixel share a row or a column.
SAMPLE_X = (-0.125, 0.375, -0.375, 0.125)
SAMPLE_Y = (-0.375, -0.125, 0.125, 0.375)
_NEAR = 0.2  # metres; nothing closer is drawn
# Twice the area of a triangle, in the units of the plane: smaller ones are seen edge on, or are a line.
_MIN_DETERMINANT = 1e-9


@njit(cache=True, inline="always")
def _extend(box: Buffer, x: float, y: float) -> None:
    box[0] = min(box[0], x)
    box[1] = max(box[1], x)
    box[2] = min(box[2], y)
    box[3] = max(box[3], y)


@njit(cache=True, error_model="numpy")
def _bounds(v: Buffer, box: Buffer) -> bool:
    """Pixel bounds of the part of triangle v (3, 3) in front of the near plane; False if there is none."""
    box[0] = box[2] = 1e9
    box[1] = box[3] = -1e9
    for i in range(3):
        z = v[i, 2]
        if z >= _NEAR:
            _extend(box, v[i, 0] / z, v[i, 1] / z)
        j = (i + 1) % 3
        if (z >= _NEAR) != (v[j, 2] >= _NEAR):
            t = (_NEAR - z) / (v[j, 2] - z)
            _extend(box, (v[i, 0] + t * (v[j, 0] - v[i, 0])) / _NEAR, (v[i, 1] + t * (v[j, 1] - v[i, 1])) / _NEAR)
    return box[0] <= box[1]


@njit(cache=True, error_model="numpy")
def _edges(v: Buffer, e: Buffer) -> bool:
    """Edge planes (rows 0-2) and the 1/z plane (row 3) of triangle v; False if it is seen edge on."""
    for i in range(3):
        a, b = v[(i + 1) % 3], v[(i + 2) % 3]
        e[i, 0] = a[1] * b[2] - a[2] * b[1]
        e[i, 1] = a[2] * b[0] - a[0] * b[2]
        e[i, 2] = a[0] * b[1] - a[1] * b[0]
    det = v[0, 0] * e[0, 0] + v[0, 1] * e[0, 1] + v[0, 2] * e[0, 2]
    if abs(det) < _MIN_DETERMINANT:
        return False
    if det < 0:
        e[:3] *= -1.0
        det = -det
    for k in range(3):
        e[3, k] = (e[0, k] + e[1, k] + e[2, k]) / det
    return True


@njit(cache=True, inline="always", error_model="numpy")
def _span(e: Buffer, y: int, low: float, high: float) -> tuple[float, float]:
    """Columns of row y that can be inside all edges, one pixel generous."""
    left, right = low, high
    for i in range(3):
        a, c = e[i, 0], e[i, 1] * y + e[i, 2]
        slack = abs(e[i, 1]) * 0.5
        if a > 1e-12:
            left = max(left, (-c - slack) / a - 1.0)
        elif a < -1e-12:
            right = min(right, (-c - slack) / a + 1.0)
    return left, right


@njit(cache=True, inline="always", error_model="numpy")
def _covered(e: Buffer, x: int, y: int) -> int:
    """Bits of the samples of pixel (x, y) that are inside all edges."""
    bits = 15
    for i in range(3):
        a, b = e[i, 0], e[i, 1]
        middle, slack = a * x + b * y + e[i, 2], 0.375 * (abs(a) + abs(b))
        if middle < -slack:
            return 0
        if middle < slack:
            for k in range(4):
                if middle + (a * SAMPLE_X[k] + b * SAMPLE_Y[k]) < 0.0:
                    bits &= ~(1 << k)
    return bits


@njit(cache=True, error_model="numpy")
def _fill(e: Buffer, box: Buffer, triangle: int, inverse_depth: Buffer, ids: Buffer) -> None:
    """Write one triangle into the sample buffers (H, W, 4) where it is nearest."""
    height, width = ids.shape[:2]
    a, b = e[3, 0], e[3, 1]
    # No sample is farther than 0.375 from its pixel's centre in x or y.
    first, last = max(0.0, np.ceil(box[0] - 0.375)), min(width - 1.0, np.floor(box[1] + 0.375))
    for y in range(max(0, int(np.ceil(box[2] - 0.375))), min(height - 1, int(np.floor(box[3] + 0.375))) + 1):
        left, right = first, last
        if last - first > 4.0:
            left, right = _span(e, y, first, last)
        for x in range(int(np.ceil(left)), int(np.floor(right)) + 1):
            bits = _covered(e, x, y)
            if bits == 0:
                continue
            middle = a * x + b * y + e[3, 2]
            for k in range(4):
                near = np.float32(middle + (a * SAMPLE_X[k] + b * SAMPLE_Y[k]))
                if bits >> k & 1 and near > inverse_depth[y, x, k] and near < 1.0 / _NEAR:
                    inverse_depth[y, x, k] = near
                    ids[y, x, k] = triangle


@njit(cache=True, inline="always", error_model="numpy")
def _project(corners: Buffer, t: int, P: Buffer, v: Buffer) -> None:
    """Write the homogeneous pixels of the corners of triangle t into v (3, 3)."""
    for i in range(3):
        x, y, z = corners[t, i, 0], corners[t, i, 1], corners[t, i, 2]
        for k in range(3):
            v[i, k] = P[k, 0] * x + P[k, 1] * y + P[k, 2] * z + P[k, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def rasterize(corners: Buffer, ranges: Buffer, P: Buffer, inverse_depth: Buffer, ids: Buffer) -> None:
    """Draw triangles of `corners` (T, 3, 3) float32 through P into the sample buffers, which are not cleared.

    Args:
        corners: triangles in the town frame, metres.
        ranges: (R, 2) first and past-last triangle of each cluster; fastest sorted from near to far.
        P: (3, 4) float64, town to homogeneous pixels.
        inverse_depth: (H, W, 4) float32, 1/m, 0 where nothing was drawn; raised here.
        ids: (H, W, 4) int32 row of the nearest triangle; written here.
    """
    height, width = ids.shape[:2]
    v, e, box = np.empty((3, 3)), np.empty((4, 3)), np.empty(4)
    for r in range(len(ranges)):
        for t in range(ranges[r, 0], ranges[r, 1]):
            _project(corners, t, P, v)
            if not _bounds(v, box) or box[1] < -1 or box[0] > width or box[3] < -1 or box[2] > height:
                continue
            if _edges(v, e):
                _fill(e, box, t, inverse_depth, ids)


@njit(cache=True, nogil=True, error_model="numpy")
def rasterize_from_sun(corners: Buffer, axes: Buffer, origin: Buffer, cell: float, height_map: Buffer) -> None:
    """Write the height towards the sun of the nearest surface into each cell of a plane perpendicular to the sun.

    Args:
        corners: (T, 3, 3) float32 triangles, metres.
        axes: (3, 3) rows: right, up, towards the sun.
        origin: (2,) right and up of the first cell, metres.
        cell: side of a cell, metres.
        height_map: (rows, columns) float32, filled with -inf by the caller, raised here.
    """
    rows, columns = height_map.shape
    q = np.empty((3, 3))
    for t in range(len(corners)):
        for i in range(3):
            for k in range(3):
                q[i, k] = axes[k, 0] * corners[t, i, 0] + axes[k, 1] * corners[t, i, 1] + axes[k, 2] * corners[t, i, 2]
            q[i, 0] = (q[i, 0] - origin[0]) / cell
            q[i, 1] = (q[i, 1] - origin[1]) / cell
        _fill_height(q, rows, columns, height_map)


@njit(cache=True, error_model="numpy")
def _fill_height(q: Buffer, rows: int, columns: int, height_map: Buffer) -> None:
    """Raise the height map to one triangle q (3, 3): column, row, height."""
    det = (q[1, 0] - q[0, 0]) * (q[2, 1] - q[0, 1]) - (q[1, 1] - q[0, 1]) * (q[2, 0] - q[0, 0])
    if abs(det) < _MIN_DETERMINANT:
        return
    x0, x1 = max(0, int(np.ceil(q[:, 0].min()))), min(columns - 1, int(np.floor(q[:, 0].max())))
    y0, y1 = max(0, int(np.ceil(q[:, 1].min()))), min(rows - 1, int(np.floor(q[:, 1].max())))
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            b1 = ((x - q[0, 0]) * (q[2, 1] - q[0, 1]) - (y - q[0, 1]) * (q[2, 0] - q[0, 0])) / det
            b2 = ((q[1, 0] - q[0, 0]) * (y - q[0, 1]) - (q[1, 1] - q[0, 1]) * (x - q[0, 0])) / det
            if b1 >= 0.0 and b2 >= 0.0 and b1 + b2 <= 1.0:
                w = q[0, 2] + b1 * (q[1, 2] - q[0, 2]) + b2 * (q[2, 2] - q[0, 2])
                height_map[y, x] = max(height_map[y, x], np.float32(w))
