"""Fusion of depth images into a surface by a truncated signed distance field (Curless and Levoy, SIGGRAPH 1996).

Open3D's `VoxelBlockGrid` stores the field, in blocks of voxels near surfaces. Points that too few images agree on are
left out, so that moving objects leave little behind; there is no space carving (docs/decisions/dense_map.md).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import RevisitError
from slam.mapping.dense_stereo import DepthImage

Array = NDArray[np.float64]

_BLOCK_VOXELS = 8  # along each edge of a block
_INITIAL_BLOCKS = 4000  # Open3D allocates more when these are used up


@dataclass(frozen=True)
class FusionConfig:
    """Configuration of the fusion.

    Attributes:
        voxel_m: edge of a voxel, metres; about the distance between points of the surface.
        max_depth_m: maximum depth of fused pixels, metres.
        truncation_voxels: truncation distance along the ray, voxels. A short one loses the road, which is seen at a
            flat angle, a long one thickens every surface; figures: docs/decisions/dense_map.md.
        min_views: minimum number of images that must have seen a point.
    """

    voxel_m: float = 0.15
    max_depth_m: float = 25.0
    truncation_voxels: float = 6.0
    min_views: int = 5

    def __post_init__(self) -> None:
        numbers = np.array([self.voxel_m, self.max_depth_m, self.truncation_voxels, self.min_views])
        if not (np.isfinite(numbers) & (numbers > 0)).all():
            raise ValueError(f"expected positive numbers, got {self}")


@dataclass(frozen=True)
class Surface:
    """A triangle mesh; without triangles, a point cloud.

    Attributes:
        points: vertices, (N, 3), metres.
        color: of the vertices, (N, 3) uint8, red first; three equal values where the images are grey.
        triangles: vertex indices of each triangle, (M, 3) int32.
    """

    points: NDArray[np.floating]
    color: NDArray[np.uint8]
    triangles: NDArray[np.int32]

    def transform(self, T_a_b: Array) -> "Surface":
        """Return the surface, which is given in frame b, in frame a."""
        return Surface(se3.transform(T_a_b, self.points.astype(np.float64)), self.color, self.triangles)


# Of a depth camera: three times the noise of its depth at 2 m, and as far as that noise stays within the truncation.
DEPTH_CAMERA_FUSION = FusionConfig(voxel_m=0.02, max_depth_m=4.0)

EMPTY_SURFACE = Surface(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.int32))


class TsdfVolume:
    """Truncated signed distance field of one submap, in the frame of its anchor."""

    def __init__(self, config: FusionConfig) -> None:
        """Make an empty field.

        Raises:
            RevisitError: Open3D cannot be loaded.
        """
        self._config, self._empty = config, True
        self._o3d = load_open3d()
        kind = self._o3d.core.float32
        self._grid = self._o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"),
            (kind, kind, kind),
            ((1), (1), (3)),
            config.voxel_m,
            _BLOCK_VOXELS,
            _INITIAL_BLOCKS,
        )

    def integrate(self, image: DepthImage, T_anchor_camera: Array) -> None:
        """Fuse the depth image of one camera at a pose (4, 4)."""
        if not image.depth.any():
            return
        self._empty = False
        tensor, picture = self._o3d.core.Tensor, self._o3d.t.geometry.Image
        depth = picture(tensor(np.ascontiguousarray(image.depth[:, :, None])))
        color = picture(tensor(image.color.astype(np.float32)))
        view = tensor(image.camera.K), tensor(se3.inverse(T_anchor_camera))
        limits = 1.0, self._config.max_depth_m, self._config.truncation_voxels
        blocks = self._grid.compute_unique_block_coordinates(depth, *view, *limits)
        self._grid.integrate(blocks, depth, color, *view, *limits)

    def extract_surface(self) -> Surface:
        """Extract the surface that enough images agree on, metres, in the anchor frame; the same bits each time."""
        if self._empty:  # Open3D refuses to extract from an empty grid
            return EMPTY_SURFACE
        # A voxel's weight, its number of views, must be above the threshold.
        mesh = self._grid.extract_triangle_mesh(weight_threshold=self._config.min_views - 0.5)
        if len(mesh.vertex.positions) == 0:
            return EMPTY_SURFACE
        color = np.clip(np.rint(mesh.vertex.colors.numpy()), 0, 255).astype(np.uint8)
        return _in_order(Surface(mesh.vertex.positions.numpy(), color, mesh.triangle.indices.numpy()))


def load_open3d() -> Any:  # its stubs know no numpy
    """Import Open3D, or raise RevisitError."""
    try:
        import open3d
    except (ImportError, OSError) as error:  # on a bare server its wheel misses libraries
        raise RevisitError(f"open3d: expected a library that loads, {error}; type: revisit doctor") from error
    return open3d


def _in_order(surface: Surface) -> Surface:
    """Sort points and triangles: their order from Open3D depends on the timing of its threads."""
    order = np.lexsort(surface.points.T)
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    triangles = rank[surface.triangles]
    first = triangles.argmin(axis=1)[:, None]  # rotate corners: smallest index first, same orientation
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    triangles = triangles[np.lexsort(triangles.T[::-1])]
    return Surface(surface.points[order], surface.color[order], triangles)
