"""Export a published network for `--descriptor onnx:FILE` or `--features onnx:FILE`.

    python benchmarks/export_networks.py megaloc megaloc.onnx
    python benchmarks/export_networks.py aliked-n16 aliked.onnx --repository ALIKED

An environment of its own with torch, torchvision, onnx and onnxruntime is needed; the product needs none of them but
the last. Global descriptors come by torch.hub from the repositories of their authors, whose licences hold:
docs/learned_descriptors.md lists them. MixVPR and the local features have no entry for torch.hub: give the cloned
repository by --repository, and the file of the weights by --weights (those of ALIKED lie in its repository).

The answer of the file is compared with that of the authors' model. `--stand-in` exports a small random network of the
same interface instead, which shows that the export works where there is no network access; for local features it is the
authors' network with random weights, the control of every measurement.
"""

import argparse
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from command_line import existing, run_script

from slam.errors import DataError

PACKAGES = ("torch", "torchvision", "onnx", "onnxruntime")
IMAGENET = {"mean": "0.485 0.456 0.406", "std": "0.229 0.224 0.225"}


@dataclass(frozen=True)
class Recipe:
    """A network, and what its authors feed it.

    Attributes:
        load: makes it, of the given repository and weights.
        height: height of the input, pixels.
        width: width of the input, pixels.
        length: numbers of its descriptor.
    """

    load: Callable[[Path | None, Path | None], Any]
    height: int
    width: int
    length: int


def _hub(repository: str, entry: str, **options: Any) -> Callable[[Path | None, Path | None], Any]:
    def load(folder: Path | None, weights: Path | None) -> Any:
        import torch

        return torch.hub.load(repository, entry, **options)

    return load


def _mixvpr(folder: Path | None, weights: Path | None) -> Any:
    import torch

    if folder is None or weights is None:
        raise DataError("mixvpr: expected --repository and --weights, found none; clone amaralibey/MixVPR")
    sys.path.insert(0, str(folder))
    from main import VPRModel

    sides = {"in_channels": 1024, "in_h": 20, "in_w": 20, "out_channels": 1024}
    model = VPRModel(
        backbone_arch="resnet50",
        layers_to_crop=[4],
        agg_arch="MixVPR",
        agg_config={**sides, "mix_depth": 4, "mlp_ratio": 1, "out_rows": 4},
    )
    model.load_state_dict(torch.load(weights, map_location="cpu"))
    return model


RECIPES = {
    "megaloc": Recipe(_hub("gmberton/MegaLoc", "get_trained_model"), 322, 322, 8448),
    "salad": Recipe(_hub("serizba/salad", "dinov2_salad"), 322, 322, 8448),
    "eigenplaces": Recipe(
        _hub("gmberton/EigenPlaces", "get_trained_model", backbone="ResNet50", fc_output_dim=2048), 512, 512, 2048
    ),
    "cosplace": Recipe(
        _hub("gmberton/CosPlace", "get_trained_model", backbone="ResNet50", fc_output_dim=2048), 512, 512, 2048
    ),
    "mixvpr": Recipe(_mixvpr, 320, 320, 4096),
}


def main() -> None:
    """Load, export, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=(*RECIPES, *ALIKED))
    parser.add_argument("out", type=Path)
    parser.add_argument("--repository", type=existing)
    parser.add_argument("--weights", type=existing)
    parser.add_argument("--stand-in", action="store_true")
    parser.add_argument("--count", type=int, default=1000, help="maximum number of key points of local features")
    given = parser.parse_args()
    if missing := [name for name in PACKAGES if importlib.util.find_spec(name) is None]:
        raise DataError(
            f"export: expected {', '.join(PACKAGES)}, found no {', '.join(missing)}: pip install {' '.join(PACKAGES)}"
        )
    if given.name in ALIKED:
        export_aliked(given)
        return
    recipe = RECIPES[given.name]
    model = make_stand_in(recipe.length) if given.stand_in else recipe.load(given.repository, given.weights)
    export(model.eval(), recipe, given.out)
    print(f"{given.out}: {given.out.stat().st_size} bytes, {recipe.length} numbers of {recipe.height} x {recipe.width}")


def export(model: Any, recipe: Recipe, out: Path) -> None:
    """Write the file with its metadata, and check its answer against that of the model."""
    import numpy as np
    import onnx
    import onnxruntime
    import torch

    image = torch.rand(1, 3, recipe.height, recipe.width, generator=torch.Generator().manual_seed(0))
    for parameter in model.parameters():
        parameter.requires_grad_(False)
    torch.onnx.export(
        model, (image,), str(out), input_names=["image"], output_names=["descriptor"], opset_version=17, dynamo=False
    )
    saved = onnx.load(out)
    onnx.helper.set_model_props(saved, IMAGENET)
    onnx.save(saved, out)
    with torch.no_grad():
        expected = model(image).numpy()
    found = onnxruntime.InferenceSession(str(out)).run(None, {"image": image.numpy()})[0]
    if found.shape != (1, recipe.length) or np.abs(found - expected).max() > 1e-3 * np.abs(expected).max():
        raise SystemExit(f"{out}: expected the model's answer (1, {recipe.length}), found another one {found.shape}")


def make_stand_in(length: int) -> Any:
    """Make a small random network from images (N, 3, H, W) to descriptors (N, length) of unit length."""
    import torch

    class StandIn(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.body = torch.nn.Sequential(
                torch.nn.Conv2d(3, 8, 7, stride=4), torch.nn.ReLU(), torch.nn.AdaptiveAvgPool2d(1)
            )
            self.head = torch.nn.Linear(8, length)

        def forward(self, images: Any) -> Any:
            return torch.nn.functional.normalize(self.head(self.body(images).flatten(1)))

    torch.manual_seed(0)
    return StandIn()


ALIKED = ("aliked-t16", "aliked-n16", "aliked-n16rot", "aliked-n32")
STRIDE = 32  # both sides of the input are multiples of it, pixels
# Sizes at which the file is compared with the model: it is traced at the first, and holds for any.
CHECKED_SIZES = ((480, 640), (384, 1248), (640, 480))
MAX_DISTANCE_PX, MIN_COSINE, MIN_SHARE = 0.01, 0.9999, 0.99
FLAT_PX, TEMPERATURE = (
    2,
    0.1,
)  # half a side of the window in which a key point is refined, and how sharp its peak counts


def export_aliked(given: argparse.Namespace) -> None:
    """Write the file of an ALIKED network (Zhao et al., 2023), and check its answer against that of the model.

    Raises:
        DataError: there is no repository of the authors, or the file answers otherwise than the model.
    """
    if given.repository is None or not (given.repository / "nets" / "aliked.py").is_file():
        raise DataError(f"{given.name}: expected --repository with nets/aliked.py, found none; clone Shiaoming/ALIKED")
    import onnx
    import torch

    sys.path.insert(0, str(given.repository))
    sys.modules["custom_ops"] = None  # type: ignore[assignment]  # compiled by few; without it the model has Python code
    from nets import aliked

    torch.manual_seed(0)
    load_its_own = not (given.stand_in or given.weights)
    model = aliked.ALIKED(given.name, device="cpu", top_k=given.count, load_pretrained=load_its_own).eval()
    if given.weights:
        model.load_state_dict(torch.load(given.weights, map_location="cpu"))
    for parameter in model.parameters():
        parameter.requires_grad_(False)
    images = [make_picture(*size) for size in CHECKED_SIZES]
    expected = [answer_of_authors(model, image) for image in images]
    aliked.InputPadder = NoPadding
    torch.onnx.export(
        make_exportable(model, given.count),
        (images[0],),
        str(given.out),
        input_names=["image"],
        output_names=["keypoints", "descriptors", "scores"],
        dynamic_axes={
            "image": {2: "height", 3: "width"},
            **{name: {0: "count"} for name in ("keypoints", "descriptors", "scores")},
        },
        opset_version=17,
        dynamo=False,
    )
    saved = onnx.load(given.out)
    onnx.helper.set_model_props(saved, {"multiple": str(STRIDE)})
    onnx.save(saved, given.out)
    check_features(given.out, images, expected)
    print(
        f"{given.out}: {given.out.stat().st_size} bytes, at most {given.count} key points of {len(expected[0][1][0])}"
    )


def answer_of_authors(model: Any, image: Any) -> tuple[Any, Any]:
    """Key points (N, 2) in pixels and descriptors (N, D) by the model's own functions."""
    import torch

    with torch.no_grad():
        features, scores = model.extract_dense_map(image)
        points, *_ = model.dkd(scores)
        descriptors, _ = model.desc_head(features, points)
    height, width = image.shape[2:]
    pixels = (points[0] + 1) / 2 * torch.tensor([width - 1, height - 1])
    return pixels.numpy(), descriptors[0].numpy()


def check_features(out: Path, images: Any, expected: Any) -> None:
    """Compare the key points of a file with those of the model, which may come in another order.

    Raises:
        DataError: more than a few key points of the file are not among the model's, or are described otherwise.
    """
    import numpy as np
    import onnxruntime

    session = onnxruntime.InferenceSession(str(out))
    for image, (pixels, descriptors) in zip(images, expected, strict=True):
        found, described, _ = session.run(None, {"image": image.numpy()})
        distances = np.linalg.norm(found[:, None] - pixels[None], axis=2)
        nearest = distances.argmin(axis=1)
        cosines = (described * descriptors[nearest]).sum(axis=1)
        agree = (distances.min(axis=1) < MAX_DISTANCE_PX) & (cosines > MIN_COSINE)
        size = " x ".join(str(side) for side in image.shape[2:])
        print(f"{size}: {len(found)} key points, {agree.mean():.4f} of them and of their descriptors are the model's")
        if not len(found) or agree.mean() < MIN_SHARE:
            raise DataError(f"{out}: expected the model's key points at {size}, found {agree.mean():.2f} of them: "
                            "other versions of the repository or of torch?")  # fmt: skip


class NoPadding:
    """In place of the model's: the reader of the file makes both sides multiples of the stride."""

    def __init__(self, *sides: Any) -> None:
        pass

    def pad(self, image: Any) -> Any:
        """Return the image."""
        return image

    unpad = pad


def make_exportable(model: Any, count: int) -> Any:
    """Make a module from an image (1, 3, H, W) to key points, descriptors and scores, of operations that ONNX has.

    ONNX Runtime has no deformable convolution on processors, and the model's detector fixes the size of the image.
    """
    import types

    import torch
    from nets.soft_detect import simple_nms

    for module in model.modules():
        if type(module).__name__ == "DeformableConv2d":
            module.forward = types.MethodType(_convolve_deformed, module)

    class ThreeOutputs(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, image: Any) -> tuple[Any, Any, Any]:
            features, scores = self.model.extract_dense_map(image)
            pixels = _find_peaks(scores, simple_nms(scores, FLAT_PX), count)
            strengths = _sample(scores, pixels[None, None])[0, 0, 0]
            return pixels, _describe(self.model.desc_head, features, pixels), strengths

    return ThreeOutputs()


def _find_peaks(scores: Any, peaks: Any, count: int) -> Any:
    """Positions (N, 2), x before y, of at most `count` peaks of a map (1, 1, H, W), refined by a soft maximum."""
    import torch

    width = torch._shape_as_tensor(scores)[3]
    inside = peaks[0, 0, FLAT_PX:-FLAT_PX, FLAT_PX:-FLAT_PX]
    inner_width = width - 2 * FLAT_PX
    # as many zeros more, so that there are `count` values whatever the size
    values, places = torch.topk(torch.nn.functional.pad(inside.reshape(-1), (0, count)), count)
    places = places[values > 0]
    x, y = places % inner_width + FLAT_PX, torch.div(places, inner_width, rounding_mode="floor") + FLAT_PX
    steps = torch.arange(-FLAT_PX, FLAT_PX + 1)
    down, right = (grid.reshape(-1) for grid in torch.meshgrid(steps, steps, indexing="ij"))
    window = scores.reshape(-1)[(y[:, None] + down) * width + x[:, None] + right]
    weights = torch.softmax(window / TEMPERATURE, dim=1)
    return torch.stack((x, y), dim=1) + weights @ torch.stack((right, down), dim=1).to(weights)


def _describe(head: Any, features: Any, pixels: Any) -> Any:
    """Descriptors (N, D): the features (1, C, H, W) at places around each position that the head finds by itself."""
    import torch

    channels, positions = features.shape[1], head.n_pos
    sides = torch._shape_as_tensor(features)[2:]
    # gathered one by one: a map with a border of zeros would be copied whole
    around = torch.arange(3) - 1
    y = pixels.long()[:, 1, None, None] + around.reshape(3, 1)
    x = pixels.long()[:, 0, None, None] + around.reshape(1, 3)
    inside = (x >= 0) & (x < sides[1]) & (y >= 0) & (y < sides[0])
    places = torch.where(inside, y * sides[1] + x, torch.zeros_like(x))
    patches = features.reshape(channels, -1)[:, places.reshape(-1)].reshape(channels, -1, 3, 3).transpose(0, 1)
    patches = patches * inside[:, None].to(patches)
    limit = sides.max() / 4
    offsets = torch.minimum(torch.maximum(head.offset_conv(patches), -limit), limit)
    places = pixels[:, None] + offsets.reshape(-1, 2, positions).transpose(1, 2)
    sampled = torch.selu(head.sf_conv(_sample(features, places[None])))
    weights = head.agg_weights.reshape(positions * channels, -1)
    described = sampled[0].permute(1, 2, 0).reshape(-1, positions * channels) @ weights
    return torch.nn.functional.normalize(described, dim=1)


def _convolve_deformed(layer: Any, image: Any) -> Any:
    """A convolution whose nine taps are moved by offsets of their own: the pixels are sampled, then weighted."""
    import torch

    sides = torch._shape_as_tensor(image)[2:]
    limit = sides.max() / 4
    moved = torch.minimum(torch.maximum(layer.offset_conv(image), -limit), limit)
    height, width = image.shape[2], image.shape[3]
    moved = moved.reshape(9, 2, height, width)
    taps = torch.arange(3) - 1
    down, right = (grid.reshape(9, 1, 1) for grid in torch.meshgrid(taps, taps, indexing="ij"))
    y = torch.arange(height).reshape(1, -1, 1) + down + moved[:, 0]
    x = torch.arange(width).reshape(1, 1, -1) + right + moved[:, 1]
    sampled = _sample(image, torch.stack((x, y), dim=3).reshape(1, 9 * height, width, 2))
    weights = layer.regular_conv.weight
    stacked = sampled.reshape(1, image.shape[1] * 9, height, width)
    return torch.nn.functional.conv2d(stacked, weights.reshape(len(weights), -1, 1, 1), layer.regular_conv.bias)


def _sample(values: Any, pixels: Any) -> Any:
    """Values (1, C, h, w) of a map at positions (1, h, w, 2), x before y; 0 outside."""
    import torch

    sides = torch._shape_as_tensor(values)[2:].flip(0)
    return torch.nn.functional.grid_sample(values, (2 * pixels + 1) / sides - 1, align_corners=False)


def make_picture(height: int, width: int) -> Any:
    """Make a picture (1, 3, H, W) with details of all sizes, from 0 to 1."""
    import torch

    chance = torch.Generator().manual_seed(0)
    picture = torch.zeros(1, 3, height, width)
    for cells in (4, 8, 16, 32, 64):
        noise = torch.rand(1, 3, cells, cells, generator=chance)
        picture += torch.nn.functional.interpolate(noise, (height, width), mode="bilinear") / cells**0.5
    return (picture - picture.min()) / (picture.max() - picture.min())


if __name__ == "__main__":
    run_script(main)
