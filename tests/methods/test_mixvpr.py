"""MixVPR against a float64 version written from the key names of its files."""

from __future__ import annotations

from pathlib import Path

import backbones_oracle as oracle
import pytest
import torch
from backbones_oracle import Draw, under
from described_images import drawn_images, encoded, pillow
from published_networks import PublishedNetwork, saved, with_checks

from vprbench.api.arrays import Image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.mixvpr import MixVPR

SIZE = {"height": 64, "width": 96}  # 4x6 positions


def drawn(n_positions: int = 24, channels: int = 16, rows: int = 3) -> oracle.Tensors:
    draw = Draw(5)
    tensors = oracle.resnet_checkpoint(draw, "resnet50", "backbone.model.", n_stages=3, numbered=False)
    for number in range(4):
        at = f"aggregator.mix.{number}.mix"
        tensors |= draw.norm(f"{at}.0", n_positions)
        tensors |= draw.linear(f"{at}.1", n_positions, n_positions) | draw.linear(f"{at}.3", n_positions, n_positions)
    tensors |= draw.linear("aggregator.channel_proj", 1024, channels)
    return tensors | draw.linear("aggregator.row_proj", n_positions, rows)


def expected(tensors: oracle.Tensors, image: Image) -> torch.Tensor:
    """The rows of each output channel side by side; levels are rounded before they become floats."""
    t = under(tensors, "aggregator.")
    seen = oracle.imagenet(pillow(image, 64, 96))
    x = oracle.resnet(tensors, "backbone.model.", seen, "resnet50", n_stages=3, numbered=False).flatten(2)
    for number in range(4):
        m = under(t, f"mix.{number}.mix.")
        inner = oracle.layer_norm(x, m["0.weight"], m["0.bias"], eps=1e-5)
        x = x + (inner @ m["1.weight"].T + m["1.bias"]).clamp(min=0) @ m["3.weight"].T + m["3.bias"]
    x = x.transpose(1, 2) @ t["channel_proj.weight"].T + t["channel_proj.bias"]
    return (x.transpose(1, 2) @ t["row_proj.weight"].T + t["row_proj.bias"])[0].flatten()


NETWORK = PublishedNetwork(
    "mixvpr",
    drawn,
    drawn_images((64, 96), (131, 187), (131, 187), (71, 53)),
    48,
    expected,
    arguments={**SIZE, "n_dimensions": 48},
    tolerance=1e-4,
    wrong={
        "aggregator.row_proj.weight": None,
        "backbone.model.layer4.0.conv1.weight": (3, 3),
        "aggregator.channel_proj.weight": (16, 2048),
        "aggregator.mix.0.mix.0.weight": (25,),
    },
    refused=[
        ("n_dimensions=48", {"n_dimensions": 4096}, (64, 96)),
        *(("weights are for 24", {side: None}, (90, 120)) for side in ("height", "width")),
    ],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_weights_for_images_of_320x320_ask_for_their_size(folder: Path) -> None:
    path = saved(folder / "large.ckpt", drawn(400, 64, 2))
    (image,) = drawn_images((90, 120))
    method = MixVPR(weights=Weights("", "", "", path=str(path)), n_dimensions=128)
    assert encoded(method, image).shape == (1, 128)
    with pytest.raises(BadInput, match=r"24 positions, .* 400: .*method.height=320"):
        encoded(NETWORK.method(path, n_dimensions=128), image)


def test_there_is_no_blank_network_of_other_dimensions() -> None:
    with pytest.raises(BadInput, match="4096, 512, 128"):
        NETWORK.method(Path("none"), n_dimensions=64).blank()
