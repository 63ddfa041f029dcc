"""Export a published network for `--descriptor onnx:FILE`: `python benchmarks/export_networks.py NAME OUT`.

An environment of its own with torch, torchvision and onnx is needed; the product needs none of them. The networks come
by torch.hub from the repositories of their authors, whose licences hold: docs/learned_descriptors.md lists them. MixVPR
has no entry for torch.hub: give its cloned repository and the file of its weights by --repository and --weights.

`--stand-in` exports a small random network of the same interface instead, which shows that the export works where there
is no network access.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from command_line import run_script

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
    import sys

    import torch

    if folder is None or weights is None:
        raise SystemExit("mixvpr: expected --repository and --weights, found none; clone amaralibey/MixVPR")
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
    parser.add_argument("name", choices=RECIPES)
    parser.add_argument("out", type=Path)
    parser.add_argument("--repository", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--stand-in", action="store_true")
    given = parser.parse_args()
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


if __name__ == "__main__":
    run_script(main)
