"""All materials of the town by name, and the table of their properties that the shader reads."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.world import facades, textures

Array = NDArray[np.floating]

FRONTS = 7  # differing house fronts
ROADS = 4
POSTERS = 6
UPPER, GROUND = 0, FRONTS  # first of FRONTS materials each
ROAD = GROUND + FRONTS
POSTER = ROAD + ROADS
(
    ROOF, SLATE, PAVEMENT, KERB, GRASS, ASPHALT, LEAF, NEEDLE, BARK,
    PLASTER, BRICK, WOOD, METAL, PAINT, GLASS, RUBBER, LAMP,
) = range(POSTER + POSTERS, POSTER + POSTERS + 17)  # fmt: skip


@dataclass(frozen=True)
class Materials:
    """Textures and properties of all materials.

    Attributes:
        atlas: the textures.
        table: (M, 7) float64, columns as in `shading`: texture, detail texture, detail tiles per tile
            across and up, strength of the detail, gloss, leaf.
    """

    atlas: textures.Atlas
    table: Array


def _row(
    texture: int,
    detail: int = 0,
    tiles: tuple[float, float] = (1.0, 1.0),
    strength: float = 0.0,
    gloss: float = 0.0,
    leaf: float = 0.0,
) -> list[float]:
    return [texture, detail, *tiles, strength, gloss, leaf]


def build_materials(config: SimulationConfig) -> Materials:
    """Paint the textures of a town."""
    return _paint_all(config.seed)


@lru_cache(maxsize=2)
def _paint_all(seed: int) -> Materials:
    """Paint the textures of a seed once: painting takes longer than rendering a few small frames."""
    rng = SimulationConfig(seed=seed).rng(2)
    images: list[tuple[Array, Array | None]] = [facades.upper_front(rng) for _ in range(FRONTS)]
    images += [facades.ground_front(rng) for _ in range(FRONTS)]
    images += [(textures.road(rng), None) for _ in range(ROADS)]
    images += [(facades.advertisement(rng), None) for _ in range(POSTERS)]
    first = len(images)
    images += [(image, None) for image in _plain(rng)]
    tiles, slate, slabs, lawn, spray, needles, bark, wall, brick, grain, stains, flat = range(first, first + 12)
    rows = [_row(i, stains, (0.9, 0.7), 0.5) for i in range(FRONTS)]
    rows += [_row(FRONTS + i, stains, (0.9, 0.25), 0.5) for i in range(FRONTS)]
    rows += [_row(ROAD + i, grain, (6.4, 19.2), 0.8) for i in range(ROADS)]
    rows += [_row(POSTER + i) for i in range(POSTERS)]
    rows += [
        _row(tiles, stains, (0.4, 0.4), 0.5),
        _row(slate, stains, (0.4, 0.4), 0.5),
        _row(slabs, stains, (0.31, 0.31), 0.7),
        _row(flat, grain, (0.9, 0.9), 0.8),
        _row(lawn, stains, (0.21, 0.21), 1.0),
        _row(flat, grain, (0.8, 0.8), 0.9),
        _row(spray, leaf=1.0),
        _row(needles, leaf=1.0),
        _row(bark),
        _row(wall, stains, (0.37, 0.37), 0.6),
        _row(brick, stains, (0.5, 0.5), 0.6),
        _row(bark, stains, (0.5, 0.5), 0.4),
        _row(flat, stains, (0.3, 0.3), 0.3, 0.12),
        _row(flat, stains, (0.1, 0.1), 0.1, 0.3),
        _row(flat, gloss=0.8),
        _row(flat, grain, (2.0, 2.0), 0.6),
        _row(flat, gloss=0.5),
    ]
    return Materials(textures.build_atlas(images), np.array(rows, dtype=np.float64))


def _plain(rng: np.random.Generator) -> list[Array]:
    return [
        textures.courses(rng, 32, 24, 3, 0.05) * np.linspace(0.75, 1.1, textures.SIZE)[None, :],
        textures.courses(rng, 40, 20, 2, 0.06) * 0.6,
        textures.courses(rng, 12, 8, 4, 0.035),
        textures.grass(rng),
        textures.leaves(rng),
        textures.leaves(rng) * 0.7,
        textures.bark(rng),
        textures.plaster(rng),
        textures.courses(rng, 30, 12, 4, 0.07),
        textures.asphalt_grain(rng),
        textures.weathering(rng),
        np.full((16, 16), 0.6),
    ]
