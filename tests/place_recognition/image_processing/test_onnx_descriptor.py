"""A network that the tests make is read, fed and understood; other files are refused in one line."""

import numpy as np
import pytest
from place_images import textured_world

from place_recognition.image_processing.global_descriptors import make_global_descriptor
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.onnx_descriptor import OnnxDescriptor
from place_recognition.image_processing.onnx_network import OnnxConfig
from place_recognition.paradigms.whole_images import GlobalDescriptorMatching
from place_recognition.recognizer import ObservedImage

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

IMAGE = textured_world(100, seed=1, height=60)


@pytest.fixture
def network(tmp_path):
    """Writes a network: its input's shape and type, and the operations from "image" to "out"."""

    def write(shape, operations=(("Flatten", {}),), kind=onnx.TensorProto.FLOAT, name="net.onnx", metadata=None):
        names = ["image", *[f"x{k}" for k in range(len(operations) - 1)], "out"]
        nodes = [
            onnx.helper.make_node(op, [names[k]], [names[k + 1]], **options)
            for k, (op, options) in enumerate(operations)
        ]
        source = onnx.helper.make_tensor_value_info("image", kind, shape)
        target = onnx.helper.make_tensor_value_info("out", kind, None)
        graph = onnx.helper.make_graph(nodes, "net", [source], [target])
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
        onnx.helper.set_model_props(model, metadata or {})
        onnx.save(model, tmp_path / name)
        return tmp_path / name

    return write


COLOR = np.random.default_rng(3).integers(0, 256, (6, 10, 3)).astype(np.uint8)
PLAIN = {"mean": "0", "std": "1"}  # values from 0 to 1

POOLED = (("AveragePool", {"kernel_shape": [4, 4], "strides": [4, 4]}), ("Flatten", {}))


def test_grey_images_become_three_channels_normalised_as_for_imagenet(network):
    vector = OnnxDescriptor(network([1, 3, 6, 10])).describe(np.full((6, 10), 200, np.uint8))
    grey = (200 / 255 - np.array([0.485, 0.456, 0.406])) / [0.229, 0.224, 0.225]
    expected = np.repeat(grey, 60)
    np.testing.assert_allclose(vector, expected / np.linalg.norm(expected), rtol=1e-5)


def test_a_network_of_one_channel_gets_one(network):
    vector = OnnxDescriptor(network([1, 1, 60, 100])).describe(IMAGE)
    expected = (IMAGE.ravel() / 255 - 0.449) / 0.226
    np.testing.assert_allclose(vector, expected / np.linalg.norm(expected), rtol=1e-3, atol=1e-5)


def test_open_sizes_are_filled_from_the_configuration(network):
    path = network(["batch", 3, "height", "width"], POOLED)
    assert OnnxDescriptor(path).describe(IMAGE).shape == (3 * 56 * 56,)
    assert OnnxDescriptor(path, OnnxConfig(height=8, width=16)).describe(IMAGE).shape == (3 * 2 * 4,)


@pytest.mark.parametrize("shape", [(376, 1241), (5, 900), (1, 1)])
def test_images_of_all_sizes_become_vectors_of_one_size_and_unit_length(network, shape):
    vector = OnnxDescriptor(network([1, 3, 32, 32], POOLED)).describe(np.full(shape, 9, np.uint8))
    assert vector.shape == (192,)
    assert vector.dtype == np.float32
    assert np.linalg.norm(vector) == pytest.approx(1, rel=1e-6)


def test_the_kind_tells_networks_apart(network):
    first, second = network([1, 3, 8, 8], name="a.onnx"), network([1, 3, 16, 16], name="b.onnx")
    kinds = [OnnxDescriptor(path).kind for path in (first, second, first)]
    assert kinds[0] == kinds[2] != kinds[1]
    assert kinds[0].startswith("onnx-a-")


def test_a_network_recognises_a_lap_driven_twice(network):
    world = textured_world(1600, seed=8)
    lap = [np.ascontiguousarray(world[:, s : s + 320]) for s in range(0, 1240, 31)]
    proposer = GlobalDescriptorMatching(make_global_descriptor(f"onnx:{network([1, 3, 32, 32], POOLED)}"))
    nothing = LocalFeatures(*(np.empty(shape, np.float32) for shape in ((0, 2), 0, 0, (0, 8))))
    observed = [ObservedImage(i, image, nothing, 2.0 * i, max(i - 20, -1)) for i, image in enumerate(lap + lap)]
    proposals = [p for image in observed for p in proposer.observe(image)]
    assert all(p.locations[0] == p.query - 40 and p.scores[0] == pytest.approx(1) for p in proposals[40:])


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.onnx: expected an ONNX file, found none: check the path"):
        make_global_descriptor(f"onnx:{tmp_path / 'none.onnx'}")


def test_a_file_that_holds_no_network_is_named_in_one_line(tmp_path):
    path = tmp_path / "text.onnx"
    path.write_text("these are not the weights")
    with pytest.raises(
        ValueError, match=r"text\.onnx: expected an ONNX network, found: .*: export the model"
    ) as caught:
        OnnxDescriptor(path)
    assert "\n" not in str(caught.value)


def test_a_damaged_network_is_named(network):
    path = network([1, 3, 8, 8])
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(ValueError, match=r"net\.onnx: expected an ONNX network, found"):
        OnnxDescriptor(path)


@pytest.mark.parametrize("shape", [[1, 8, 8, 3], [1, 3, 8], [4, 3, 8, 8], [1, 2, 8, 8]])
def test_inputs_of_other_shapes_are_refused_with_what_was_found(network, shape):
    with pytest.raises(ValueError, match=r"one input \(1, 1 or 3, height, width\) of float32, found tensor\(float\)"):
        OnnxDescriptor(network(shape))


def test_inputs_of_other_numbers_are_refused(network):
    with pytest.raises(ValueError, match=r"of float32, found tensor\(double\) \[1, 3, 8, 8\]: export the model"):
        OnnxDescriptor(network([1, 3, 8, 8], kind=onnx.TensorProto.DOUBLE))


def test_an_answer_that_is_no_number_is_refused(network):
    path = network([1, 3, 8, 8], (("Sqrt", {}), ("Flatten", {})))
    with pytest.raises(ValueError, match=r"net\.onnx: expected finite numbers as the first output"):
        OnnxDescriptor(path).describe(np.zeros((8, 8), np.uint8))


def test_where_the_library_is_missing_its_extra_is_named(network, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r"found none: pip install 'revisit-slam\[onnx\]'"):
        OnnxDescriptor(network([1, 3, 8, 8]))


def unit(values):
    return values.ravel() / np.linalg.norm(values)


def test_colour_reaches_the_network_red_first_and_grey_is_enough_for_one_channel(network):
    red_first = COLOR.transpose(2, 0, 1) / 255
    descriptor = OnnxDescriptor(network([1, 3, 6, 10], metadata=PLAIN))
    assert descriptor.takes_color
    np.testing.assert_allclose(descriptor.describe(COLOR), unit(red_first), rtol=1e-5)
    gray = OnnxDescriptor(network([1, 1, 6, 10], metadata=PLAIN, name="grey.onnx"))
    assert not gray.takes_color
    luma = np.tensordot([0.299, 0.587, 0.114], red_first, axes=1)
    np.testing.assert_allclose(gray.describe(COLOR), unit(luma), atol=1e-3)


def test_the_file_says_size_and_normalisation_and_settings_go_before_it(network):
    said = {"height": "8", "width": "12", "mean": "0.5, 0.25 0", "std": "0.5"}
    path = network([1, 3, "height", "width"], metadata=said)
    image = np.full((40, 60), 255, np.uint8)
    expected = np.repeat([(1 - 0.5) / 0.5, (1 - 0.25) / 0.5, 1 / 0.5], 8 * 12)
    np.testing.assert_allclose(OnnxDescriptor(path).describe(image), unit(expected), rtol=1e-5)
    config = OnnxConfig(height=4, mean=(0.0,), deviation=(1.0, 2.0, 4.0))
    expected = np.repeat([1, 1 / 2, 1 / 4], 4 * 12)
    np.testing.assert_allclose(OnnxDescriptor(path, config).describe(image), unit(expected), rtol=1e-5)


def test_an_image_of_another_aspect_is_stretched_or_loses_its_borders_as_the_file_says(network):
    image = np.zeros((6, 30), np.uint8)
    image[:, 10:20] = 255
    cropped = OnnxDescriptor(network([1, 1, 6, 10], metadata=PLAIN | {"crop": "1"})).describe(image)
    np.testing.assert_allclose(cropped, unit(np.ones(60)), rtol=1e-5)
    stretched = OnnxDescriptor(network([1, 1, 6, 10], metadata=PLAIN, name="whole.onnx")).describe(image)
    assert stretched.reshape(6, 10)[:, [0, 9]].max() == 0 < stretched.reshape(6, 10)[:, 5].min()


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"mean": "a b c"}, r"net\.onnx: expected 1 or 3 numbers as metadata 'mean', found 'a b c': export"),
        ({"std": "1 1"}, r"expected 1 or 3 numbers as metadata 'std', found '1 1'"),
        ({"std": "0"}, r"expected standard deviations above 0, found \(0\.0,\)"),
        ({"height": "nan"}, r"expected 1 numbers as metadata 'height'"),
    ],
)
def test_metadata_that_are_no_numbers_are_named(network, metadata, message):
    with pytest.raises(ValueError, match=message):
        OnnxDescriptor(network([1, 3, 6, 10], metadata=metadata))


def test_a_network_of_several_outputs_is_no_descriptor(network):
    path = network([1, 3, 6, 10], (("Abs", {}), ("Flatten", {})))
    model = onnx.load(path)
    model.graph.output.append(onnx.helper.make_tensor_value_info("x0", onnx.TensorProto.FLOAT, None))
    onnx.save(model, path)
    with pytest.raises(ValueError, match=r"expected a network with one output, the descriptor, found out, x0: export"):
        OnnxDescriptor(path)
