"""What a visible triangle looks like: compiled paint, shadow and light.

An image row is shaded in passes over its samples: compiled passes with few arrays each are several times
faster than one call per sample.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slam.simulation.lookup import along, grain
from slam.simulation.rasterizer import SAMPLE_X, SAMPLE_Y

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

# Columns of the material table.
TEXTURE, DETAIL, DETAIL_U, DETAIL_V, DETAIL_STRENGTH, GLOSS, LEAF = range(7)
# Entries of the light vector: towards the sun (3), then strengths.
SUN, AMBIENT, HAZE = 3, 4, 5
# Rows of the work table, one column a sample: ray direction (3), point (3), depth, share of the pixel,
# value, gloss.
_D, _P, _Z, _SHARE, _VALUE, _GLOSS = 0, 3, 6, 7, 8, 9
WORK_ROWS = 10
_HAZE_LENGTH = 900.0  # metres after which 1/e of the contrast is left
_SHADOW_BIAS = 0.12  # metres, against surfaces shadowing themselves


@njit(cache=True, error_model="numpy")
def _sky(panorama: Buffer, dx: float, dy: float, dz: float) -> float:
    """Brightness of the panorama (rows from zenith to nadir, columns around) in a direction."""
    rows, columns = panorama.shape
    x = (np.arctan2(dy, dx) / (2.0 * np.pi) + 0.5) * columns
    y = (0.5 - np.arctan2(dz, np.sqrt(dx * dx + dy * dy)) / np.pi) * rows - 0.5
    x0, y0 = int(np.floor(x)), min(max(int(np.floor(y)), 0), rows - 2)
    ax, ay = x - x0, min(max(y - y0, 0.0), 1.0)
    xa, xb = x0 % columns, (x0 + 1) % columns
    low = panorama[y0, xa] * (1.0 - ax) + panorama[y0, xb] * ax
    return low * (1.0 - ay) + (panorama[y0 + 1, xa] * (1.0 - ax) + panorama[y0 + 1, xb] * ax) * ay


@njit(cache=True, error_model="numpy")
def _gather(
    y: int,
    inverse_depth: Buffer,
    ids: Buffer,
    Q: Buffer,
    centre: Buffer,
    work: Buffer,
    triangle: Buffer,
    pixel: Buffer,
) -> int:
    """List what row y shows, one sample for each distinct triangle of a pixel; return their number."""
    n = 0
    for x in range(ids.shape[1]):
        t0, t1, t2, t3 = ids[y, x, 0], ids[y, x, 1], ids[y, x, 2], ids[y, x, 3]
        same = t0 == t1 and t0 == t2 and t0 == t3
        for k in range(1 if same else 4):
            t = ids[y, x, k]
            if (k > 0 and t == t0) or (k > 1 and t == t1) or (k > 2 and t == t2):
                continue
            u, w, near = float(x), float(y), np.float64(inverse_depth[y, x, k])
            if same:  # 1/z is linear in the image, so the mean is the value at the centre
                near = (near + inverse_depth[y, x, 1] + inverse_depth[y, x, 2] + inverse_depth[y, x, 3]) / 4.0
            else:
                u, w = u + SAMPLE_X[k], w + SAMPLE_Y[k]
            z = 1.0 / near if t >= 0 else 1.0
            triangle[n], pixel[n] = t, x
            work[_SHARE, n] = ((t0 == t) + (t1 == t) + (t2 == t) + (t3 == t)) / 4.0
            work[_Z, n] = z
            for i in range(3):
                d = Q[i, 0] * u + Q[i, 1] * w + Q[i, 2]
                work[_D + i, n] = d
                work[_P + i, n] = centre[i] + d * z
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def _paint(
    n: int,
    scale: float,
    attributes: Buffer,
    material: Buffer,
    table: Buffer,
    texels: Buffer,
    gloss: Buffer,
    textures: Buffer,
    triangle: Buffer,
    work: Buffer,
) -> None:
    """Fill in painted brightness and gloss of n samples; `scale` is the size of a pixel at one metre."""
    for i in range(n):
        t = triangle[i]
        if t < 0:
            continue
        m = material[t]
        g0, g1, g2, g4 = attributes[t, 0], attributes[t, 1], attributes[t, 2], attributes[t, 4]
        g5, g6, nx, ny, nz = (
            attributes[t, 5],
            attributes[t, 6],
            attributes[t, 8],
            attributes[t, 9],
            attributes[t, 10],
        )
        tint = np.float64(attributes[t, 11])
        dx, dy, dz = work[_D, i], work[_D + 1, i], work[_D + 2, i]
        # The pixel's footprint: long axis e within the surface along the view, short axis b across it.
        norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (dx * nx + dy * ny + dz * nz) * norm
        ex, ey, ez = dx * norm - cosine * nx, dy * norm - cosine * ny, dz * norm - cosine * nz
        width = work[_Z, i] * scale
        across = width / max(np.sqrt(ex * ex + ey * ey + ez * ez), 1e-6)
        stretch = across / max(abs(cosine), 0.02)
        bx, by, bz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        du, dv = (g0 * ex + g1 * ey + g2 * ez) * stretch, (g4 * ex + g5 * ey + g6 * ez) * stretch
        bu, bv = (g0 * bx + g1 * by + g2 * bz) * across, (g4 * bx + g5 * by + g6 * bz) * across
        long, short = np.sqrt(du * du + dv * dv), np.sqrt(bu * bu + bv * bv)
        if long < short:
            du, dv, long, short = bu, bv, short, long
        u = g0 * work[_P, i] + g1 * work[_P + 1, i] + g2 * work[_P + 2, i] + attributes[t, 3]
        v = g4 * work[_P, i] + g5 * work[_P + 1, i] + g6 * work[_P + 2, i] + attributes[t, 7]
        k = int(table[m, TEXTURE])
        value = tint * along(texels, textures[k, 2], textures[k, 0], u, v, du, dv, short, long)
        shine = table[m, GLOSS]
        if textures[k, 1]:
            shine = max(shine, float(grain(gloss, textures[k, 2], textures[k, 0], u, v, short, long)))
        strength = table[m, DETAIL_STRENGTH]
        if strength > 0.0:
            k = int(table[m, DETAIL])
            su, sv = table[m, DETAIL_U], table[m, DETAIL_V]
            most = max(su, sv)
            # Each tint starts elsewhere, so that equal houses are stained differently.
            u, v = u * su + 37.0 * tint, v * sv + 37.0 * tint
            spots = grain(texels, textures[k, 2], textures[k, 0], u, v, most * short, most * long)
            value *= 1.0 + strength * (2.0 * spots - 1.0)
        work[_VALUE, i], work[_GLOSS, i] = value, shine


@njit(cache=True, error_model="numpy")
def _sunlit(px: float, py: float, pz: float, axes: Buffer, place: Buffer, heights: Buffer) -> float:
    """Share 0..1 of the sun that reaches a point, metres, by four neighbouring cells of the height map."""
    x = (axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz - place[0]) / place[2]
    y = (axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz - place[1]) / place[2]
    if not (x >= 0.0 and y >= 0.0 and x < heights.shape[1] - 1 and y < heights.shape[0] - 1):
        return 1.0
    x0, y0 = int(x), int(y)
    height = axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz + _SHADOW_BIAS
    ax, ay = x - x0, y - y0
    low = (height >= heights[y0, x0]) * (1.0 - ax) + (height >= heights[y0, x0 + 1]) * ax
    high = (height >= heights[y0 + 1, x0]) * (1.0 - ax) + (height >= heights[y0 + 1, x0 + 1]) * ax
    return low * (1.0 - ay) + high * ay


@njit(cache=True, error_model="numpy")
def _light(
    n: int,
    attributes: Buffer,
    material: Buffer,
    table: Buffer,
    axes: Buffer,
    place: Buffer,
    heights: Buffer,
    light: Buffer,
    panorama: Buffer,
    triangle: Buffer,
    work: Buffer,
) -> None:
    """Turn painted brightness into light that reaches the camera, for n samples."""
    for i in range(n):
        t = triangle[i]
        dx, dy, dz = work[_D, i], work[_D + 1, i], work[_D + 2, i]
        if t < 0:
            work[_VALUE, i] = _sky(panorama, dx, dy, dz)
            continue
        nx, ny, nz = attributes[t, 8], attributes[t, 9], attributes[t, 10]
        facing = dx * nx + dy * ny + dz * nz
        if facing > 0.0:
            nx, ny, nz, facing = -nx, -ny, -nz, -facing
        slope = nx * light[0] + ny * light[1] + nz * light[2]
        if table[material[t], LEAF] > 0.0:
            slope = 0.3 + 0.5 * abs(slope)  # light shines through leaves
        lit = 0.0
        if slope > 0.0:
            lit = slope * _sunlit(work[_P, i], work[_P + 1, i], work[_P + 2, i], axes, place, heights)
        # The ground hides half the sky from walls, and near it less light arrives.
        open_sky = min(max(work[_P + 2, i], 0.0) / 1.5 + max(nz, 0.0), 1.0)
        ambient = light[AMBIENT] * (0.65 + 0.35 * nz) * (0.72 + 0.28 * open_sky)
        value = work[_VALUE, i] * (ambient + light[SUN] * lit)
        if work[_GLOSS, i] > 0.02:
            # Schlick's approximation of Fresnel's law, softened.
            cosine = 1.0 + facing / np.sqrt(dx * dx + dy * dy + dz * dz)
            mirror = work[_GLOSS, i] * (0.12 + 0.88 * cosine * cosine * cosine * cosine)
            value += mirror * (_sky(panorama, dx - 2 * facing * nx, dy - 2 * facing * ny, dz - 2 * facing * nz) - value)
        fade = np.exp(-work[_Z, i] / _HAZE_LENGTH)
        work[_VALUE, i] = value * fade + light[HAZE] * (1.0 - fade)


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    inverse_depth: Buffer,
    ids: Buffer,
    camera: tuple[Any, ...],
    mesh: tuple[Any, ...],
    atlas: tuple[Any, ...],
    shadow: tuple[Any, ...],
    light: Buffer,
    panorama: Buffer,
    image: Buffer,
    depth: Buffer,
) -> None:
    """Light of every pixel into `image` and its depth, metres, into `depth`, (H, W) float32 each.

    inverse_depth, ids: sample buffers of the rasteriser. camera: (Q (3, 3) pixel to town direction of unit
        depth, centre (3,) metres, pixel size at one metre). mesh: (attributes (T, 12), material (T,),
        material table).
    atlas: (texels, gloss, table); shadow: (axes, place, heights); light: (6,); panorama: (rows, columns).
    """
    height, width = image.shape
    Q, centre, scale = camera
    attributes, material, table = mesh
    texels, gloss, textures = atlas
    axes, place, heights = shadow
    work = np.empty((WORK_ROWS, 4 * width))
    triangle, pixel = np.empty(4 * width, np.int32), np.empty(4 * width, np.int32)
    for y in range(height):
        n = _gather(y, inverse_depth, ids, Q, centre, work, triangle, pixel)
        _paint(n, scale, attributes, material, table, texels, gloss, textures, triangle, work)
        _light(n, attributes, material, table, axes, place, heights, light, panorama, triangle, work)
        image[y], depth[y] = 0.0, np.inf
        for i in range(n):
            image[y, pixel[i]] += np.float32(work[_SHARE, i] * work[_VALUE, i])
            # The nearest sample counts: a mean across an edge would lie on neither side.
            if triangle[i] >= 0:
                depth[y, pixel[i]] = min(depth[y, pixel[i]], np.float32(work[_Z, i]))
