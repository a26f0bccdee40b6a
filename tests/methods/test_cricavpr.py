"""CricaVPR: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import torch
from backbones_oracle import Draw, Tensors, gem, imagenet, prefixed, under, vit_checkpoint, vit_tokens
from cross_image_oracle import encoded_together, encoder_checkpoint
from described_images import distance, image, pillow
from published_networks import PublishedNetwork, saved_training, unit, with_checks
from torch.nn import functional

from vprbench.api.arrays import Image

TOLERANCE = 2e-5
DIM = 128
IMAGES = [image(224, 224, seed) for seed in range(5)]


def drawn() -> Tensors:
    """Random values under the names of a file of several devices, whose adapters weigh as much as the MLPs."""
    draw = Draw(3)

    def convolution(name: str, n_in: int, n_out: int, side: int) -> dict[str, torch.Tensor]:
        return {
            f"{name}.conv.weight": draw.normal(n_out, n_in, side, side, scale=0.1 / (side * n_in**0.5)),
            f"{name}.conv.bias": draw.normal(n_out, scale=0.02),
            **draw.norm(f"{name}.bn", n_out),
            f"{name}.bn.running_mean": draw.normal(n_out, scale=0.02),
            # As small as the published epsilon, so that another epsilon would show.
            f"{name}.bn.running_var": 0.001 + 0.001 * torch.rand(n_out, generator=draw.generator),
        }

    inner = DIM // 2
    tensors = vit_checkpoint(draw, DIM)
    for number in range(2):
        adapter = draw.linear("D_fc1", DIM, inner) | draw.linear("D_fc2", inner, DIM)
        adapter |= convolution("branch1", inner, inner // 2, 1)
        for branch, side in (("branch2", 3), ("branch3", 5)):
            adapter |= convolution(f"{branch}.0", inner, inner // 16, 1)
            adapter |= convolution(f"{branch}.1", inner // 16, inner // 4, side)
        tensors |= prefixed(f"blocks.{number}.adapter.", adapter)
    tensors = prefixed("backbone.", tensors) | {"aggregation.1.p": torch.tensor([2.4])}
    return prefixed("module.", tensors | encoder_checkpoint(draw, DIM, 48))


def adapted(block: Tensors, tokens: torch.Tensor) -> torch.Tensor:
    """What an adapter adds to the MLP, from its definition: half the dimensions, three kinds of surroundings."""
    b = under(block, "adapter.")

    def convolution(name: str, x: torch.Tensor) -> torch.Tensor:
        t = {part: values[:, None, None] for part, values in under(b, f"{name}.bn.").items()}
        weight = b[f"{name}.conv.weight"]
        x = functional.conv2d(x, weight, b[f"{name}.conv.bias"], padding=weight.shape[-1] // 2)
        return ((x - t["running_mean"]) / (t["running_var"] + 1e-3).sqrt() * t["weight"] + t["bias"]).clamp(min=0)

    inner = (tokens @ b["D_fc1.weight"].T + b["D_fc1.bias"]).clamp(min=0)
    grid = inner[:, 1:].reshape(len(inner), 16, 16, -1).permute(0, 3, 1, 2)
    seen = [convolution("branch1", grid)]
    seen += [convolution(f"{name}.1", convolution(f"{name}.0", grid)) for name in ("branch2", "branch3")]
    inner[:, 0] *= 2
    inner[:, 1:] += torch.cat(seen, 1).flatten(2).transpose(1, 2)
    return 0.2 * (inner @ b["D_fc2.weight"].T + b["D_fc2.bias"])


def together(tensors: Tensors, *images: Image) -> np.ndarray:
    """Descriptors of images that see one another."""
    t = under(tensors, "module.")
    tokens = vit_tokens(t, "backbone.", imagenet(*images), beside_mlp=adapted)
    grid = functional.normalize(tokens[:, 1:].reshape(len(images), 16, 16, DIM), dim=3)
    parts = [tokens[:, 0]]
    for bounds in ([0, 8, 16], [0, 5, 11, 16]):
        for rows, columns in product(pairwise(bounds), repeat=2):
            parts.append(gem(grid[:, slice(*rows), slice(*columns)], t["aggregation.1.p"], (1, 2)))
    return unit(encoded_together(t, torch.stack(parts, 1)).flatten(1).numpy())


NETWORK = PublishedNetwork(
    "cricavpr",
    drawn,
    IMAGES[:2],
    14 * DIM,
    lambda tensors, image: together(tensors, image)[0],
    saved_training,
    tolerance=TOLERANCE,
    refused=[
        ("method.height=224", {"height": 238}, (224, 224)),
        ("method.images_together=0", {"images_together": 0}, (224, 224)),
    ],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


@pytest.mark.parametrize("batch_size", [1, 3, 16])
def test_consecutive_images_see_one_another_whatever_the_batch(folder: Path, batch_size: int) -> None:
    codes = NETWORK.encode(folder, *IMAGES, images_together=2, batch_size=batch_size)
    wanted = [together(NETWORK.tensors, *IMAGES[first : first + 2]) for first in (0, 2, 4)]
    assert distance(codes, np.concatenate(wanted)) < TOLERANCE
    assert distance(codes[:2], NETWORK.codes(folder)) > 100 * TOLERANCE


def test_images_are_resized_without_antialiasing(folder: Path) -> None:
    seen = image(448, 560)
    floats = torch.from_numpy(seen).permute(2, 0, 1)[None].double()
    plain = functional.interpolate(floats, (224, 224), mode="bilinear", align_corners=False, antialias=False)
    levels = plain[0].permute(1, 2, 0).round().numpy().astype(np.uint8)
    smooth = pillow(seen, 224, 224)
    code = NETWORK.encode(folder, seen)
    assert distance(code, NETWORK.slowly(levels)) < 0.1 * distance(code, NETWORK.slowly(smooth))


def test_a_run_whose_images_see_one_another_says_so_and_keeps_no_descriptors(folder: Path) -> None:
    alone, together = (NETWORK.method(NETWORK.file(folder), images_together=n) for n in (1, 16))
    assert (alone.notes(), alone.keeps_descriptors(), alone.extends) == ((), True, True)
    assert "16 consecutive images" in together.notes()[0]
    assert (together.keeps_descriptors(), together.extends) == (False, False)
    assert not NETWORK.method(NETWORK.file(folder), index="sq8").extends
