"""The network that ships sees what it should: the same on any number of threads and in another program, and places."""

from importlib.resources import files

import cv2
import numpy as np
import pytest
from place_images import textured_world

from place_recognition.image_processing.small_cnn import FILE, HEIGHT, WIDTH, SmallCnn, pool_cells, prepare

WORLD = textured_world(640, seed=1, height=320)


def in_color(image, gains=(1.0, 0.6, 0.3)):
    return (image[:, :, None] * np.array(gains)).astype(np.uint8)


def test_the_bits_do_not_depend_on_the_number_of_threads():
    before, vectors = cv2.getNumThreads(), []
    try:
        for threads in (1, 2, 4):
            cv2.setNumThreads(threads)
            vectors.append(SmallCnn().describe(in_color(WORLD)))
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(vectors[0], vectors[1])
    np.testing.assert_array_equal(vectors[0], vectors[2])


def test_another_program_computes_the_same_from_red_green_and_blue():
    onnxruntime = pytest.importorskip("onnxruntime")
    path = files("place_recognition.image_processing").joinpath(FILE)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    image = in_color(cv2.resize(WORLD, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))
    source = ((image.astype(np.float32) - 127) / 128).transpose(2, 0, 1)[None]
    expected = pool_cells(session.run(None, {"image": source})[0][0])
    np.testing.assert_allclose(SmallCnn().describe(image), expected, atol=1e-4)
    assert np.abs(SmallCnn().describe(image[:, :, ::-1]) - expected).max() > 0.01  # blue for red is another image


def test_grey_images_are_seen_as_colour_without_any():
    np.testing.assert_array_equal(SmallCnn().describe(WORLD), SmallCnn().describe(np.dstack([WORLD] * 3)))


def test_vectors_have_unit_length_and_even_images_are_zeros():
    vector = SmallCnn().describe(WORLD)
    assert vector.shape == (2304,)
    assert np.linalg.norm(vector) == pytest.approx(1, rel=1e-6)
    for value in (0, 77, 255):
        assert not SmallCnn().describe(np.full((100, 200), value, np.uint8)).any()
        assert not SmallCnn().describe(np.full((100, 200, 3), value, np.uint8)).any()


@pytest.mark.parametrize("place", [(0, 0), (33, 57), (99, 199)])
def test_an_image_with_one_pixel_that_differs_is_not_even(place):
    image = np.full((100, 200, 3), 77, np.uint8)
    image[place][2] = 78
    assert np.linalg.norm(SmallCnn().describe(image)) == pytest.approx(1, rel=1e-6)


def test_a_dark_view_of_a_place_is_more_alike_than_another_place():
    world, descriptor = textured_world(1600, seed=8), SmallCnn()
    places = [np.ascontiguousarray(world[:, s : s + 320]) for s in range(0, 1280, 160)]
    day = np.array([descriptor.describe(place) for place in places])
    night = np.array([descriptor.describe((place * 0.25).astype(np.uint8)) for place in places])
    assert (night @ day.T).argmax(axis=1).tolist() == list(range(len(places)))


def test_each_place_of_the_map_counts_alike_and_pairs_of_columns_are_one_cell():
    activations = np.zeros((2, 1, 4), np.float32)
    activations[0, 0, :2], activations[1, 0, 2:] = 1, 100
    np.testing.assert_allclose(pool_cells(activations), np.array([1, 0, 0, 1]) / np.sqrt(2), rtol=1e-6)
    np.testing.assert_array_equal(pool_cells(np.zeros((2, 3, 4), np.float32)), np.zeros(12))


def test_the_input_is_of_the_size_of_the_network_and_from_about_minus_to_plus_one():
    prepared = prepare(np.full((7, 9, 3), 255, np.uint8))
    assert prepared.shape == (1, 3, HEIGHT, WIDTH)
    np.testing.assert_allclose(prepared, 1, rtol=1e-6)
    np.testing.assert_allclose(prepare(np.zeros((7, 9), np.uint8)), -127 / 128, rtol=1e-6)


@pytest.mark.parametrize(
    "image", [np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.zeros((0, 4), np.uint8)]
)
def test_what_is_no_image_is_refused(image):
    with pytest.raises(ValueError, match=r"expected an image \(H, W\) or \(H, W, 3\) uint8, got"):
        SmallCnn().describe(image)
