"""A feature network that the tests make keeps the contract of all extractors; other files are refused in one line."""

import cv2
import numpy as np
import pytest
from place_images import textured_world

from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.onnx_features import OnnxFeatures, OnnxFeaturesConfig

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
helper, numpy_helper = onnx.helper, onnx.numpy_helper

SIDE = 9  # of the patch that describes a point
POINTS = 120
WORLD = textured_world(400, seed=4)


def patches():
    """A convolution whose channels are the pixels of a patch, less its mean."""
    kernel = np.eye(SIDE * SIDE, dtype=np.float32).reshape(-1, 1, SIDE, SIDE)
    return kernel - np.float32(1 / SIDE**2)


@pytest.fixture(scope="module")
def model():
    """Local maxima of a Laplacian, strongest first, described by the pixels around them; any size of image."""
    laplacian = cv2.Laplacian(np.pad(np.float32([[1]]), 3), cv2.CV_32F).reshape(1, 1, 7, 7) / -4
    constants = {
        "laplacian": laplacian.astype(np.float32),
        "patches": patches(),
        "border": np.array([0, 0, 3, 3, 0, 0, 3, 3]),
        "count": np.array([POINTS]),
        "flat": np.array([-1]),
        "columns": np.array([SIDE * SIDE, -1]),
        "zero": np.float32(0),
        "last": np.array([3]),
        "axis": np.array([1]),
    }
    make = helper.make_node
    nodes = [
        make("Pad", ["image", "border"], ["wider"], mode="reflect"),
        make("Conv", ["wider", "laplacian"], ["blobs"]),
        make("MaxPool", ["blobs"], ["largest"], kernel_shape=[5, 5], pads=[2] * 4),
        make("Equal", ["blobs", "largest"], ["is_peak"]),
        make("Where", ["is_peak", "blobs", "zero"], ["peaks"]),
        make("Reshape", ["peaks", "flat"], ["values"]),
        make("TopK", ["values", "count"], ["scores", "places"]),
        make("Shape", ["image"], ["shape"]),
        make("Gather", ["shape", "last"], ["width"]),
        make("Mod", ["places", "width"], ["x"]),
        make("Div", ["places", "width"], ["y"]),
        make("Unsqueeze", ["x", "axis"], ["xs"]),
        make("Unsqueeze", ["y", "axis"], ["ys"]),
        make("Concat", ["xs", "ys"], ["whole"], axis=1),
        make("Cast", ["whole"], ["keypoints"], to=onnx.TensorProto.FLOAT),
        make("Conv", ["image", "patches"], ["around"], pads=[SIDE // 2] * 4),
        make("Reshape", ["around", "columns"], ["listed"]),
        make("Gather", ["listed", "places"], ["chosen"], axis=1),
        make("Transpose", ["chosen"], ["descriptors"], perm=[1, 0]),
    ]
    kinds = {"keypoints": (POINTS, 2), "descriptors": (POINTS, SIDE * SIDE), "scores": (POINTS,)}
    graph = helper.make_graph(
        nodes,
        "features",
        [helper.make_tensor_value_info("image", onnx.TensorProto.FLOAT, [1, 1, "height", "width"])],
        [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape) for name, shape in kinds.items()],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.fixture
def save(model, tmp_path):
    """Writes the network, changed by a function, with metadata."""

    def write(metadata=None, change=None):
        changed = onnx.ModelProto()
        changed.CopyFrom(model)
        if change is not None:
            change(changed.graph)
        helper.set_model_props(changed, metadata or {})
        onnx.save(changed, tmp_path / "net.onnx")
        return tmp_path / "net.onnx"

    return write


def replace_output(name, operation, **attributes):
    """A change that puts an operation before an output."""

    def change(graph):
        for node in graph.node:
            node.output[:] = ["raw" if value == name else value for value in node.output]
        graph.node.append(helper.make_node(operation, ["raw"], [name], **attributes))
        kept = [output for output in graph.output if output.name != name]
        del graph.output[:]
        graph.output.extend([*kept, helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None)])

    return change


def test_the_contract_of_all_extractors_is_kept(save):
    path = save()
    first, second = (make_extractor(f"onnx:{path}", 100).extract(WORLD) for _ in range(2))
    assert 80 <= len(first) <= 100
    assert np.all(np.diff(first.responses) <= 0)
    assert first.descriptors.dtype == first.pixels.dtype == first.scales.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(first.descriptors, axis=1), 1, rtol=1e-5)
    assert (first.scales > 0.5).all()
    np.testing.assert_array_equal(first.descriptors, second.descriptors)
    np.testing.assert_array_equal(first.pixels, second.pixels)
    with pytest.raises(ValueError, match=r"grey image \(H, W\) uint8, got \(8, 9, 3\)"):
        make_extractor(f"onnx:{path}").extract(np.zeros((8, 9, 3), np.uint8))


@pytest.mark.parametrize("shape", [(376, 1241), (20, 24), (3, 500), (1, 1)])
def test_blank_and_tiny_images_have_no_features(save, shape):
    features = OnnxFeatures(save()).extract(np.full(shape, 77, np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, SIDE * SIDE)


@pytest.mark.parametrize(
    "metadata", [{}, {"max_side": "200"}, {"multiple": "32"}, {"max_side": "160", "multiple": "8"}]
)
def test_key_points_lie_on_the_image_whatever_the_size_of_the_input(save, metadata):
    image, centers = np.full((240, 320), 60, np.uint8), []
    for k in range(12):
        x, y = 30 + 70 * (k % 4), 40 + 70 * (k // 4)
        centers.append((x, y))
        cv2.circle(image, (x, y), 3, 255, -1)
    blurred = cv2.GaussianBlur(image, (0, 0), 2.5)
    features = OnnxFeatures(save(metadata), OnnxFeaturesConfig(12)).extract(blurred)
    for pixel in features.pixels:
        assert np.abs(np.array(centers) - pixel).max(axis=1).min() < 2.5


def test_half_the_size_is_half_a_pixel_off_unless_centres_are_kept(save):
    image = textured_world(400, seed=4, height=300)
    small = cv2.resize(image, (200, 150), interpolation=cv2.INTER_AREA)
    whole = OnnxFeatures(save({"max_side": "200"}), OnnxFeaturesConfig(50)).extract(image)
    alone = OnnxFeatures(save(), OnnxFeaturesConfig(50)).extract(small)
    np.testing.assert_allclose(np.sort(whole.responses), np.sort(alone.responses), atol=1e-5)
    near = np.abs(whole.pixels[:, None] - (alone.pixels * 2 + 0.5)).max(axis=2).min(axis=1)
    np.testing.assert_allclose(near, 0, atol=1e-4)


def test_normalised_key_points_become_pixels(save):
    plain = OnnxFeatures(save()).extract(WORLD)
    height, width = WORLD.shape

    def normalize(graph):
        replace_output("keypoints", "Mul")(graph)
        graph.node[-1].input.append("factor")
        graph.node[-1].output[0] = "scaled"
        graph.node.append(helper.make_node("Sub", ["scaled", "one"], ["keypoints"]))
        factor = np.array([2 / (width - 1), 2 / (height - 1)], np.float32)
        graph.initializer.extend(
            [numpy_helper.from_array(factor, "factor"), numpy_helper.from_array(np.float32(1), "one")]
        )

    found = OnnxFeatures(save({"keypoints": "normalized"}, normalize)).extract(WORLD)
    np.testing.assert_allclose(found.pixels, plain.pixels, atol=1e-3)


def test_outputs_may_have_a_batch_of_one_and_descriptors_lie_on_their_side(save):
    plain = OnnxFeatures(save()).extract(WORLD)
    turned = OnnxFeatures(save(change=replace_output("descriptors", "Transpose", perm=[1, 0]))).extract(WORLD)
    np.testing.assert_allclose(turned.descriptors, plain.descriptors, atol=1e-6)

    def batch(graph):
        replace_output("descriptors", "Unsqueeze")(graph)
        graph.node[-1].input.append("front")
        graph.initializer.append(numpy_helper.from_array(np.array([0]), "front"))

    batched = OnnxFeatures(save(change=batch)).extract(WORLD)
    np.testing.assert_allclose(batched.descriptors, plain.descriptors, atol=1e-6)


def test_a_mask_leaves_out_its_pixels(save):
    mask = np.zeros(WORLD.shape, np.uint8)
    mask[:, : WORLD.shape[1] // 2] = 255
    features = OnnxFeatures(save()).extract(WORLD, mask)
    assert len(features) > 20
    assert (features.pixels[:, 0] < WORLD.shape[1] / 2).all()


def test_features_of_a_moved_view_move_with_it(save):
    extractor = OnnxFeatures(save())
    first, second = extractor.extract(WORLD[:, :-20].copy()), extractor.extract(WORLD[:, 20:].copy())
    nearest = (first.descriptors @ second.descriptors.T).argmax(axis=1)
    moved = first.pixels - second.pixels[nearest]
    assert (np.abs(moved - [20, 0]).max(axis=1) < 1e-3).mean() > 0.7


def test_a_network_without_the_three_outputs_is_refused_by_name(save):
    def rename(graph):
        replace_output("scores", "Abs")(graph)
        graph.node[-1].output[0] = graph.output[-1].name = "strength"

    with pytest.raises(
        ValueError, match=r"net\.onnx: expected .* keypoints, descriptors, scores, found .*without scores"
    ):
        OnnxFeatures(save(change=rename))


def test_outputs_of_other_shapes_and_no_numbers_are_refused(save):
    with pytest.raises(ValueError, match=r"expected keypoints \(N, 2\), .*found keypoints \(2, 120\).*: export"):
        OnnxFeatures(save(change=replace_output("keypoints", "Transpose", perm=[1, 0])))

    def spoil(graph):
        replace_output("descriptors", "Sqrt")(graph)

    with pytest.raises(ValueError, match=r"net\.onnx: expected finite numbers as outputs, found some that are not"):
        OnnxFeatures(save(change=spoil))


def test_metadata_that_cannot_be_sides_are_refused(save):
    with pytest.raises(ValueError, match=r"expected sides of pixels as metadata, found multiple 0"):
        OnnxFeatures(save({"multiple": "0"}))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.onnx: expected an ONNX file, found none"):
        make_extractor(f"onnx:{tmp_path / 'none.onnx'}")
