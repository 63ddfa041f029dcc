"""Renders light images and depth maps of the town: scenes, shadow maps, culling, and the image of one camera.

Why an own renderer: docs/decisions/simulation_rendering.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.simulation.rendering.rasterizer import SAMPLES, rasterize, rasterize_from_sun
from slam.simulation.rendering.shading import (
    ATTRIBUTES,
    LEAF,
    NORMAL,
    TINT,
    U_GRADIENT,
    V_GRADIENT,
    Lighting,
    SampleBuffers,
    ShadowMap,
    Surfaces,
    Viewpoint,
    shade,
)
from slam.simulation.world.materials import Materials
from slam.simulation.world.mesh import Mesh

Array = NDArray[np.float64]
Image = NDArray[np.float32]
_SHADOW_CELL = 0.09  # metres, side of a cell of the shadow map
_WIND_AMPLITUDE = 0.025  # metres by which leaves swing
_CULL_MARGIN = 0.1  # metres, beyond the baseline, by which bounding spheres are enlarged


@dataclass(frozen=True)
class Daylight:
    """Position and strength of the sun, and the sky.

    Attributes:
        to_sun: (3,) unit vector, town frame.
        sun, ambient, haze: light of the sun, of the sky, and of distant air.
        panorama: (rows, columns) light of the sky and of all that is infinitely far.
    """

    to_sun: Array
    sun: float
    ambient: float
    haze: float
    panorama: Image


@dataclass(frozen=True)
class Scene:
    """Triangles ready to be drawn, in clusters with bounding spheres.

    Attributes:
        corners: (T, 3, 3) float32 metres.
        attributes: (T, 12) float32, columns as in `shading`: gradients of u and v with offsets, normal, tint.
        material: (T,) int32 row of the material table.
        ranges: (R, 2) first and past-last triangle of each cluster.
        centres, radii: (R, 3) and (R,) metres, bounding spheres of the clusters.
    """

    corners: NDArray[np.float32]
    attributes: NDArray[np.float32]
    material: NDArray[np.int32]
    ranges: NDArray[np.int64]
    centres: Array
    radii: Array


def build_scene(meshes: list[Mesh]) -> Scene:
    """Build a scene in which each mesh is a cluster."""
    meshes = [mesh for mesh in meshes if len(mesh)]
    ends = np.cumsum([0] + [len(mesh) for mesh in meshes])
    corners = np.concatenate([mesh.corners for mesh in meshes])
    spheres = [_sphere(mesh.corners.reshape(-1, 3)) for mesh in meshes]
    return Scene(
        np.ascontiguousarray(corners, dtype=np.float32),
        np.concatenate([_attributes(mesh) for mesh in meshes]).astype(np.float32),
        np.concatenate([mesh.material for mesh in meshes]),
        np.stack([ends[:-1], ends[1:]], axis=1),
        np.array([centre for centre, _ in spheres]),
        np.array([radius for _, radius in spheres]),
    )


def _sphere(points: Array) -> tuple[Array, float]:
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _attributes(mesh: Mesh) -> Array:
    """Texture gradients, offsets, normals and tints (T, 12): u = g . p + u0 in the plane of each triangle."""
    a = mesh.corners[:, 0]
    e1, e2 = mesh.corners[:, 1] - a, mesh.corners[:, 2] - a
    normal = np.cross(e1, e2)
    area = np.maximum((normal**2).sum(axis=1, keepdims=True), 1e-18)
    # Dual basis of the two edges within the plane: d1 . e1 = 1, d1 . e2 = 0, and the reverse.
    d1, d2 = np.cross(e2, normal) / area, np.cross(normal, e1) / area
    out = np.zeros((len(mesh), ATTRIBUTES))
    for k, first in ((0, U_GRADIENT), (1, V_GRADIENT)):
        u = mesh.uv[:, :, k]
        gradient = d1 * (u[:, 1] - u[:, 0])[:, None] + d2 * (u[:, 2] - u[:, 0])[:, None]
        out[:, first : first + 3] = gradient
        out[:, first + 3] = u[:, 0] - (gradient * a).sum(axis=1)
    out[:, NORMAL : NORMAL + 3] = normal / np.sqrt(area)
    out[:, TINT] = mesh.tint
    return out


def build_shadow_map(scene: Scene, to_sun: Array, near: Array, reach: float) -> ShadowMap:
    """Build the shadow map of a scene for what lies within `reach` metres of positions `near` (N, 2)."""
    right = np.cross([0.0, 0.0, 1.0], to_sun)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(to_sun, right), to_sun])
    place = np.column_stack([near, np.zeros(len(near))]) @ axes[:2].T
    low, high = place.min(axis=0) - reach, place.max(axis=0) + reach
    shape = np.ceil((high - low) / _SHADOW_CELL).astype(int)[::-1]
    heights = np.full(tuple(shape), -np.inf, dtype=np.float32)
    rasterize_from_sun(scene.corners, axes, low, _SHADOW_CELL, heights)
    return ShadowMap(axes, low, _SHADOW_CELL, heights)


@dataclass(frozen=True)
class LitScene:
    """A scene with its shadows, light and materials: constant while a stretch of the path is rendered."""

    scene: Scene
    shadow: ShadowMap
    light: Daylight
    materials: Materials


@dataclass(frozen=True)
class RenderFrame:
    """What changes from frame to frame: the meshes of moving cars, and the time of the wind, seconds (None: calm)."""

    moving: list[Mesh]
    wind: float | None = None


def cull_scene(lit: LitScene, frame: RenderFrame, camera: StereoCamera, T_town_camera: Array) -> Scene:
    """Return the triangles that either camera of a pair may see: moving meshes, then clusters from near to far.

    Args:
        lit: scene to select from.
        frame: moving meshes and wind.
        camera: intrinsics and baseline of the pair.
        T_town_camera: (4, 4) pose of the left camera, metres.
    """
    scene = lit.scene
    P, centre = projection_matrix(camera, T_town_camera), T_town_camera[:3, 3]
    ranges = visible_ranges(scene, P, centre, camera)
    pick = np.concatenate([np.arange(first, last) for first, last in ranges] or [np.zeros(0, np.int64)])
    extra = build_scene(frame.moving) if frame.moving else None
    leaves = lit.materials.table[scene.material[pick], LEAF] > 0
    arrays = [
        (_sway_leaves(scene.corners[pick], leaves, pick, frame.wind), scene.attributes[pick], scene.material[pick])
    ]
    if extra is not None:
        arrays.insert(0, (extra.corners, extra.attributes, extra.material))
    corners, attributes, material = (np.concatenate(column) for column in zip(*arrays, strict=True))
    return Scene(corners, attributes, material, np.array([[0, len(material)]]), scene.centres[:0], scene.radii[:0])


def _sway_leaves(corners: NDArray[np.float32], leaves: NDArray[np.bool_], number: Array, wind: float | None) -> Image:
    """Displace the triangles (N, 3, 3) of leaves by the wind at a time, seconds, each with its own phase."""
    if wind is None:
        return corners
    # 2.399 rad is the golden angle: the phases of neighbours differ widely.
    phase = (number[leaves] * 2.399)[:, None] + [0.0, 1.0, 2.1] + wind * np.array([7.1, 5.3, 9.7])
    corners[leaves] += (_WIND_AMPLITUDE * np.sin(phase)).astype(np.float32)[:, None]
    return corners


def projection_matrix(camera: StereoCamera, T_town_camera: Array) -> Array:
    """P (3, 4): town to homogeneous pixels."""
    R, centre = T_town_camera[:3, :3], T_town_camera[:3, 3]
    return camera.K @ np.hstack([R.T, -(R.T @ centre)[:, None]])


def render_view(lit: LitScene, scene: Scene, camera: StereoCamera, T_town_camera: Array) -> tuple[Image, Image]:
    """Render light (about 0 to 1) and depth (metres along the axis, infinite for sky) of one camera, (H, W) each.

    Args:
        lit: shadows, light and materials.
        scene: triangles in view, from `cull_scene`.
        camera: intrinsics and image size.
        T_town_camera: (4, 4) pose of this very camera, left or right, metres.
    """
    R, centre = T_town_camera[:3, :3], T_town_camera[:3, 3]
    shape = (camera.height, camera.width)
    inverse_depth = np.zeros((*shape, SAMPLES), np.float32)
    ids = np.full((*shape, SAMPLES), -1, np.int32)
    rasterize(scene.corners, scene.ranges, projection_matrix(camera, T_town_camera), inverse_depth, ids)
    light, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    atlas, sky = lit.materials.atlas, lit.light
    shade(
        SampleBuffers(inverse_depth, ids),
        Viewpoint(R @ np.linalg.inv(camera.K), centre, 1.0 / camera.fx),
        Surfaces(scene.attributes, scene.material, lit.materials.table, atlas.texels, atlas.gloss, atlas.table),
        Lighting(sky.to_sun, sky.sun, sky.ambient, sky.haze, sky.panorama, lit.shadow),
        light,
        depth,
    )
    return light, depth


def visible_ranges(scene: Scene, P: Array, centre: Array, camera: StereoCamera) -> NDArray[np.int64]:
    """Ranges of the clusters whose bounding sphere reaches into the view of a pair, nearest first."""
    forward = P[2, :3]
    # Normals of the planes through the camera and the first and last column and row.
    u, v = P[0, :3], P[1, :3]
    planes = np.stack([forward, u + forward, camera.width * forward - u, v + forward, camera.height * forward - v])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    inside = ((scene.centres - centre) @ planes.T > -scene.radii[:, None] - camera.baseline - _CULL_MARGIN).all(axis=1)
    keep = np.flatnonzero(inside)
    distance = np.linalg.norm(scene.centres[keep] - centre, axis=1) - scene.radii[keep]
    return scene.ranges[keep[np.argsort(distance, kind="stable")]]
