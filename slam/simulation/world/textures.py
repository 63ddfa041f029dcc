"""Procedural textures with mip maps, and the panorama of the sky.

All textures are square, repeat in both directions and hold brightness (albedo) 0..1; row 0 is the lower edge.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.floating]
SIZE = 1024


@dataclass(frozen=True)
class Atlas:
    """All textures in one array, as compiled code reads them.

    Attributes:
        texels, gloss: (B,) uint8, mip levels of every texture one after the other.
        table: (K, 3) int64: binary logarithm of the side, whether it has gloss, first texel.
    """

    texels: NDArray[np.uint8]
    gloss: NDArray[np.uint8]
    table: NDArray[np.int64]


def build_atlas(textures: list[tuple[Array, Array | None]]) -> Atlas:
    """Pack textures (S, S) with or without gloss (S, S), S a power of two."""
    texels, gloss, table, start = [], [], [], 0
    for albedo, shine in textures:
        levels = _pyramid(albedo)
        shiny = _pyramid(shine) if shine is not None else [np.zeros_like(level) for level in levels]
        table.append((len(levels) - 1, int(shine is not None), start))
        texels += [level.ravel() for level in levels]
        gloss += [level.ravel() for level in shiny]
        start += sum(level.size for level in levels)
    return Atlas(np.concatenate(texels), np.concatenate(gloss), np.array(table, dtype=np.int64))


def _pyramid(image: Array) -> list[NDArray[np.uint8]]:
    level = np.clip(image * 255.0, 0.0, 255.0).astype(np.float32)
    levels = [level]
    while len(level) > 1:
        level = cv2.resize(level, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(level)
    return [np.rint(level).astype(np.uint8) for level in levels]


def noise(rng: np.random.Generator, size: int = SIZE, slope: float = 1.0, finest: float = 1.0) -> Array:
    """Repeating random field (size, size), mean 0 and deviation 1, amplitude falling as frequency^-slope.

    finest: wavelength in texels below which nothing is left.
    """
    shift = tuple(int(k) for k in rng.integers(0, size, 2))
    return np.roll(_field(size, slope, finest), shift, axis=(0, 1))


@lru_cache(maxsize=32)
def _field(size: int, slope: float, finest: float) -> Array:
    """One field of a kind; what differs between textures is where they begin."""
    f = np.hypot(scipy.fft.fftfreq(size)[:, None], scipy.fft.rfftfreq(size)[None, :])
    f[0, 0] = 1.0
    white = np.random.default_rng(size).standard_normal((size, size), dtype=np.float32)
    amplitude = (f**-slope * np.exp(-((f * finest) ** 2))).astype(np.float32)
    amplitude[0, 0] = 0.0
    field: Array = scipy.fft.irfft2(scipy.fft.rfft2(white) * amplitude, s=(size, size))
    return field / field.std()


def plaster(rng: np.random.Generator) -> Array:
    """Paint rendered wall with stains."""
    return 0.72 + 0.05 * noise(rng, slope=1.3) + 0.025 * noise(rng, slope=0.2, finest=2.0)


def courses(rng: np.random.Generator, rows: int, columns: int, joint: int, contrast: float) -> Array:
    """Bricks, slabs or tiles in courses, every second one shifted by half."""
    image = np.zeros((SIZE, SIZE), np.float32)
    h, w = SIZE / rows, SIZE / columns
    for r in range(rows):
        shift = (r % 2) * w / 2
        for c in range(columns):
            y0, y1 = round(r * h), round((r + 1) * h) - joint
            x0, x1 = round(c * w + shift), round((c + 1) * w + shift) - joint
            level = 0.55 + contrast * rng.standard_normal()
            image[y0:y1, x0:x1] = level
            image[y0:y1, : max(0, x1 - SIZE)] = level  # the one that wraps around
    image = np.where(image == 0, 0.38, image)
    return image + 0.035 * noise(rng, slope=0.7, finest=1.5)


def grass(rng: np.random.Generator) -> Array:
    """Lawn: fine and coarse blades."""
    return 0.30 + 0.07 * noise(rng, slope=0.35, finest=2.0) + 0.05 * noise(rng, slope=1.2)


def leaves(rng: np.random.Generator, size: int = 256) -> Array:
    """Paint a spray of leaves on dark: bright blots of many turns."""
    image = np.full((size, size), 0.16)
    for _ in range(260):
        x, y = rng.integers(0, size, 2)
        axes = (int(rng.integers(7, 17)), int(rng.integers(3, 8)))
        level, angle = float(rng.uniform(0.18, 0.75)), float(rng.uniform(0, 180))
        for dx in (-size, 0, size):
            for dy in (-size, 0, size):
                cv2.ellipse(image, (int(x) + dx, int(y) + dy), axes, angle, 0, 360, level, -1, cv2.LINE_AA)
    return image


def bark(rng: np.random.Generator) -> Array:
    """Furrowed bark, furrows upright."""
    field = noise(rng, 512, slope=0.9)
    return 0.34 + 0.1 * cv2.resize(field[:64], (512, 512), interpolation=cv2.INTER_CUBIC)


def asphalt_grain(rng: np.random.Generator) -> Array:
    """Grain of stone and tar for detail, mean one half."""
    return 0.5 + 0.13 * noise(rng, slope=0.25, finest=1.5) + 0.05 * noise(rng, slope=1.0)


def weathering(rng: np.random.Generator) -> Array:
    """Large soft stains for detail, mean one half; rain has drawn them downwards."""
    field = noise(rng, slope=1.2)
    drawn = cv2.blur(np.vstack([field, field]), (3, 61))[SIZE // 2 : SIZE // 2 + SIZE]
    return 0.5 + 0.1 * field + 0.12 * drawn / drawn.std()


def road(rng: np.random.Generator) -> Array:
    """Carriageway 8 m wide (columns) and 24 m long (rows): wear, patches, cracks, a manhole, dashes."""
    image = 0.33 + 0.02 * noise(rng, slope=1.2) + 0.012 * noise(rng, slope=0.2, finest=1.5)
    x = (np.arange(SIZE) + 0.5) / SIZE * 8.0
    for lane in (1.75, 3.25, 4.75, 6.25):
        image += 0.03 * np.exp(-(((x - lane) / 0.25) ** 2))  # polished by wheels
    _patches(image, rng)
    for _ in range(4):
        _crack(image, rng)
    _manhole(image, rng)
    _middle_line(image, rng)
    image[:, (x < 0.35) | (x > 7.65)] *= 0.85  # gutter
    return image


def _patches(image: Array, rng: np.random.Generator) -> None:
    """Squares of newer or older asphalt with tarred seams."""
    for _ in range(rng.integers(1, 4)):
        x, w = rng.integers(40, SIZE - 300), rng.integers(80, 260)
        y, h = rng.integers(20, SIZE - 420), rng.integers(40, 380)
        image[y : y + h, x : x + w] += rng.choice([-0.07, -0.04, 0.04])
        cv2.rectangle(image, (int(x), int(y)), (int(x + w), int(y + h)), 0.2, 3)


def _crack(image: Array, rng: np.random.Generator) -> None:
    """Paint a random walk filled with tar or left open."""
    start = rng.uniform([80, 0], [SIZE - 80, SIZE])
    drift = rng.choice([[0.0, 5.0], [12.0, 0.3], [3.0, 3.0]])
    steps = drift + rng.normal(0, [7.0, 2.5], (rng.integers(20, 90), 2))
    line = np.round(start + np.cumsum(steps, axis=0)).astype(np.int32)
    cv2.polylines(image, [line[:, None]], False, float(rng.uniform(0.1, 0.2)), int(rng.integers(2, 6)), cv2.LINE_AA)


def _manhole(image: Array, rng: np.random.Generator) -> None:
    """Paint an iron cover; texels are 8 mm across and 23 mm along."""
    centre = (int(rng.integers(250, 780)), int(rng.integers(100, 900)))
    for scale, level in ((1.25, 0.42), (1.0, 0.16), (0.8, 0.28), (0.55, 0.17), (0.3, 0.27)):
        cv2.ellipse(image, centre, (int(42 * scale), int(14 * scale)), 0, 0, 360, level, -1, cv2.LINE_AA)


def _middle_line(image: Array, rng: np.random.Generator) -> None:
    """Worn white dashes, 4 m long, 8 m apart."""
    worn = np.clip(0.8 + 0.35 * noise(rng, slope=0.8), 0, 1)
    for start in (100, 440, 780):
        window = (slice(start, start + 170), slice(SIZE // 2 - 8, SIZE // 2 + 8))
        image[window] += (0.75 - image[window]) * worn[window]


def panorama(rng: np.random.Generator, columns: int = 4096) -> NDArray[np.float32]:
    """Paint the panorama (columns / 2, columns) at infinite distance: sky, clouds, wooded hills; ground below."""
    rows = columns // 2
    elevation = (0.5 - (np.arange(rows, dtype=np.float32) + 0.5) / rows) * 180.0
    sky = np.interp(elevation, [0, 6, 25, 90], [0.82, 0.74, 0.56, 0.42]).astype(np.float32)
    clouds = cv2.resize(noise(rng, slope=1.7).astype(np.float32), (columns, rows))
    image = sky[:, None] + 0.09 * np.clip(clouds - 0.3, 0, 2) * np.clip(elevation / 12, 0, 1)[:, None]
    image[elevation < 0] = 0.3
    wave = np.abs(np.fft.rfftfreq(columns, 1 / columns))
    wood = np.tile(1 + 0.25 * noise(rng, slope=0.7), (1, columns // SIZE)).astype(np.float32)
    band = np.flatnonzero((elevation > -1) & (elevation < 9))
    for reach, level, low in ((3.4, 0.40, 1.6), (2.0, 0.24, 1.0)):
        spectrum = np.fft.rfft(rng.standard_normal(columns)) * np.maximum(wave, 4.0) ** -1.3
        ridge = np.fft.irfft(spectrum, columns)
        ridge = low + (reach - low) / 2 * np.clip(ridge / ridge.std(), -1, 2)
        below = elevation[band, None] < ridge
        image[band] = np.where(below, level * wood[: len(band)], image[band])
    return image
