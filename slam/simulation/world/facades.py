"""House fronts, painted: windows, doors, shops, shutters, stains.

A front texture covers 12 m x 9 m (three storeys of four bays) or, at street level, 12 m x 3 m.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.simulation.world.textures import SIZE, courses, noise, plaster

Array = NDArray[np.floating]
FRONT_WIDTH, STOREY, BAY = 12.0, 3.0, 3.0  # metres


def upper_front(rng: np.random.Generator) -> tuple[Array, Array]:
    """Three storeys of windows: albedo and gloss (SIZE, SIZE), lower edge first."""
    albedo, gloss = _wall(rng), np.zeros((SIZE, SIZE), np.float32)
    style = _window_style(rng)
    bay, storey = SIZE // 4, SIZE // 3
    for row in range(3):
        _band(albedo, row * storey, rng)
        for column in range(4):
            centre = ((column + 0.5) * bay, (row + 0.52) * storey)
            _window(albedo, gloss, centre, style, rng)
    _pipe(albedo, rng)
    return np.flipud(albedo).copy(), np.flipud(gloss).copy()


def ground_front(rng: np.random.Generator) -> tuple[Array, Array]:
    """Street level: doors, shop windows, garage gates, a plinth; albedo and gloss, lower edge first."""
    albedo, gloss = _wall(rng), np.zeros((SIZE, SIZE), np.float32)
    bay = SIZE // 4
    kinds = rng.permutation(["door", "shop", "window", rng.choice(["gate", "shop", "window", "wall"])])
    style = _window_style(rng)
    for column, kind in enumerate(kinds):
        box = (column * bay + 24, 0, (column + 1) * bay - 24, SIZE)
        if kind == "window":
            # Texels are four times wider than high here.
            _window(albedo, gloss, ((column + 0.5) * bay, 0.45 * SIZE), (style[0], style[1] * 3, style[2]), rng)
        elif kind != "wall":
            {"door": _door, "shop": _shop, "gate": _gate}[str(kind)](albedo, gloss, box, rng)
    albedo[int(0.88 * SIZE) :] *= 0.6 + 0.06 * noise(rng)[int(0.88 * SIZE) :]
    return np.flipud(albedo).copy(), np.flipud(gloss).copy()


def _wall(rng: np.random.Generator) -> Array:
    if rng.random() < 0.35:
        return courses(rng, 120, 48, 2, 0.05) + 0.04 * noise(rng, slope=1.5)
    return plaster(rng)


def _window_style(rng: np.random.Generator) -> tuple[float, float, str]:
    """Half width and half height in texels, and the objects beside the glass."""
    return (
        float(rng.integers(42, 80)),
        float(rng.integers(70, 105)),
        str(rng.choice(["plain", "shutters", "frame"])),
    )


def _box(image: Array, x0: float, y0: float, x1: float, y1: float, level: float) -> None:
    image[max(0, int(y0)) : max(0, int(y1)), max(0, int(x0)) : max(0, int(x1))] = level


def _window(
    albedo: Array,
    gloss: Array,
    centre: tuple[float, float],
    style: tuple[float, float, str],
    rng: np.random.Generator,
) -> None:
    """Glass with frame, cross bars, curtain, sill, and shutters or a surround."""
    (x, y), (w, h, beside) = centre, style
    if beside == "frame":
        _box(albedo, x - w - 16, y - h - 16, x + w + 16, y + h + 16, float(rng.uniform(0.78, 0.9)))
    _box(albedo, x - w, y - h, x + w, y + h, 0.85)
    _box(albedo, x - w + 7, y - h + 7, x + w - 7, y + h - 7, float(rng.uniform(0.03, 0.14)))
    _box(gloss, x - w + 7, y - h + 7, x + w - 7, y + h - 7, 0.75)
    _curtain(albedo, gloss, (x, y, w, h), rng)
    _box(albedo, x - 4, y - h, x + 4, y + h, 0.85)
    if h > 80:
        _box(albedo, x - w, y - h * 0.35 - 4, x + w, y - h * 0.35 + 4, 0.85)
    # Shadow of the lintel, and the sill.
    albedo[int(y - h) : int(y - h + 14), int(x - w) : int(x + w)] *= 0.4
    _box(albedo, x - w - 12, y + h, x + w + 12, y + h + 12, 0.8)
    albedo[int(y + h + 12) : int(y + h + 22), int(x - w - 10) : int(x + w + 12)] *= 0.55
    if beside == "shutters":
        _shutters(albedo, (x, y, w, h), float(rng.uniform(0.15, 0.5)))


def _curtain(albedo: Array, gloss: Array, window: tuple[float, float, float, float], rng: np.random.Generator) -> None:
    """Curtains at the sides, a blind half down, flowers on the sill, or nothing."""
    x, y, w, h = window
    kind, level = rng.integers(0, 5), float(rng.uniform(0.35, 0.75))
    if kind == 0:
        for side in (-1, 1):
            a, b = sorted((x + side * (w - 8), x + side * w * 0.45))
            folds = 0.8 + 0.2 * np.sin(np.arange(int(a), int(b)) * 0.7)
            albedo[int(y - h + 8) : int(y + h - 8), int(a) : int(b)] = level * folds
    elif kind == 1:
        end = y - h + 8 + rng.uniform(0.2, 1.0) * (2 * h - 16)
        slats = level * (0.85 + 0.15 * (np.arange(int(y - h + 8), int(end)) % 8 < 6))
        albedo[int(y - h + 8) : int(end), int(x - w + 8) : int(x + w - 8)] = slats[:, None]
        gloss[int(y - h + 8) : int(end), int(x - w + 8) : int(x + w - 8)] *= 0.3
    elif kind == 2:
        for _ in range(40):
            spot = (int(x + rng.uniform(-0.8, 0.8) * w), int(y + h - rng.uniform(0, 0.3) * h))
            cv2.circle(albedo, spot, int(rng.integers(4, 9)), float(rng.uniform(0.1, 0.6)), -1)


def _shutters(albedo: Array, window: tuple[float, float, float, float], level: float) -> None:
    x, y, w, h = window
    for side in (-1, 1):
        a, b = sorted((x + side * (w + 4), x + side * (w * 1.75)))
        slats = level * (0.7 + 0.3 * (np.arange(int(y - h), int(y + h)) % 10 < 7))
        albedo[int(y - h) : int(y + h), max(0, int(a)) : int(b)] = slats[:, None]


def _band(albedo: Array, row: int, rng: np.random.Generator) -> None:
    """Paint a moulding between storeys, on some houses."""
    if rng.random() < 0.5:
        albedo[row : row + 12] = np.minimum(albedo[row : row + 12] + 0.12, 0.95)
        albedo[row + 12 : row + 20] *= 0.6


def _pipe(albedo: Array, rng: np.random.Generator) -> None:
    """Paint a rain pipe between two bays."""
    x = int(rng.integers(1, 4)) * SIZE // 4 + int(rng.integers(-8, 8))
    albedo[:, x : x + 8] = 0.3 + 0.4 * np.sin(np.linspace(0.2, 2.8, 8))
    albedo[:, x + 8 : x + 14] *= 0.6


def _door(albedo: Array, gloss: Array, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paint a panelled door with a small window, steps and a bell plate."""
    x = (box[0] + box[2]) / 2
    level = float(rng.uniform(0.12, 0.45))
    _box(albedo, x - 62, 0.2 * SIZE, x + 62, SIZE, 0.75)
    _box(albedo, x - 50, 0.25 * SIZE, x + 50, 0.95 * SIZE, level)
    for top in (0.3, 0.52, 0.74):
        _box(albedo, x - 36, top * SIZE, x + 36, (top + 0.16) * SIZE, level * (0.7 if top > 0.4 else 0.3))
    _box(gloss, x - 36, 0.3 * SIZE, x + 36, 0.46 * SIZE, 0.6)
    _box(albedo, x + 70, 0.5 * SIZE, x + 84, 0.62 * SIZE, 0.9)


def _shop(albedo: Array, gloss: Array, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paint a display window full of things, and a sign with letters above it."""
    x0, _, x1, _ = box
    _box(albedo, x0, 0.22 * SIZE, x1, 0.86 * SIZE, 0.12)
    _box(gloss, x0, 0.22 * SIZE, x1, 0.86 * SIZE, 0.6)
    for _ in range(30):
        x, y = rng.uniform(x0 + 4, x1 - 40), rng.uniform(0.35, 0.8) * SIZE
        _box(
            albedo,
            x,
            y,
            min(x1 - 4, x + rng.uniform(8, 36)),
            y + rng.uniform(20, 110),
            float(rng.uniform(0.05, 0.85)),
        )
    for x in np.linspace(x0, x1, 3):
        _box(albedo, x - 4, 0.2 * SIZE, x + 4, 0.88 * SIZE, 0.7)
    back, front = (0.15, 0.9) if rng.random() < 0.5 else (0.85, 0.12)
    _box(albedo, x0 - 10, 0.04 * SIZE, x1 + 10, 0.19 * SIZE, back)
    word = "".join(rng.choice(list("ABCEFGHKLMNOPRSTUZ"), 5))
    ink = cv2.resize(_letters(word, 60, 208), (x1 - x0, int(0.13 * SIZE)), interpolation=cv2.INTER_LINEAR)
    albedo[int(0.05 * SIZE) : int(0.05 * SIZE) + len(ink), x0:x1] = back + (front - back) * ink


def _letters(word: str, height: int, width: int) -> Array:
    """Paint a word in strokes of 1 on 0."""
    paper = np.zeros((height, width), np.uint8)
    cv2.putText(paper, word, (6, int(0.8 * height)), cv2.FONT_HERSHEY_DUPLEX, height / 35, 255, 4, cv2.LINE_AA)
    return paper / 255.0


def _gate(albedo: Array, gloss: Array, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paint a garage gate of boards."""
    x0, _, x1, _ = box
    _box(albedo, x0, 0.2 * SIZE, x1, SIZE, 0.3)
    boards = float(rng.uniform(0.35, 0.7)) * (0.75 + 0.25 * (np.arange(x0 + 8, x1 - 8) % 24 < 21))
    albedo[int(0.23 * SIZE) : SIZE, x0 + 8 : x1 - 8] = boards
    gloss[int(0.23 * SIZE) : SIZE, x0 + 8 : x1 - 8] = 0.05


def advertisement(rng: np.random.Generator) -> Array:
    """Paint a poster or road sign: frame, shapes and letters, (256, 256), lower edge first."""
    image = np.full((256, 256), float(rng.uniform(0.1, 0.9)))
    for _ in range(6):
        a, b = rng.integers(10, 246, 2), rng.integers(10, 246, 2)
        cv2.rectangle(image, tuple(map(int, a)), tuple(map(int, b)), float(rng.uniform(0, 1)), -1)
    for line in range(3):
        word = "".join(rng.choice(list("ABDEGHKLMNORST0123456789"), 6))
        rows = slice(12 + 78 * line, 82 + 78 * line)
        image[rows] += (float(rng.choice([0.02, 0.98])) - image[rows]) * _letters(word, 70, 256)
    cv2.rectangle(image, (0, 0), (255, 255), 0.9, 10)
    return np.flipud(image).copy()
