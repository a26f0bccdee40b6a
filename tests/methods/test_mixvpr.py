"""MixVPR against a float64 version written from the key names of its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from described_images import distance, drawn_images, encoded, pillow
from PIL import Image as PillowImage
from published_networks import PublishedNetwork, saved, with_checks
from torch.nn import functional

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.mixvpr import MixVPR

SIZE = {"height": 64, "width": 96}  # 4x6 positions


def drawn(n_positions: int = 24, channels: int = 16, rows: int = 3) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)

    def normal(*shape: int, scale: float = 1.0, mean: float = 0.0) -> torch.Tensor:
        return mean + scale * torch.randn(shape, generator=generator)

    tensors = oracle.resnet_checkpoint(generator, "resnet50", "backbone.model.", n_stages=3, numbered=False)
    for number in range(4):
        at = f"aggregator.mix.{number}.mix"
        tensors |= {
            f"{at}.0.weight": normal(n_positions, scale=0.3, mean=1),
            f"{at}.0.bias": normal(n_positions, scale=0.3),
            f"{at}.1.weight": normal(n_positions, n_positions, scale=n_positions**-0.5),
            f"{at}.1.bias": normal(n_positions, scale=0.3),
            f"{at}.3.weight": normal(n_positions, n_positions, scale=n_positions**-0.5),
            f"{at}.3.bias": normal(n_positions, scale=0.3),
        }
    return tensors | {
        "aggregator.channel_proj.weight": normal(channels, 1024, scale=1 / 32),
        "aggregator.channel_proj.bias": normal(channels),
        "aggregator.row_proj.weight": normal(rows, n_positions, scale=n_positions**-0.5),
        "aggregator.row_proj.bias": normal(rows),
    }


def as_tensor(x: torch.Tensor) -> torch.Tensor:
    return functional.interpolate(x, (64, 96), mode="bilinear", align_corners=False, antialias=True)


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    *,
    resized=lambda x: x,
    before=lambda image: pillow(image, 64, 96),
    flattened=lambda out: out.flatten(1),
    shortcut: bool = True,
    n_mixers: int = 4,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in tensors.items()}
    descriptors = []
    for image in images:
        x = resized(oracle.imagenet(before(image)))
        x = oracle.resnet(tensors, "backbone.model.", x, "resnet50", n_stages=3, numbered=False).flatten(2)
        for number in range(n_mixers):
            at = f"aggregator.mix.{number}.mix"
            inner = oracle.layer_norm(x, t[f"{at}.0.weight"], t[f"{at}.0.bias"], eps=1e-5)
            inner = (inner @ t[f"{at}.1.weight"].T + t[f"{at}.1.bias"]).clamp(min=0)
            inner = inner @ t[f"{at}.3.weight"].T + t[f"{at}.3.bias"]
            x = x + inner if shortcut else inner
        x = x.transpose(1, 2) @ t["aggregator.channel_proj.weight"].T + t["aggregator.channel_proj.bias"]
        x = x.transpose(1, 2) @ t["aggregator.row_proj.weight"].T + t["aggregator.row_proj.bias"]
        y = flattened(x)
        descriptors.append((y / y.norm())[0].numpy())
    return np.array(descriptors)


NETWORK = PublishedNetwork(
    "mixvpr",
    drawn,
    drawn_images((64, 96), (131, 187), (131, 187), (71, 53)),
    48,
    expected,
    arguments={**SIZE, "n_dimensions": 48},
    tolerance=1e-4,
    trap_distance=5e-4,
    traps=[
        {"flattened": lambda out: out.transpose(1, 2).flatten(1)},  # r * C + c instead of c * R + r
        {"shortcut": False},
        {"n_mixers": 3},
        {"before": lambda image: pillow(image, 64, 96, PillowImage.Resampling.BICUBIC)},  # as the authors' demo
        {"before": lambda image: pillow(image, 64, 96)[..., ::-1]},  # BGR
    ],
    missing=["aggregator.mix.3.mix.3.bias", "aggregator.row_proj.weight"],
    unexpected=["backbone.model.layer4.0.conv1.weight"],
    misshapen={"aggregator.channel_proj.weight": (16, 2048), "aggregator.mix.0.mix.0.weight": (25,)},
    refused=[
        ("n_dimensions=48", {"n_dimensions": 4096}, (64, 96)),
        *(("weights are for 24", {side: None}, (90, 120)) for side in ("height", "width")),
    ],
    contract={"n_dimensions": 48, "height": 32, "width": 32},
    draw_for_contract=lambda: drawn(4),
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_levels_are_rounded_before_they_become_floats(folder: Path) -> None:
    images = NETWORK.images[1:2]
    unrounded = expected(NETWORK.tensors, images, before=lambda image: image, resized=as_tensor)
    assert distance(NETWORK.codes(folder)[1:2], unrounded) > 5e-4


@pytest.mark.parametrize(("n_dimensions", "sizes"), [(4096, (1024, 4)), (512, (256, 2)), (128, (64, 2))])
def test_the_blank_network_has_the_published_tensors(n_dimensions: int, sizes: tuple[int, int]) -> None:
    with torch.device("meta"):
        blank = MixVPR(weights=Weights("", "", ""), n_dimensions=n_dimensions).blank()
    published = {name: tensor.shape for name, tensor in drawn(400, *sizes).items()}
    assert {name: tensor.shape for name, tensor in blank.state_dict().items()} == published


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
