"""Renders light images and depth maps of a room: the shading of `shading` with the light of `light_volume`."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.simulation.rendering.light_volume import LightVolume
from slam.simulation.rendering.rasterizer import SAMPLES, rasterize
from slam.simulation.rendering.renderer import Scene, projection_matrix, visible_ranges
from slam.simulation.rendering.shading import (
    NORMAL,
    SKY,
    Buffer,
    RowSamples,
    SampleBuffers,
    Surfaces,
    Vector,
    Viewpoint,
    allocate_samples,
    cast_rays,
    gather_samples,
    paint_samples,
    resolve_samples,
    sample_panorama,
)
from slam.simulation.world.materials import Materials

Array = NDArray[np.float64]
Image = NDArray[np.float32]
GLOW, INFRARED = 7, 8  # columns of the table of materials of a room: light of its own, and return of infrared light
_OUTDOORS = 1.7  # light of the panorama through a window, relative to a room of mean light


@dataclass(frozen=True)
class LitRoom:
    """A room with its light and its materials, which stay as they are.

    Attributes:
        scene: triangles.
        volume: light.
        panorama: (rows, columns) what is seen through windows.
        materials: textures, and the table with two columns more than that of the town.
    """

    scene: Scene
    volume: LightVolume
    panorama: Image
    materials: Materials


@dataclass(frozen=True)
class IndoorView:
    """Image of a room, (H, W) each.

    Attributes:
        light: light that reaches the camera, about 0 to 1.
        depth: metres along the axis; infinite through a window.
        returns: whether the surface returns the infrared light of a depth camera.
    """

    light: Image
    depth: Image
    returns: NDArray[np.bool_]


def render_indoors(room: LitRoom, camera: StereoCamera, T_room_camera: Array) -> IndoorView:
    """Render what one camera sees from a pose (4, 4), metres."""
    scene = room.scene
    R, centre = T_room_camera[:3, :3], T_room_camera[:3, 3]
    shape = (camera.height, camera.width)
    inverse_depth = np.zeros((*shape, SAMPLES), np.float32)
    ids = np.full((*shape, SAMPLES), SKY, np.int32)
    P = projection_matrix(camera, T_room_camera)
    rasterize(scene.corners, visible_ranges(scene, P, centre, camera), P, inverse_depth, ids)
    light, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    atlas, table = room.materials.atlas, room.materials.table
    _shade_indoors(
        SampleBuffers(inverse_depth, ids),
        Viewpoint(R @ np.linalg.inv(camera.K), centre, 1.0 / camera.fx),
        Surfaces(scene.attributes, scene.material, table, atlas.texels, atlas.gloss, atlas.table),
        room.volume,
        room.panorama,
        light,
        depth,
    )
    nearest = ids[:, :, 0]
    return IndoorView(light, depth, (nearest != SKY) & (table[scene.material[nearest], INFRARED] > 0))


@njit(cache=True, error_model="numpy")
def _trilinear(cells: Buffer, side: int, x: float, y: float, z: float) -> float:
    """Value of side `side` of `cells` (6, Z, Y, X) at a point in cells, clamped to the grid."""
    _, depth, height, width = cells.shape
    x, y, z = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001), min(max(z, 0.0), depth - 1.001)
    i, j, k = int(x), int(y), int(z)
    x, y, z = x - i, y - j, z - k
    total = 0.0
    for dk in range(2):
        for dj in range(2):
            low, high = cells[side, k + dk, j + dj, i], cells[side, k + dk, j + dj, i + 1]
            wy, wz = y if dj else 1.0 - y, z if dk else 1.0 - z
            total += (low + x * (high - low)) * wy * wz
    return total


@njit(cache=True, error_model="numpy")
def _irradiance(origin: Buffer, cell_m: float, cells: Buffer, point: Vector, normal: Vector) -> float:
    """Light on a surface, looked up one cell before it, where no cell is behind the surface."""
    x = (point[0] - origin[0]) / cell_m + normal[0]
    y = (point[1] - origin[1]) / cell_m + normal[1]
    z = (point[2] - origin[2]) / cell_m + normal[2]
    total = 0.0
    for axis in range(3):
        share = normal[axis] * normal[axis]
        if share > 1e-4:
            side = 2 * axis + (1 if normal[axis] < 0.0 else 0)
            total += share * _trilinear(cells, side, x, y, z)
    return total


@njit(cache=True, error_model="numpy")
def _light_indoors(n: int, surfaces: Surfaces, volume: LightVolume, panorama: Buffer, samples: RowSamples) -> None:
    """Turn the surface brightness of n samples into the light that reaches the camera."""
    attributes, material, materials = surfaces.attributes, surfaces.material, surfaces.materials
    origin, cell_m, cells = volume.origin, volume.cell_m, volume.light
    triangle, direction, point, values = samples.triangle, samples.direction, samples.point, samples.value
    for i in range(n):
        t = triangle[i]
        dx, dy, dz = direction[0, i], direction[1, i], direction[2, i]
        if t == SKY:
            values[i] = _OUTDOORS * sample_panorama(panorama, dx, dy, dz)
            continue
        glow = materials[material[t], GLOW]
        if glow > 0.0:
            values[i] *= glow
            continue
        nx, ny, nz = attributes[t, NORMAL], attributes[t, NORMAL + 1], attributes[t, NORMAL + 2]
        if dx * nx + dy * ny + dz * nz > 0.0:  # triangles have two sides: the one that the camera sees is lit
            nx, ny, nz = -nx, -ny, -nz
        at = (point[0, i], point[1, i], point[2, i])
        values[i] *= _irradiance(origin, cell_m, cells, at, (nx, ny, nz))


@njit(cache=True, nogil=True, error_model="numpy")
def _shade_indoors(
    buffers: SampleBuffers,
    view: Viewpoint,
    surfaces: Surfaces,
    volume: LightVolume,
    panorama: Buffer,
    image: Buffer,
    depth: Buffer,
) -> None:
    """Write the light of every pixel into `image` and its depth, metres, into `depth`, (H, W) float32 each."""
    height, width = image.shape
    samples = allocate_samples(SAMPLES * width)
    for y in range(height):
        n = gather_samples(y, buffers, samples)
        cast_rays(n, view, samples)
        paint_samples(n, view.pixel_angle, surfaces, samples)
        _light_indoors(n, surfaces, volume, panorama, samples)
        resolve_samples(n, samples, image[y], depth[y])
