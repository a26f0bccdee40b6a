"""Conv-AP against a float64 version written from the key names of its files."""

from __future__ import annotations

from pathlib import Path

import backbones_oracle as oracle
import torch
from described_images import drawn_images, pillow
from PIL import Image as PillowImage
from published_networks import PublishedNetwork, saved, with_checks

from vprbench.api.arrays import Image

CHANNELS = 6
SIZE = {"height": 96, "width": 160}  # 3x5 positions, of which the middle ones count in two quarters


def drawn() -> oracle.Tensors:
    draw = oracle.Draw(4)
    return oracle.resnet_checkpoint(draw, "resnet50", "backbone.model.", numbered=False) | {
        "aggregator.channel_pool.weight": draw.normal(CHANNELS, 2048, 1, 1, scale=1 / 45),
        "aggregator.channel_pool.bias": draw.normal(CHANNELS, scale=0.3),
    }


def expected(tensors: oracle.Tensors, image: Image) -> torch.Tensor:
    t = oracle.under(tensors, "aggregator.channel_pool.")
    seen = oracle.imagenet(pillow(image, 96, 160, PillowImage.Resampling.BICUBIC))
    features = oracle.resnet(tensors, "backbone.model.", seen, "resnet50", numbered=False)[0]
    maps = torch.einsum("oc,chw->ohw", t["weight"].flatten(1), features) + t["bias"][:, None, None]
    quarters = [
        maps[:, rows, across].mean((1, 2)) for rows in (slice(2), slice(1, 3)) for across in (slice(3), slice(2, 5))
    ]
    return torch.stack(quarters, 1).flatten()


NETWORK = PublishedNetwork(
    "conv_ap",
    drawn,
    drawn_images((131, 187), (96, 160)),
    4 * CHANNELS,
    expected,
    arguments={"channels": CHANNELS, **SIZE},
    tolerance=1e-4,
    wrong={"backbone.model.fc.weight": (3, 3)},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_a_file_of_other_channels_is_refused_with_the_argument_that_it_wants(folder: Path) -> None:
    path = saved(folder / "changed", {**NETWORK.tensors, "aggregator.channel_pool.bias": torch.zeros(7)})
    assert "method.channels=7" in NETWORK.refusal(path)
