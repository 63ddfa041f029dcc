"""What is painted onto a moving picture is found; what only stands, flickers, trembles or is far away is not."""

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from place_images import DRIVE_SHAPE, Image, bonnet, drive, kitti_images, textured_world

from place_recognition.image_processing.static_regions import StaticRegionDetector

HEIGHT, WIDTH = DRIVE_SHAPE
Paint = Callable[[Image, int], Image]
FOUND = 0.8  # of what is painted
HARMLESS = 0.001  # of the image


def clock(image: Image, index: int) -> Image:
    text = f"12:{index // 10:02d}.{index % 10} CAM 70"
    return np.asarray(cv2.putText(image.copy(), text, (20, 50), cv2.FONT_HERSHEY_SIMPLEX, 1, 255, 2), np.uint8)


def logo(image: Image, index: int) -> Image:
    word = cv2.putText(np.zeros_like(image), "LOGO", (240, 60), cv2.FONT_HERSHEY_SIMPLEX, 1.5, 255, 4)
    return np.where(word > 0, image // 2 + 127, image).astype(np.uint8)


def dirt(image: Image, index: int) -> Image:
    light = np.ones(image.shape, np.float32)
    for center in ((100, 80), (200, 150), (300, 60)):
        cv2.circle(light, center, 9, 0.1, -1)
    return (image * cv2.GaussianBlur(light, (0, 0), 1.5)).astype(np.uint8)


def letterbox(image: Image, index: int) -> Image:
    painted = image.copy()
    painted[:30] = painted[-30:] = 0
    return painted


# Pixels that must be left out; of a clock the digits that change are known by their surroundings, and the inside of a
# bar has nothing that could become a feature.
PAINTED: dict[str, tuple[Paint, tuple[slice, slice]]] = {
    "bonnet": (bonnet, np.s_[184:, :]),
    "clock": (clock, np.s_[30:50, 24:290]),
    "logo": (logo, np.s_[30:58, 245:370]),
    "dirt": (dirt, np.s_[145:155, 195:205]),
    "letterbox": (letterbox, np.s_[24:36, :]),
}


def observe(images: Iterable[Image], detector: StaticRegionDetector | None = None) -> StaticRegionDetector:
    detector = detector or StaticRegionDetector()
    for image in images:
        detector.observe(image)
    return detector


def left_out(detector: StaticRegionDetector, shape: tuple[int, ...] = (HEIGHT, WIDTH)) -> np.ndarray:
    mask = detector.mask(shape)
    return np.zeros(shape, bool) if mask is None else mask == 0


def most_left_out(images: Iterable[Image]) -> float:
    """Largest share of static blocks after any of the images."""
    detector, most = StaticRegionDetector(), 0.0
    for image in images:
        detector.observe(image)
        most = max(most, float(detector.static_blocks.mean()))
    return most


@pytest.mark.parametrize("thing", PAINTED)
def test_what_is_painted_on_is_found_and_the_rest_is_not(thing: str):
    paint, place = PAINTED[thing]
    found = left_out(observe(paint(image, k) for k, image in enumerate(drive(40))))
    assert found[place].mean() > FOUND
    around = np.ones(found.shape, bool)
    margin = 40
    rows, columns = place
    around[max((rows.start or 0) - margin, 0) : (rows.stop or HEIGHT) + margin,
           max((columns.start or 0) - margin, 0) : (columns.stop or WIDTH) + margin] = False  # fmt: skip
    if thing in ("bonnet", "clock", "logo"):
        assert found[around].mean() < HARMLESS


def test_a_plain_drive_has_nothing_static():
    assert most_left_out(drive(60)) == 0.0


def test_an_opaque_thing_takes_a_few_images_with_motion_and_not_more():
    images = [bonnet(image, k) for k, image in enumerate(drive(8))]
    assert not observe(images[:4]).static_blocks.any()
    assert observe(images).static_blocks.mean() > 0.2


def still(count: int, noise: float = 0.0) -> list[Image]:
    rng, image = np.random.default_rng(0), drive(1)[0].astype(float)
    return [np.clip(image + rng.normal(0, noise or 1e-9, image.shape), 0, 255).astype(np.uint8) for _ in range(count)]


@pytest.mark.parametrize("noise", [0.0, 3.0, 15.0, 30.0])
def test_a_standing_camera_teaches_nothing(noise: float):
    assert most_left_out(still(500 if noise == 0 else 100, noise)) == 0.0


def test_light_that_changes_before_a_standing_camera_teaches_nothing():
    image = drive(1)[0]
    assert most_left_out((image * (0.6 + 0.4 * np.sin(k / 3))).astype(np.uint8) for k in range(100)) == 0.0


@pytest.mark.parametrize("sway", [(0.5, 0.5), (0.0, 0.7), (0.7, 0.0)])
def test_a_camera_that_trembles_on_the_spot_teaches_next_to_nothing(sway: tuple[float, float]):
    rng, image = np.random.default_rng(0), drive(1)[0]
    moves = [np.array([[1, 0, x], [0, 1, y]], np.float32) for x, y in rng.normal(0, 1, (100, 2)) * sway]
    images = (cv2.warpAffine(image, move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT) for move in moves)
    assert most_left_out(images) <= 0.01


def test_cars_before_a_standing_camera_do_not_make_the_houses_static():
    house, lorry = drive(1)[0], textured_world(180, 5)[:90]

    def traffic() -> Iterable[Image]:
        for k in range(150):
            image = house.copy()
            for start in range(-180, WIDTH, 240):
                x = start + 15 * k % 240
                begin, end = max(x, 0), min(x + 180, WIDTH)
                if begin < end:
                    image[120:210, begin:end] = lorry[:, begin - x : end - x]
            yield image

    assert most_left_out(traffic()) == 0.0


def test_a_bonnet_stays_known_while_the_car_stands():
    images = [bonnet(image, k) for k, image in enumerate(drive(30))]
    detector = observe(images)
    before = left_out(detector)
    assert np.array_equal(left_out(observe([images[-1]] * 100, detector)), before)


def test_wiped_dirt_is_used_again():
    images = drive(70)
    detector = observe(dirt(image, k) for k, image in enumerate(images[:30]))
    assert detector.static_blocks.any()
    assert not observe(images[30:], detector).static_blocks.any()


def test_dirt_that_comes_later_is_found():
    images = drive(120)
    detector = observe(images[:30])
    found = left_out(observe((dirt(image, k) for k, image in enumerate(images[30:])), detector))
    assert found[PAINTED["dirt"][1]].mean() > 0.5


def test_images_of_other_sizes_in_between_change_nothing_much():
    images = [bonnet(image, k) for k, image in enumerate(drive(30))]
    mixed = [cv2.resize(image, (300, 180), interpolation=cv2.INTER_AREA) if k % 2 else image
             for k, image in enumerate(images)]  # fmt: skip
    detector = observe(mixed)
    assert left_out(detector)[190:].mean() > FOUND
    assert left_out(detector, (180, 300))[142:].mean() > FOUND


@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (20, 64), (3, 700)])
def test_tiny_images_are_no_trouble(shape: tuple[int, int]):
    rng = np.random.default_rng(0)
    detector = observe(rng.integers(0, 255, shape, np.uint8) for _ in range(20))
    assert detector.mask(shape) is None or detector.mask(shape).shape == shape


def test_a_restored_detector_continues_with_the_same_bits():
    images = [clock(bonnet(image, k), k) for k, image in enumerate(drive(40))]
    one = observe(images[:17])
    state = one.state()
    kept = {name: np.copy(value) for name, value in state.items()}
    observe(images[17:], one)
    assert all(np.array_equal(state[name], value) for name, value in kept.items())  # images ahead leave it alone
    other = StaticRegionDetector()
    other.restore(state)
    observe(images[17:], other)
    assert all(np.array_equal(a, b) for a, b in zip(one.state().values(), other.state().values(), strict=True))


# Nothing is static in a real drive, with what is far away, straight ahead on a motorway and in a narrow street.
@pytest.mark.parametrize(("sequence", "count"), [("01", 51), ("05", 60), ("06", 51), ("07", 160)])
def test_nothing_is_static_in_a_real_drive(test_data: Path, sequence: str, count: int):
    assert most_left_out(kitti_images(test_data, sequence, range(count))) <= 0.002


@pytest.mark.parametrize("sequence", ["01", "05"])
def test_a_strip_of_another_picture_is_found_in_a_real_drive(test_data: Path, sequence: str):
    strip = kitti_images(test_data, "07", range(100, 101))[0][150:250]
    images = kitti_images(test_data, sequence, range(50))
    for image in images:
        image[-100:] = cv2.resize(strip, (image.shape[1], 100))
    height, width = images[0].shape
    found = left_out(observe(images), (height, width))
    corners = cv2.goodFeaturesToTrack(images[-1][-96:], 300, 0.01, 5)[:, 0].astype(int)
    assert found[height - 96 + corners[:, 1], corners[:, 0]].mean() > 0.97
    assert found[: height - 130].mean() < 0.002


def test_a_corridor_with_text_taken_once_in_two_seconds(test_data: Path):
    folder = test_data / "corridor_two_laps"
    images = [cv2.imread(str(folder / f"{k}.jpg"), cv2.IMREAD_GRAYSCALE) for k in range(1, 40)]
    assert most_left_out(images) == 0.0
    found = left_out(observe(clock(image, k) for k, image in enumerate(images)), images[0].shape)
    assert found[PAINTED["clock"][1]].mean() > FOUND
