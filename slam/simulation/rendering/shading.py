"""Shading: the light that each pixel receives from textures, shadows, sun and sky; compiled.

An image row is shaded in passes over its samples: gather the visible surfaces, cast rays, paint, light, resolve. Each
pass takes the arrays that it needs out of their tuples before its loop: taking one out counts references, which inside
the loop costs more than the arithmetic.

The brightness of a surface is the mean of its texture under the footprint of a pixel. Textures are mip-mapped
(Williams, Pyramidal parametrics, 1983) and sampled along the longer axis of the footprint, so that road and facades
seen at a grazing angle neither flicker nor blur away.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slam.simulation.rendering.rasterizer import SAMPLE_X, SAMPLE_Y, SAMPLES

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type
Vector = tuple[float, float, float]

# Columns of the material table.
TEXTURE, DETAIL, DETAIL_U, DETAIL_V, DETAIL_STRENGTH, GLOSS, LEAF = range(7)
# Columns of the table of triangle attributes: gradient of the texture coordinate u in space (3) and its value at the
# origin, the same for v, unit normal (3), tint.
U_GRADIENT, U_OFFSET, V_GRADIENT, V_OFFSET, NORMAL, TINT = 0, 3, 4, 7, 8, 11
ATTRIBUTES = 12
# Columns of the texture table.
_POWER, _HAS_GLOSS, _START = range(3)
SKY = -1  # triangle of a sample that hits nothing
_HAZE_LENGTH_M = 900.0  # distance after which 1/e of the contrast is left
_SHADOW_BIAS_M = 0.12  # more than a cell of the shadow map, against surfaces that shadow themselves
_MIN_COSINE = 0.02  # of the angle between view and normal: bounds the length of the footprint to 50 pixel widths
_MIN_GLOSS = 0.02  # weaker reflections are invisible and cost a look at the sky
# Shift of the detail texture per unit of tint: houses of the same front, which differ in tint, get different stains.
_DETAIL_SHIFT = 37.0
_MAX_TAPS = 4.0  # samples along a footprint; a longer footprint is read from a coarser level of the texture
_MIN_BLEND = 0.05  # share of the coarser level below which it is not read, to save time


class Footprint(NamedTuple):
    """Area of a texture that a pixel covers, in tiles.

    Attributes:
        u, v: centre.
        du, dv: vector of the long axis.
        short, long: lengths of both axes.
    """

    u: float
    v: float
    du: float
    dv: float
    short: float
    long: float


class SampleBuffers(NamedTuple):
    """Output of the rasteriser.

    Attributes:
        inverse_depth: (H, W, 4) float32, 1/m, of the nearest triangle at each sample.
        triangle: (H, W, 4) int32 row of that triangle, or -1 for the sky.
    """

    inverse_depth: Buffer
    triangle: Buffer


class Viewpoint(NamedTuple):
    """Camera of an image.

    Attributes:
        Q: (3, 3) from homogeneous pixels to directions with unit depth in the town frame.
        center: (3,) position in the town frame, metres.
        pixel_angle: width of a pixel at a distance of one metre, metres.
    """

    Q: Buffer
    center: Buffer
    pixel_angle: float


class Surfaces(NamedTuple):
    """Triangles in view and their materials.

    Attributes:
        attributes: (T, 12) float32, columns as above.
        material: (T,) row of the material table.
        materials: (M, 7) material table, columns as above.
        texels, gloss: (B,) uint8, brightness and gloss of all textures at all levels.
        textures: (K, 3) int64: binary logarithm of the side, whether it has gloss, index of the first texel.
    """

    attributes: Buffer
    material: Buffer
    materials: Buffer
    texels: Buffer
    gloss: Buffer
    textures: Buffer


class ShadowMap(NamedTuple):
    """Height, in the direction of the sun, of the surface nearest to the sun.

    Attributes:
        axes: (3, 3) rows: right, up and towards the sun, in the town frame.
        origin: (2,) right and up of the first cell, metres.
        cell_m: side of a cell.
        heights: (rows, columns) float32 metres.
    """

    axes: Buffer
    origin: Buffer
    cell_m: float
    heights: Buffer


class Lighting(NamedTuple):
    """Sun, sky and shadows.

    Attributes:
        to_sun: (3,) unit vector, town frame.
        sun, ambient, haze: light of the sun, of the sky, and of distant air.
        panorama: (rows, columns) light of the sky, rows from zenith to nadir, columns around.
        shadow: shadow map for this position of the sun.
    """

    to_sun: Buffer
    sun: float
    ambient: float
    haze: float
    panorama: Buffer
    shadow: ShadowMap


class RowSamples(NamedTuple):
    """Samples of an image row, one for each triangle that a pixel shows.

    Attributes:
        triangle: (N,) int32 row of the triangle, or -1 for the sky.
        pixel: (N,) int32 column of the pixel.
        share: (N,) share of the pixel, 0.25 to 1.
        position: (2, N) x and y of the sample in the image, pixels.
        direction: (3, N) ray with unit depth, town frame.
        point: (3, N) where the ray meets the triangle, metres, town frame.
        depth: (N,) along the optical axis, metres.
        value: (N,) brightness of the surface, then its light.
        gloss: (N,) share of light that is reflected like in a mirror.
    """

    triangle: Buffer
    pixel: Buffer
    share: Buffer
    position: Buffer
    direction: Buffer
    point: Buffer
    depth: Buffer
    value: Buffer
    gloss: Buffer


@njit(cache=True, error_model="numpy")
def sample_panorama(panorama: Buffer, dx: float, dy: float, dz: float) -> float:
    """Brightness of the panorama (rows from zenith to nadir, columns around) in a direction."""
    rows, columns = panorama.shape
    x = (np.arctan2(dy, dx) / (2.0 * np.pi) + 0.5) * columns
    y = (0.5 - np.arctan2(dz, np.sqrt(dx * dx + dy * dy)) / np.pi) * rows - 0.5
    x0, y0 = int(np.floor(x)), min(max(int(np.floor(y)), 0), rows - 2)
    ax, ay = x - x0, min(max(y - y0, 0.0), 1.0)
    xa, xb = x0 % columns, (x0 + 1) % columns
    low = panorama[y0, xa] * (1.0 - ax) + panorama[y0, xb] * ax
    return low * (1.0 - ay) + (panorama[y0 + 1, xa] * (1.0 - ax) + panorama[y0 + 1, xb] * ax) * ay


@njit(cache=True, inline="always", error_model="numpy")
def _bilinear(texels: Buffer, start: int, power: int, u: float, v: float) -> Any:
    """Value 0..255 at (u, v) tiles of the square level that starts at `start`, 2^power wide."""
    size = 1 << power
    x, y = u * size - 0.5, v * size - 0.5
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = np.float32(x - fx), np.float32(y - fy)
    mask = size - 1
    x0, y0 = np.int64(fx) & mask, np.int64(fy) & mask
    x1 = (x0 + 1) & mask
    below, above = start + (y0 << power), start + (((y0 + 1) & mask) << power)
    a, b = np.float32(texels[below + x0]), np.float32(texels[below + x1])
    c, d = np.float32(texels[above + x0]), np.float32(texels[above + x1])
    low = a + ax * (b - a)
    return low + ay * (c + ax * (d - c) - low)


@njit(cache=True, error_model="numpy")
def sample_anisotropic(texels: Buffer, start: int, power: int, footprint: Footprint) -> Any:
    """Mean brightness 0..1 of a texture over a footprint, by several samples along the long axis.

    Args:
        texels: (B,) uint8, the levels of all textures one after the other.
        start: index of the first texel of the texture's finest level.
        power: binary logarithm of the side of the finest level.
        footprint: area of the texture that the pixel covers.
    """
    u, v, du, dv, short, long = footprint
    blur = max(short, long / _MAX_TAPS) * (1 << power)
    if blur <= 1.0:
        return _bilinear(texels, start, power, u, v) / np.float32(255.0)
    taps = max(1, int(min(_MAX_TAPS, long / max(short, 1e-9)) + 0.5))
    level = min(np.log2(blur), power - 0.001)
    if taps > 2:
        level = np.floor(level + 0.5)  # at grazing angles the seam between levels is hidden by the taps' own blur
    whole = min(int(level), power - 1)
    for _ in range(whole):
        start += 1 << (2 * power)
        power -= 1
    part = np.float32(level - whole)
    total = np.float32(0.0)
    for k in range(taps):
        t = (k + 0.5) / taps - 0.5
        fine = _bilinear(texels, start, power, u + t * du, v + t * dv)
        if part > _MIN_BLEND:
            coarse = _bilinear(texels, start + (1 << (2 * power)), power - 1, u + t * du, v + t * dv)
            fine += part * (coarse - fine)
        total += fine
    return total / np.float32(255.0 * taps)


@njit(cache=True, error_model="numpy")
def sample_isotropic(texels: Buffer, start: int, power: int, footprint: Footprint) -> Any:
    """Brightness 0..1 of a texture by a single sample, at the level of the footprint's mean width.

    Args:
        texels: (B,) uint8, as for `sample_anisotropic`.
        start: index of the first texel of the finest level.
        power: binary logarithm of the side of the finest level.
        footprint: area of the texture that the pixel covers.
    """
    blur = np.sqrt(footprint.short * footprint.long) * (1 << power)
    # Levels change half way between powers of two. There is no blending: details are too faint for a seam to show.
    while blur > 1.41 and power > 0:
        blur *= 0.5
        start += 1 << (2 * power)
        power -= 1
    return _bilinear(texels, start, power, footprint.u, footprint.v) / np.float32(255.0)


@njit(cache=True, error_model="numpy")
def _count_equal(ids: tuple[int, int, int, int], k: int) -> int:
    """Number of samples of a pixel that show the triangle of sample k, or 0 if an earlier sample shows it too."""
    count = 0
    for j in range(SAMPLES):
        if ids[j] == ids[k]:
            if j < k:
                return 0
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def gather_samples(y: int, buffers: SampleBuffers, samples: RowSamples) -> int:
    """List what row y shows, one sample for each distinct triangle of a pixel; return their number."""
    ids, near = buffers.triangle, buffers.inverse_depth
    triangle, pixel, share, depth = samples.triangle, samples.pixel, samples.share, samples.depth
    position = samples.position
    n = 0
    for x in range(ids.shape[1]):
        pixel_ids = (ids[y, x, 0], ids[y, x, 1], ids[y, x, 2], ids[y, x, 3])
        if _count_equal(pixel_ids, 0) == SAMPLES:
            # 1/z is linear in the image, so the mean of the four samples is the value at the pixel's centre.
            mean = (np.float64(near[y, x, 0]) + near[y, x, 1] + near[y, x, 2] + near[y, x, 3]) / 4.0
            triangle[n], pixel[n], share[n], depth[n] = pixel_ids[0], x, 1.0, 1.0 / mean
            position[0, n], position[1, n] = float(x), float(y)
            n += 1
            continue
        for k in range(SAMPLES):
            count = _count_equal(pixel_ids, k)
            if count > 0:
                triangle[n], pixel[n], share[n], depth[n] = (
                    pixel_ids[k],
                    x,
                    count / 4.0,
                    1.0 / np.float64(near[y, x, k]),
                )
                position[0, n], position[1, n] = float(x) + SAMPLE_X[k], float(y) + SAMPLE_Y[k]
                n += 1
    return n


@njit(cache=True, error_model="numpy")
def cast_rays(n: int, view: Viewpoint, samples: RowSamples) -> None:
    """Fill in the rays of n samples and where they meet their triangles."""
    Q, center, position, depth = view.Q, view.center, samples.position, samples.depth
    direction, point = samples.direction, samples.point
    for s in range(n):
        x, y = position[0, s], position[1, s]
        for i in range(3):
            d = Q[i, 0] * x + Q[i, 1] * y + Q[i, 2]
            direction[i, s] = d
            point[i, s] = center[i] + d * depth[s]


@njit(cache=True, error_model="numpy")
def _footprint(direction: Vector, point: Vector, width: float, attributes: Buffer, t: int) -> Footprint:
    r"""Footprint of a pixel on a triangle.

    The pixel is a cone about the ray d, `width` metres wide where it meets the surface, at an angle a to the normal n:

        camera
             \ \
              \ \  width w      n
               \ \              |
                \ \             |
        =========[---]==========+====>  e = d - (d . n) n
               w / cos a

    e has the length sin a and leads along the surface, away from the camera: the long axis. The short axis b = n x e is
    square to the page, and there the footprint is w wide. The gradients of u and v turn both from metres into tiles.

    Args:
        direction: ray, of any length, town frame.
        point: where the ray meets the triangle, metres, town frame.
        width: of the cone at the surface, metres.
        attributes: (T, 12) of all triangles.
        t: row of the triangle.
    """
    (dx, dy, dz), (px, py, pz) = direction, point
    u0, u1, u2 = attributes[t, U_GRADIENT], attributes[t, U_GRADIENT + 1], attributes[t, U_GRADIENT + 2]
    v0, v1, v2 = attributes[t, V_GRADIENT], attributes[t, V_GRADIENT + 1], attributes[t, V_GRADIENT + 2]
    nx, ny, nz = attributes[t, NORMAL], attributes[t, NORMAL + 1], attributes[t, NORMAL + 2]
    norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    cosine = (dx * nx + dy * ny + dz * nz) * norm
    ex, ey, ez = dx * norm - cosine * nx, dy * norm - cosine * ny, dz * norm - cosine * nz
    bx, by, bz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
    # e and b are both sin a long: dividing by that length gives them the lengths of the footprint.
    across = width / max(np.sqrt(ex * ex + ey * ey + ez * ez), 1e-6)
    stretch = across / max(abs(cosine), _MIN_COSINE)
    du, dv = (u0 * ex + u1 * ey + u2 * ez) * stretch, (v0 * ex + v1 * ey + v2 * ez) * stretch
    bu, bv = (u0 * bx + u1 * by + u2 * bz) * across, (v0 * bx + v1 * by + v2 * bz) * across
    long, short = np.sqrt(du * du + dv * dv), np.sqrt(bu * bu + bv * bv)
    if long < short:  # a texture may be stretched more across the view than along it
        du, dv, long, short = bu, bv, short, long
    u = u0 * px + u1 * py + u2 * pz + attributes[t, U_OFFSET]
    v = v0 * px + v1 * py + v2 * pz + attributes[t, V_OFFSET]
    return Footprint(u, v, du, dv, short, long)


@njit(cache=True, error_model="numpy")
def paint_samples(n: int, pixel_angle: float, surfaces: Surfaces, samples: RowSamples) -> None:
    """Fill in brightness and gloss of the surfaces that n samples show."""
    attributes, material, materials = surfaces.attributes, surfaces.material, surfaces.materials
    texels, gloss_texels, textures = surfaces.texels, surfaces.gloss, surfaces.textures
    triangle, direction, point, depth = samples.triangle, samples.direction, samples.point, samples.depth
    values, glosses = samples.value, samples.gloss
    for i in range(n):
        t = triangle[i]
        if t == SKY:
            continue
        ray, at = (direction[0, i], direction[1, i], direction[2, i]), (point[0, i], point[1, i], point[2, i])
        footprint = _footprint(ray, at, depth[i] * pixel_angle, attributes, t)
        m, tint = material[t], np.float64(attributes[t, TINT])
        k = int(materials[m, TEXTURE])
        start, power = textures[k, _START], textures[k, _POWER]
        value = tint * sample_anisotropic(texels, start, power, footprint)
        gloss = materials[m, GLOSS]
        if textures[k, _HAS_GLOSS]:
            gloss = max(gloss, float(sample_isotropic(gloss_texels, start, power, footprint)))
        strength = materials[m, DETAIL_STRENGTH]
        if strength > 0.0:
            k = int(materials[m, DETAIL])
            spot = _scale(footprint, materials[m, DETAIL_U], materials[m, DETAIL_V], _DETAIL_SHIFT * tint)
            detail = sample_isotropic(texels, textures[k, _START], textures[k, _POWER], spot)
            value *= 1.0 + strength * (2.0 * detail - 1.0)
        values[i], glosses[i] = value, gloss


@njit(cache=True, error_model="numpy")
def _scale(footprint: Footprint, su: float, sv: float, shift: float) -> Footprint:
    """Footprint in tiles of a detail texture; one tile of the material's texture has (su, sv) of them."""
    scale = max(su, sv)
    return Footprint(
        footprint.u * su + shift,
        footprint.v * sv + shift,
        footprint.du * su,
        footprint.dv * sv,
        scale * footprint.short,
        scale * footprint.long,
    )


@njit(cache=True, error_model="numpy")
def _sunlit(point: Vector, axes: Buffer, origin: Buffer, cell_m: float, heights: Buffer) -> float:
    """Share 0..1 of the sun that reaches a point, metres, by the four cells of the shadow map around it."""
    px, py, pz = point
    x = (axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz - origin[0]) / cell_m
    y = (axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz - origin[1]) / cell_m
    if not (x >= 0.0 and y >= 0.0 and x < heights.shape[1] - 1 and y < heights.shape[0] - 1):
        return 1.0
    x0, y0 = int(x), int(y)
    height = axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz + _SHADOW_BIAS_M
    ax, ay = x - x0, y - y0
    low = (height >= heights[y0, x0]) * (1.0 - ax) + (height >= heights[y0, x0 + 1]) * ax
    high = (height >= heights[y0 + 1, x0]) * (1.0 - ax) + (height >= heights[y0 + 1, x0 + 1]) * ax
    return low * (1.0 - ay) + high * ay


@njit(cache=True, error_model="numpy")
def _slope(normal: Vector, to_sun: Buffer, is_leaf: bool) -> float:
    """Cosine of the angle between normal and sun; leaves, which light shines through, are lit from all sides."""
    slope = normal[0] * to_sun[0] + normal[1] * to_sun[1] + normal[2] * to_sun[2]
    return 0.3 + 0.5 * abs(slope) if is_leaf else slope


@njit(cache=True, error_model="numpy")
def _sky_light(ambient: float, z: float, nz: float) -> float:
    """Light of the sky at a height z, metres: the ground hides half of the sky from walls, and darkens their feet."""
    open_sky = min(max(z, 0.0) / 1.5 + max(nz, 0.0), 1.0)
    return ambient * (0.65 + 0.35 * nz) * (0.72 + 0.28 * open_sky)


@njit(cache=True, error_model="numpy")
def _light(n: int, surfaces: Surfaces, lighting: Lighting, samples: RowSamples) -> None:
    """Turn the surface brightness of n samples into the light that reaches the camera."""
    attributes, material, materials = surfaces.attributes, surfaces.material, surfaces.materials
    to_sun, sun, ambient, haze, panorama, shadow = lighting
    axes, origin, cell_m, heights = shadow
    triangle, direction, point, depth = samples.triangle, samples.direction, samples.point, samples.depth
    values, glosses = samples.value, samples.gloss
    for i in range(n):
        t = triangle[i]
        dx, dy, dz = direction[0, i], direction[1, i], direction[2, i]
        if t == SKY:
            values[i] = sample_panorama(panorama, dx, dy, dz)
            continue
        nx, ny, nz = attributes[t, NORMAL], attributes[t, NORMAL + 1], attributes[t, NORMAL + 2]
        facing = dx * nx + dy * ny + dz * nz
        if facing > 0.0:  # triangles have two sides: the one that the camera sees is lit
            nx, ny, nz, facing = -nx, -ny, -nz, -facing
        at = (point[0, i], point[1, i], point[2, i])
        lit = _slope((nx, ny, nz), to_sun, materials[material[t], LEAF] > 0.0)
        lit = lit * _sunlit(at, axes, origin, cell_m, heights) if lit > 0.0 else 0.0
        value = values[i] * (_sky_light(ambient, at[2], nz) + sun * lit)
        if glosses[i] > _MIN_GLOSS:
            # Schlick's approximation of Fresnel's law, softened.
            cosine = 1.0 + facing / np.sqrt(dx * dx + dy * dy + dz * dz)
            mirror = glosses[i] * (0.12 + 0.88 * cosine * cosine * cosine * cosine)
            sky = sample_panorama(panorama, dx - 2 * facing * nx, dy - 2 * facing * ny, dz - 2 * facing * nz)
            value += mirror * (sky - value)
        fade = np.exp(-depth[i] / _HAZE_LENGTH_M)
        values[i] = value * fade + haze * (1.0 - fade)


@njit(cache=True, error_model="numpy")
def allocate_samples(count: int) -> RowSamples:
    """Make room for the samples of a row."""
    return RowSamples(
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count),
        np.empty((2, count)),
        np.empty((3, count)),
        np.empty((3, count)),
        np.empty(count),
        np.empty(count),
        np.empty(count),
    )


@njit(cache=True, error_model="numpy")
def resolve_samples(n: int, samples: RowSamples, image: Buffer, depth: Buffer) -> None:
    """Combine n samples to the pixels of an image row (W,): mean light, and depth of the nearest surface."""
    triangle, pixel, share, value, z = samples.triangle, samples.pixel, samples.share, samples.value, samples.depth
    image[:], depth[:] = 0.0, np.inf
    for i in range(n):
        x = pixel[i]
        image[x] += np.float32(share[i] * value[i])
        # The mean depth across an edge would lie on neither side of it.
        if triangle[i] != SKY:
            depth[x] = min(depth[x], np.float32(z[i]))


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    buffers: SampleBuffers, view: Viewpoint, surfaces: Surfaces, lighting: Lighting, image: Buffer, depth: Buffer
) -> None:
    """Write the light of every pixel into `image` and its depth, metres, into `depth`, (H, W) float32 each."""
    height, width = image.shape
    samples = allocate_samples(SAMPLES * width)
    for y in range(height):
        n = gather_samples(y, buffers, samples)
        cast_rays(n, view, samples)
        paint_samples(n, view.pixel_angle, surfaces, samples)
        _light(n, surfaces, lighting, samples)
        resolve_samples(n, samples, image[y], depth[y])
