"""DINOv2 as a descriptor: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_tokens
from described_images import distance, encoded, image, pillow
from published_networks import PublishedNetwork, saved, with_checks
from torch import Generator, Tensor, randn

from vprbench.api.arrays import Image

Resize = Callable[[Image], Image]


def drawn() -> dict[str, Tensor]:
    generator = Generator().manual_seed(1)
    return {**vit_checkpoint(generator), "mask_token": randn(1, 128, generator=generator)}


def described(tensors: Tensors, image: Image, pooling: str = "cls", **how: Any) -> npt.NDArray[Any]:
    tokens = vit_tokens(tensors, "", imagenet(image), **how)[0]
    vector = {
        "cls": lambda: tokens[0],
        "mean": lambda: tokens[1:].mean(0),
        "gem": lambda: (tokens[1:].clamp(min=1e-6) ** 3).mean(0) ** (1 / 3),
    }[pooling]()
    return (vector / vector.norm()).numpy()


def expected(
    tensors: Tensors, images: Sequence[Image], resized: Resize = lambda seen: seen, **how: Any
) -> npt.NDArray[Any]:
    return np.stack([described(tensors, resized(seen), **how) for seen in images])


NETWORK = PublishedNetwork(
    "dinov2",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    128,
    expected,
    arguments={"height": None, "width": None},
    traps=[{"final_norm": False}, {"pooling": "mean"}, {"pooling": "gem"}],
    missing=["norm.weight", "cls_token", "blocks.1.ls2.gamma", "blocks.1.attn.qkv.bias", "pos_embed"],
    unexpected=["register_tokens", "blocks.0.attn.extra.weight", "head.weight"],
    misshapen={"blocks.0.mlp.fc2.bias": (129,)},
    options={
        "pool mean": ({"pooling": "mean"}, [image(56, 98)], {"pooling": "mean"}),
        "pool gem": ({"pooling": "gem"}, [image(56, 98)], {"pooling": "gem"}),
        "positions as they are": ({}, [image(70, 70)], {}),
        "nearest multiples of 14": ({}, [image(50, 90)], {"resized": lambda seen: pillow(seen, 56, 84)}),
    },
    forms={"no mask token": lambda tensors: {name: t for name, t in tensors.items() if name != "mask_token"}},
    contract={"height": 42, "width": 56},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_a_gate_in_place_of_gelu_is_told_from_the_file(tmp_path: Path) -> None:
    tensors = vit_checkpoint(Generator().manual_seed(2), swiglu=True)
    path = saved(tmp_path / "gate.pth", tensors)
    code = encoded(NETWORK.method(path, backbone="vitg14"), image(42, 56))
    assert distance(code, described(tensors, image(42, 56))) < NETWORK.tolerance


def test_a_file_of_another_family_is_refused(tmp_path: Path) -> None:
    prefixed = {f"backbone.model.{name}": tensor for name, tensor in NETWORK.tensors.items()}
    assert "patch_embed.proj.weight" in NETWORK.refusal(saved(tmp_path / "salad.ckpt", prefixed))
