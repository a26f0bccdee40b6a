"""Conv-AP against a float64 version written from the key names of its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import drawn_images, pillow
from PIL import Image as PillowImage
from published_networks import PublishedNetwork, saved, with_checks

TOLERANCE = 1e-4
CHANNELS = 6
SIZE = {"height": 96, "width": 160}  # 3x5 positions, of which the middle ones count in two quarters


def drawn(kind: str = "resnet50", n_inputs: int = 2048) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    return oracle.resnet_checkpoint(generator, kind, "backbone.model.", numbered=False) | {
        "aggregator.channel_pool.weight": torch.randn(CHANNELS, n_inputs, 1, 1, generator=generator) / 45,
        "aggregator.channel_pool.bias": 0.3 * torch.randn(CHANNELS, generator=generator),
    }


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    *,
    kind: PillowImage.Resampling = PillowImage.Resampling.BICUBIC,
    parts_first: bool = False,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in tensors.items()}
    descriptors = []
    for image in images:
        seen = pillow(image, 96, 160, kind)
        features = oracle.resnet(tensors, "backbone.model.", oracle.imagenet(seen), "resnet50", numbered=False)[0]
        maps = torch.einsum("oc,chw->ohw", t["aggregator.channel_pool.weight"].flatten(1), features)
        maps = maps + t["aggregator.channel_pool.bias"][:, None, None]
        quarters = [
            maps[:, rows, across].mean((1, 2)) for rows in (slice(2), slice(1, 3)) for across in (slice(3), slice(2, 5))
        ]
        vector = torch.stack(quarters, 0 if parts_first else 1).flatten()
        descriptors.append((vector / vector.norm()).numpy())
    return np.array(descriptors)


NETWORK = PublishedNetwork(
    "conv_ap",
    drawn,
    drawn_images((131, 187), (96, 160)),
    4 * CHANNELS,
    expected,
    arguments={"channels": CHANNELS, **SIZE},
    tolerance=TOLERANCE,
    traps=[{"kind": PillowImage.Resampling.BILINEAR}, {"parts_first": True}],
    missing=["aggregator.channel_pool.weight", "backbone.model.layer4.2.bn3.bias"],
    unexpected=["backbone.model.fc.weight"],
    contract={"channels": CHANNELS, "height": 32, "width": 32},
    draw_for_contract=lambda: drawn("resnet18", 512),
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path, request, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.node.callspec.id.endswith("contract"):  # the suite describes many images
        monkeypatch.setattr("vprbench.methods.conv_ap._BACKBONE", "resnet18")
    check(folder)


def test_a_file_of_other_channels_is_refused_with_the_argument_that_it_wants(folder: Path) -> None:
    path = saved(folder / "changed", {**NETWORK.tensors, "aggregator.channel_pool.bias": torch.zeros(7)})
    assert "method.channels=7" in NETWORK.refusal(path)
