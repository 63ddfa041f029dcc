"""A network that the tests make is read, fed and understood; other files are refused in one line."""

import numpy as np
import pytest
from place_images import textured_world

from place_recognition.image_processing.global_descriptors import make_global_descriptor
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.onnx_descriptor import OnnxConfig, OnnxDescriptor
from place_recognition.paradigms.whole_images import GlobalDescriptorMatching
from place_recognition.recognizer import ObservedImage

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

IMAGE = textured_world(100, seed=1, height=60)


@pytest.fixture
def network(tmp_path):
    """Writes a network: its input's shape and type, and the operations from "image" to "out"."""

    def write(shape, operations=(("Flatten", {}),), kind=onnx.TensorProto.FLOAT, name="net.onnx"):
        names = ["image", *[f"x{k}" for k in range(len(operations) - 1)], "out"]
        nodes = [
            onnx.helper.make_node(op, [names[k]], [names[k + 1]], **options)
            for k, (op, options) in enumerate(operations)
        ]
        source = onnx.helper.make_tensor_value_info("image", kind, shape)
        target = onnx.helper.make_tensor_value_info("out", kind, None)
        graph = onnx.helper.make_graph(nodes, "net", [source], [target])
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
        onnx.save(model, tmp_path / name)
        return tmp_path / name

    return write


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
