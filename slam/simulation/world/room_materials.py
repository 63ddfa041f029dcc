"""Textures of a room and of what stands in it, and the table of materials that the shader reads.

Brightness (albedo) is 0..1, row 0 is the lower edge, as in `textures`.
"""

from enum import IntEnum, auto
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.simulation.scenario.room_config import RoomConfig
from slam.simulation.world.facades import advertisement
from slam.simulation.world.materials import Materials
from slam.simulation.world.textures import SIZE, asphalt_grain, build_atlas, courses, leaves, noise

Array = NDArray[np.floating]

PICTURES, SPINES, PAPERS, SCREENS = 15, 3, 4, 2  # how many textures of a kind a room has
SPINES_OF_A_TEXTURE = 16  # beside each other
_FIRST_PICTURE = 19  # row of the table
_PAPER = 512  # texels, side of pictures, spines, papers and screens
_WORDS = "ABCDEFGHIKLMNOPRSTUVWZabcdefghiklmnoprstuvwz0123456789"


class RoomSurface(IntEnum):
    """Materials, as rows of the table; those of which there are several count from the one that is named."""

    WALL = 0
    ACCENT_WALL = auto()
    CEILING = auto()
    FLOOR = auto()
    CORRIDOR_FLOOR = auto()
    WOOD = auto()
    DARK_WOOD = auto()
    LACQUER = auto()
    FABRIC = auto()
    CURTAIN = auto()
    RUG = auto()
    METAL = auto()
    BLACK = auto()
    LAMP = auto()
    DOOR = auto()
    FRONT = auto()
    KEYBOARD = auto()
    LEAF = auto()
    CARTON = auto()
    PICTURE = _FIRST_PICTURE
    SPINE = _FIRST_PICTURE + PICTURES
    PAPER = _FIRST_PICTURE + PICTURES + SPINES
    SCREEN = _FIRST_PICTURE + PICTURES + SPINES + PAPERS


@lru_cache(maxsize=2)
def build_room_materials(seed: int) -> Materials:
    """Paint the textures of a room. Painting takes longer than rendering a few small frames, so it is done once.

    The table has two columns more than that of the town: how bright a surface is by itself (screens, lamps), and
    whether it returns the infrared light of a depth camera.
    """
    rng = RoomConfig(seed=seed).rng(30)
    images = [
        _painted_wall(rng), _wallpaper(rng), _painted_wall(rng), _floor(rng), _tiles(rng),
        _wood(rng, 0.55), _wood(rng, 0.24), np.full((SIZE, SIZE), 0.75) + 0.004 * noise(rng, slope=1.2),
        _fabric(rng), _fabric(rng) * 1.5, _rug(rng), np.full((64, 64), 0.45), np.full((64, 64), 0.045),
        np.full((16, 16), 1.0), _door(rng), _front(rng), _keyboard(rng), leaves(rng), _carton(rng),
    ]  # fmt: skip
    paintings = (_landscape, _shapes, _chart, advertisement, _collage)
    images += [paintings[i % len(paintings)](rng) for i in range(PICTURES)]
    images += [_spines(rng) for _ in range(SPINES)]
    images += [_page(rng) for _ in range(PAPERS)] + [_screen(rng) for _ in range(SCREENS)]
    grain = len(images)
    images.append(asphalt_grain(rng))
    rows = np.zeros((grain, 9))
    rows[:, 0], rows[:, 1], rows[:, 2:4], rows[:, 8] = np.arange(grain), grain, 1.0, 1.0
    for surface, tiles, strength in _GRAINS:
        rows[surface, 2:5] = tiles, tiles, strength
    rows[RoomSurface.LAMP, 7:] = 1.6, 0.0
    rows[RoomSurface.SCREEN :, 7:] = 0.75, 0.0
    rows[RoomSurface.BLACK, 8] = 0.0
    return Materials(build_atlas([(image, None) for image in images]), rows)


# Fine grain that gives surfaces texture when they are seen from near: tiles on a tile of the material, and strength.
_GRAINS = (
    (RoomSurface.WALL, 3.0, 0.03),
    (RoomSurface.FLOOR, 3.0, 0.12),
    (RoomSurface.FABRIC, 2.0, 0.25),
    (RoomSurface.CURTAIN, 2.0, 0.2),
    (RoomSurface.CARTON, 1.0, 0.12),
)


def _painted_wall(rng: np.random.Generator) -> Array:
    """Paint a white wall: what the roller leaves is hardly visible."""
    return 0.78 + 0.006 * noise(rng, slope=1.3) + 0.006 * noise(rng, slope=0.3, finest=3.0)


def _wallpaper(rng: np.random.Generator) -> Array:
    """Paint the wall that differs from the others: bricks, a pattern in rows, or a darker colour."""
    kind, level = rng.integers(3), float(rng.uniform(0.35, 0.6))
    if kind == 0:
        return courses(rng, 26, 8, 6, 0.06) * 0.9
    image = np.full((SIZE, SIZE), level) + 0.012 * noise(rng, slope=1.2)
    if kind == 1:
        step, motif = 128, rng.integers(-50, 50, (5, 2))
        for y in range(0, SIZE, step):
            for x in range(0, SIZE, step):
                shift = [x + step // 2 * (y // step % 2), y]
                for points in (motif + shift, motif * [-1, 1] + shift):
                    for dx in (0, SIZE):
                        cv2.fillPoly(image, [(points + np.array([dx, 0])).astype(np.int32)], level + 0.06, cv2.LINE_AA)
    return image


def _floor(rng: np.random.Generator) -> Array:
    """Parquet, tiles or a carpet."""
    kind = rng.integers(3)
    if kind == 0:
        return _tiles(rng)
    if kind == 1:
        return 0.3 + 0.03 * noise(rng, slope=0.3, finest=2.0) + 0.03 * noise(rng, slope=1.2)
    image, rows = _wood(rng, 0.42), 10
    for row in range(rows):
        y0, y1 = round(row * SIZE / rows), round((row + 1) * SIZE / rows)
        ends = np.sort((np.arange(2) * SIZE / 2 + rng.uniform(0, 400)) % SIZE).astype(int)
        for x0, x1 in ((ends[0], ends[1]), (ends[1], ends[0] + SIZE)):
            columns = np.arange(x0, x1) % SIZE
            image[y0:y1, columns] = np.roll(image[y0:y1, columns], int(rng.integers(SIZE)), axis=1) * rng.uniform(
                0.75, 1.2
            )
            image[y0:y1, columns[:3]] *= 0.5
        image[y0 : y0 + 3] *= 0.5
    return image


def _tiles(rng: np.random.Generator) -> Array:
    side, image = SIZE // 4, 0.5 + 0.03 * noise(rng, slope=1.4)
    for y in range(4):
        for x in range(4):
            window = image[y * side : (y + 1) * side, x * side : (x + 1) * side]
            window += rng.normal(0, 0.025)
            window[:5], window[:, :5] = 0.3, 0.3
    return image


def _wood(rng: np.random.Generator, level: float) -> Array:
    """Grain along the rows, with a few knots' worth of slow change."""
    field = cv2.resize(noise(rng, slope=0.9)[:, :48], (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
    return level * (1.0 + 0.12 * field + 0.05 * noise(rng, slope=1.4))


def _fabric(rng: np.random.Generator) -> Array:
    weave = np.sin(np.arange(SIZE) * 2 * np.pi / 8)
    level = float(rng.uniform(0.2, 0.45))
    image = level * (1 + 0.08 * weave[:, None] * weave[None, :] + 0.06 * noise(rng, slope=1.0))
    if rng.random() < 0.6:  # stripes or checks
        stripe = (np.arange(SIZE) // 64 % 4 == 0) * 0.5
        image *= 1 + stripe[None, :]
        image *= 1 + stripe[:, None] * rng.integers(2)
    return image


def _rug(rng: np.random.Generator) -> Array:
    """Borders, and motifs that repeat symmetrically."""
    quarter = np.full((SIZE // 2, SIZE // 2), float(rng.uniform(0.15, 0.4)))
    for _ in range(34):
        centre, size = rng.integers(0, SIZE // 2, 2), rng.integers(12, 70, 2)
        angle, level = float(rng.choice([0, 45, 90])), float(rng.uniform(0.1, 0.75))
        box = cv2.boxPoints((tuple(map(float, centre)), tuple(map(float, size)), angle)).astype(np.int32)
        cv2.fillPoly(quarter, [box], level)
    for edge, level in ((70, 0.6), (52, 0.2), (36, 0.5), (14, 0.25)):
        quarter[:edge], quarter[:, :edge] = level, level
    image = np.hstack([quarter, quarter[:, ::-1]])
    image = np.vstack([image, image[::-1]])
    return image + 0.03 * noise(rng, slope=0.3, finest=2.0)


def _door(rng: np.random.Generator) -> Array:
    image = _wood(rng, float(rng.choice([0.35, 0.7])))[:512, :512].copy()
    for low, high in ((40, 230), (270, 470)):
        for x in (60, 280):
            cv2.rectangle(image, (x, low), (x + 170, high), float(image.mean() * 0.7), 6)
            cv2.rectangle(image, (x + 8, low + 8), (x + 162, high - 8), float(image.mean() * 1.15), 3)
    cv2.rectangle(image, (470, 225), (500, 262), 0.15, -1)
    cv2.rectangle(image, (440, 240), (490, 248), 0.8, -1)
    return image


def _front(rng: np.random.Generator) -> Array:
    """Paint the front of a cupboard: two doors or drawers with handles."""
    image = _wood(rng, float(rng.uniform(0.4, 0.7)))[:512, :512].copy()
    rows = int(rng.integers(1, 4))
    for row in range(rows):
        for x in (0, 256):
            y0, y1 = row * 512 // rows, (row + 1) * 512 // rows
            cv2.rectangle(image, (x + 3, y0 + 3), (x + 252, y1 - 3), 0.12, 4)
            handle = (x + 225, (y0 + y1) // 2 - 25) if x == 0 else (x + 22, (y0 + y1) // 2 - 25)
            cv2.rectangle(image, handle, (handle[0] + 8, handle[1] + 50), 0.85, -1)
            cv2.rectangle(image, (handle[0] + 9, handle[1]), (handle[0] + 13, handle[1] + 54), 0.2, -1)
    return image


def _keyboard(rng: np.random.Generator) -> Array:
    image = np.full((256, 256), 0.12)
    for y in range(6):
        for x in range(15):
            level = float(rng.uniform(0.3, 0.42))
            cv2.rectangle(image, (x * 17 + 3, y * 42 + 5), (x * 17 + 15, y * 42 + 38), level, -1)
            _write(image, _word(rng, 1), (x * 17 + 5, y * 42 + 22), 0.3, 0.85)
    return image


def _carton(rng: np.random.Generator) -> Array:
    image = np.full((_PAPER, _PAPER), 0.42) + 0.02 * noise(rng, _PAPER, slope=0.8)
    image[:, 220:290] *= 0.8
    _write(image, _word(rng, 6), (40, 180), 3.0, 0.1)
    _write(image, _word(rng, 9), (60, 400), 1.4, 0.1)
    cv2.rectangle(image, (330, 240), (480, 340), 0.85, -1)
    for k in range(24):
        cv2.line(image, (340 + 5 * k, 260), (340 + 5 * k, 320), 0.1, int(rng.integers(1, 4)))
    return np.flipud(image).copy()


def _word(rng: np.random.Generator, letters: int) -> str:
    return "".join(rng.choice(list(_WORDS), letters))


def _write(image: Array, text: str, at: tuple[int, int], scale: float, level: float) -> None:
    """Write a line that begins at (x, y), its base."""
    low, high = max(0, at[1] - int(40 * scale)), at[1] + int(16 * scale)
    ink = np.zeros((len(image[low:high]), image.shape[1]), np.uint8)
    place, thick = (at[0], at[1] - low), max(1, round(scale * 1.6))
    cv2.putText(ink, text, place, cv2.FONT_HERSHEY_DUPLEX, scale, 255, thick, cv2.LINE_AA)
    image[low:high] += (level - image[low:high]) * (ink / 255.0)


def _landscape(rng: np.random.Generator) -> Array:
    """Paint a picture of hills and trees under a sky, as a photograph has them."""
    y = np.linspace(0.85, 0.5, _PAPER)[:, None]
    image = y + 0.05 * noise(rng, _PAPER, slope=1.6)
    cv2.circle(image, tuple(int(v) for v in rng.integers([60, 60], [450, 150])), int(rng.integers(18, 45)), 0.97, -1)
    for level, base, rough in ((0.55, 230, 60), (0.4, 290, 45), (0.25, 360, 35)):
        ridge = base - rough * _field_row(rng)
        below = np.arange(_PAPER)[:, None] > ridge[None, :]
        image = np.where(below, level * (1 + 0.25 * noise(rng, _PAPER, slope=0.6)), image)
        for _ in range(int(rng.integers(5, 16))):
            x, size = int(rng.integers(10, 500)), int(rng.integers(12, 60))
            foot, dark = int(ridge[x]) + 12, float(level * rng.uniform(0.2, 0.6))
            points = np.array([[x - size // 3, foot], [x + size // 3, foot], [x, foot - size]], np.int32)
            cv2.fillPoly(image, [points], dark, cv2.LINE_AA)
    if rng.random() < 0.6:
        x, w, h = int(rng.integers(60, 360)), int(rng.integers(50, 100)), int(rng.integers(40, 70))
        cv2.rectangle(image, (x, 420 - h), (x + w, 420), 0.8, -1)
        roof = np.array([[x - 8, 420 - h], [x + w + 8, 420 - h], [x + w // 2, 420 - 2 * h]], np.int32)
        cv2.fillPoly(image, [roof], 0.15, cv2.LINE_AA)
        for k in range(3):
            cv2.rectangle(image, (x + 6 + k * w // 3, 430 - h), (x + k * w // 3 + w // 4, 445 - h), 0.1, -1)
    return np.flipud(image).copy()


def _field_row(rng: np.random.Generator) -> Array:
    """Return the outline (512,) of hills, deviation one."""
    wave = np.maximum(np.fft.rfftfreq(_PAPER, 1 / _PAPER), 1.5)
    line = np.fft.irfft(np.fft.rfft(rng.standard_normal(_PAPER)) * wave**-1.4, _PAPER)
    return np.asarray((line - line.mean()) / line.std())


def _shapes(rng: np.random.Generator) -> Array:
    """Paint an abstract picture: overlapping shapes and strokes."""
    image = np.full((_PAPER, _PAPER), float(rng.uniform(0.3, 0.9)))
    for _ in range(38):
        level, at = float(rng.uniform(0.03, 0.97)), rng.integers(0, _PAPER, 2)
        kind, size = rng.integers(4), rng.integers(15, 110, 2)
        if kind == 0:
            cv2.circle(image, tuple(map(int, at)), int(size[0] / 2), level, -1, cv2.LINE_AA)
        elif kind == 1:
            points = at + rng.integers(-size.max(), size.max(), (int(rng.integers(3, 6)), 2))
            cv2.fillPoly(image, [points.astype(np.int32)], level, cv2.LINE_AA)
        elif kind == 2:
            cv2.rectangle(image, tuple(map(int, at)), tuple(map(int, at + size)), level, -1)
        else:
            end = tuple(int(v) for v in rng.integers(0, _PAPER, 2))
            cv2.line(image, tuple(map(int, at)), end, level, int(rng.integers(2, 9)), cv2.LINE_AA)
    return image * (1 + 0.03 * noise(rng, _PAPER, slope=0.8))


def _chart(rng: np.random.Generator) -> Array:
    """Paint a map: land and water in steps of height, streets, names."""
    field = noise(rng, _PAPER, slope=1.7)
    image = 0.35 + 0.12 * np.clip(np.floor(field * 2), -2, 3)
    for _ in range(14):
        line = rng.integers(0, _PAPER, 2) + np.cumsum(rng.normal(0, 14, (40, 2)) + rng.normal(0, 8, 2), axis=0)
        points = [line.astype(np.int32)[:, None]]
        cv2.polylines(image, points, False, 0.1, 5, cv2.LINE_AA)
        cv2.polylines(image, points, False, 0.9, 2, cv2.LINE_AA)
    for _ in range(26):
        x, y = rng.integers(0, 430), rng.integers(20, 500)
        _write(image, _word(rng, int(rng.integers(3, 9))), (int(x), int(y)), float(rng.uniform(0.4, 0.9)), 0.05)
        cv2.circle(image, (int(x) - 6, int(y) - 4), 4, 0.05, -1, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (_PAPER - 1, _PAPER - 1), 0.85, 16)
    return np.flipud(image).copy()


def _collage(rng: np.random.Generator) -> Array:
    """Paint a board of small pictures and notes, each at an angle of its own."""
    image = np.full((_PAPER, _PAPER), 0.38, np.float64) + 0.05 * noise(rng, _PAPER, slope=0.3, finest=2.0)
    for row in range(4):
        for column in range(4):
            small = [_landscape, _shapes, _page][int(rng.integers(3))](rng)
            size = int(rng.integers(80, 118))
            small = np.clip(cv2.resize(small, (size, size), interpolation=cv2.INTER_AREA), 0.02, 1.0)
            centre = np.array([column * 126 + 67, row * 126 + 67]) + rng.integers(-8, 9, 2)
            turn = cv2.getRotationMatrix2D((size / 2, size / 2), float(rng.uniform(-12, 12)), 1.0)
            turn[:, 2] += centre - size / 2
            cv2.warpAffine(small, turn, (_PAPER, _PAPER), image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
            cv2.circle(image, (int(centre[0]), int(centre[1] + size / 2 - 8)), 4, 0.05, -1, cv2.LINE_AA)
    return image


def _page(rng: np.random.Generator) -> Array:
    """Paint a printed page: a title, lines of text, a figure."""
    image = np.full((_PAPER, _PAPER), 0.82)
    _write(image, _word(rng, 9), (50, 60), 1.6, 0.1)
    skip = int(rng.integers(1, 10))
    for line in range(13):
        y = 105 + 30 * line
        if skip <= line < skip + 4:
            continue
        _write(image, " ".join(_word(rng, int(rng.integers(3, 8))) for _ in range(4)), (44, y), 0.75, 0.15)
    y0 = 95 + 30 * skip
    cv2.rectangle(image, (60, y0), (450, y0 + 95), 0.35, -1)
    curve = np.stack([np.linspace(70, 440, 12), y0 + 48 + 34 * np.sin(rng.uniform(0, 6, 12))], 1)
    cv2.polylines(image, [curve.astype(np.int32)[:, None]], False, 0.9, 4, cv2.LINE_AA)
    return np.flipud(image).copy()


def _spines(rng: np.random.Generator) -> Array:
    """Paint the backs of books beside each other: title along the spine, bands, a sign at the foot."""
    width = _PAPER // SPINES_OF_A_TEXTURE
    strips = []
    for _ in range(SPINES_OF_A_TEXTURE):
        back = float(rng.choice([rng.uniform(0.05, 0.3), rng.uniform(0.35, 0.9)]))
        ink = 0.9 if back < 0.35 else 0.08
        strip = np.full((width, _PAPER), back) + 0.01 * noise(rng, _PAPER, slope=0.8)[:width]
        for x in rng.integers(10, _PAPER - 30, int(rng.integers(0, 4))):
            strip[:, x : x + int(rng.integers(4, 24))] = float(rng.uniform(0.1, 0.95))
        _write(strip, _word(rng, int(rng.integers(8, 20))), (int(rng.integers(40, 120)), 23), 0.75, ink)
        cv2.circle(strip, (20, width // 2), 9, ink, -1, cv2.LINE_AA)
        strip[:2] *= 0.5
        strips.append(strip)
    return np.hstack([strip.T for strip in strips])


def _screen(rng: np.random.Generator) -> Array:
    """Paint a screen with windows of text and a picture."""
    image = np.full((_PAPER, _PAPER), float(rng.uniform(0.15, 0.4)))
    for _ in range(3):
        x, y = rng.integers(10, 230), rng.integers(10, 230)
        level = float(rng.choice([0.08, 0.85]))
        cv2.rectangle(image, (int(x), int(y)), (int(x) + 270, int(y) + 250), level, -1)
        cv2.rectangle(image, (int(x), int(y)), (int(x) + 270, int(y) + 22), 0.5, -1)
        for line in range(9):
            text = _word(rng, int(rng.integers(5, 22)))
            _write(image, text, (int(x) + 10, int(y) + 48 + 23 * line), 0.5, 0.9 - level)
    small = cv2.resize(_landscape(rng), (150, 120), interpolation=cv2.INTER_AREA)
    image[20:140, 340:490] = np.flipud(small)
    image[490:] = 0.1
    return np.flipud(image).copy()
