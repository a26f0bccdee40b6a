"""CricaVPR: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_tokens
from cross_image_oracle import encoded_together, encoder_checkpoint
from described_images import distance, image, pillow
from published_networks import PublishedNetwork, with_checks
from torch.nn import functional

TOLERANCE = 2e-5
DIM = 128
IMAGES = [image(224, 224, seed) for seed in range(5)]


def drawn(dim: int = DIM, depth: int = 2) -> dict[str, torch.Tensor]:
    """Random values under the names of a file of several devices, whose adapters weigh as much as the MLPs."""
    generator = torch.Generator().manual_seed(3)

    def normal(*shape: int, scale: float = 1.0) -> torch.Tensor:
        return scale * torch.randn(shape, generator=generator)

    def convolution(name: str, n_in: int, n_out: int, side: int) -> dict[str, torch.Tensor]:
        return {
            f"{name}.conv.weight": normal(n_out, n_in, side, side, scale=0.1 / (side * n_in**0.5)),
            f"{name}.conv.bias": normal(n_out, scale=0.02),
            f"{name}.bn.weight": 1 + normal(n_out, scale=0.2),
            f"{name}.bn.bias": normal(n_out, scale=0.2),
            f"{name}.bn.running_mean": normal(n_out, scale=0.02),
            # As small as the published epsilon, so that another epsilon would show.
            f"{name}.bn.running_var": 0.001 + 0.001 * torch.rand(n_out, generator=generator),
            f"{name}.bn.num_batches_tracked": torch.tensor(7),
        }

    dino = vit_checkpoint(generator, dim, depth) | {"mask_token": normal(1, dim)}
    inner = dim // 2
    for number in range(depth):
        at = f"blocks.{number}.adapter."
        dino |= {f"{at}D_fc1.weight": normal(inner, dim, scale=dim**-0.5), f"{at}D_fc1.bias": normal(inner, scale=0.3)}
        dino |= {f"{at}D_fc2.weight": normal(dim, inner, scale=inner**-0.5), f"{at}D_fc2.bias": normal(dim, scale=0.3)}
        dino |= convolution(f"{at}branch1", inner, inner // 2, 1)
        for branch, side in (("branch2", 3), ("branch3", 5)):
            dino |= convolution(f"{at}{branch}.0", inner, inner // 16, 1)
            dino |= convolution(f"{at}{branch}.1", inner // 16, inner // 4, side)
    tensors = {f"backbone.{name}": tensor for name, tensor in dino.items()} | {"aggregation.1.p": torch.tensor([2.4])}
    tensors |= encoder_checkpoint(generator, dim, 48)
    return {f"module.{name}": tensor for name, tensor in tensors.items()}


def saved(path: Path, tensors: Tensors) -> Path:
    """Write a checkpoint of a training, which keeps recalls as numpy has them."""
    torch.save({"epoch_num": 3, "model_state_dict": tensors, "recalls": np.ones(4), "best_r5": np.float64(97.5)}, path)
    return path


def adapted(share: float = 0.2, epsilon: float = 1e-3, cls: float = 2.0):
    """What an adapter adds to the MLP, from its definition: half the dimensions, three kinds of surroundings."""

    def beside(b: Tensors, tokens: torch.Tensor) -> torch.Tensor:
        def convolution(name: str, x: torch.Tensor) -> torch.Tensor:
            t = {part: b[f"adapter.{name}.{part}"][:, None, None] for part in ("bn.weight", "bn.bias")}
            mean, variance = (b[f"adapter.{name}.bn.running_{part}"][:, None, None] for part in ("mean", "var"))
            weight = b[f"adapter.{name}.conv.weight"]
            x = functional.conv2d(x, weight, b[f"adapter.{name}.conv.bias"], padding=weight.shape[-1] // 2)
            return ((x - mean) / (variance + epsilon).sqrt() * t["bn.weight"] + t["bn.bias"]).clamp(min=0)

        inner = (tokens @ b["adapter.D_fc1.weight"].T + b["adapter.D_fc1.bias"]).clamp(min=0)
        grid = inner[:, 1:].reshape(len(inner), 16, 16, -1).permute(0, 3, 1, 2)
        seen = [convolution("branch1", grid)]
        seen += [convolution(f"{name}.1", convolution(f"{name}.0", grid)) for name in ("branch2", "branch3")]
        inner[:, 0] *= cls
        inner[:, 1:] += torch.cat(seen, 1).flatten(2).transpose(1, 2)
        return share * (inner @ b["adapter.D_fc2.weight"].T + b["adapter.D_fc2.bias"])

    return beside


def expected(
    tensors: Tensors,
    images: Sequence[np.ndarray],
    *,
    middle: tuple[int, int] = (5, 11),
    p: float | None = None,
    unit_cls: bool = False,
    **adapter: float,
) -> np.ndarray:
    """Descriptors in float64 of images that see one another; the options step into traps."""
    t = {name.removeprefix("module."): value for name, value in tensors.items()}
    tokens = vit_tokens(t, "backbone.", imagenet(*images), beside_mlp=adapted(**adapter))
    grid = tokens[:, 1:].reshape(len(images), 16, 16, DIM)
    grid = grid / grid.norm(dim=3, keepdim=True)
    power = t["aggregation.1.p"].double().item() if p is None else p
    parts = [functional.normalize(tokens[:, 0], dim=1) if unit_cls else tokens[:, 0]]
    for bounds in ([0, 8, 16], [0, *middle, 16]):
        for i in range(len(bounds) - 1):
            for j in range(len(bounds) - 1):
                region = grid[:, bounds[i] : bounds[i + 1], bounds[j] : bounds[j + 1]].flatten(1, 2)
                parts.append(region.clamp(min=1e-6).pow(power).mean(1).pow(1 / power))
    vectors = encoded_together(t, torch.stack(parts, 1)).flatten(1)
    return (vectors / vectors.norm(dim=1, keepdim=True)).numpy()


def alone(tensors: Tensors, images: Sequence[np.ndarray], **options: Any) -> np.ndarray:
    return np.concatenate([expected(tensors, [image], **options) for image in images])


NETWORK = PublishedNetwork(
    "cricavpr",
    drawn,
    IMAGES[:2],
    14 * DIM,
    alone,
    saved,
    tolerance=TOLERANCE,
    trap_distance=20 * TOLERANCE,
    traps=[
        {"share": 1.0},
        {"share": 0.0},  # without adapters
        {"epsilon": 1e-5},
        {"cls": 1.0},
        {"middle": (6, 11)},
        {"p": 3.0},
        {"unit_cls": True},
    ],
    missing=[
        "module.backbone.blocks.1.adapter.branch3.1.bn.running_var",
        "module.encoder.layers.1.norm2.bias",
        "module.aggregation.1.p",
    ],
    unexpected=["module.linear.weight"],
    hidden_prefixes=("module.",),
    refused=[
        ("method.height=224", {"height": 238}, (224, 224)),
        ("method.images_together=0", {"images_together": 0}, (224, 224)),
    ],
    draw_for_contract=lambda: drawn(64, 1),
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_images_that_see_one_another_except_two_rules(folder: Path) -> None:
    excepted = NETWORK.check_contract(folder, images_together=16)
    assert excepted == {"a batch gives what its single images give", "the order of queries does not matter"}


@pytest.mark.parametrize("batch_size", [1, 3, 16])
def test_consecutive_images_see_one_another_whatever_the_batch(folder: Path, batch_size: int) -> None:
    codes = NETWORK.encode(folder, *IMAGES, images_together=2, batch_size=batch_size)
    groups = [IMAGES[:2], IMAGES[2:4], IMAGES[4:]]
    assert distance(codes, np.concatenate([expected(NETWORK.tensors, group) for group in groups])) < TOLERANCE
    assert distance(codes[:4], alone(NETWORK.tensors, IMAGES[:4])) > 100 * TOLERANCE


def test_images_are_resized_without_antialiasing(folder: Path) -> None:
    seen = image(448, 560)
    floats = torch.from_numpy(seen).permute(2, 0, 1)[None].double()
    plain = functional.interpolate(floats, (224, 224), mode="bilinear", align_corners=False, antialias=False)
    levels = plain[0].permute(1, 2, 0).round().numpy().astype(np.uint8)
    smooth = pillow(seen, 224, 224)
    code = NETWORK.encode(folder, seen)
    assert distance(code, alone(NETWORK.tensors, [levels])) < 0.1 * distance(code, alone(NETWORK.tensors, [smooth]))


def test_a_run_whose_images_see_one_another_says_so_and_keeps_no_descriptors(folder: Path) -> None:
    alone, together = (NETWORK.method(NETWORK.file(folder), images_together=n) for n in (1, 16))
    assert (alone.notes(), alone.keeps_descriptors()) == ((), True)
    assert "16 consecutive images" in together.notes()[0]
    assert not together.keeps_descriptors()
