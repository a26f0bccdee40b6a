"""DINOv2 as a descriptor: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from backbones_oracle import Draw, Tensors, gem, imagenet, prefixed, vit_checkpoint, vit_tokens
from described_images import distance, encoded, image, pillow
from published_networks import PublishedNetwork, saved, with_checks, without
from torch import Tensor

from vprbench.api.arrays import Image


def described(
    tensors: Tensors, seen: Image, pooling: str = "cls", resized: Callable[[Image], Image] = lambda seen: seen
) -> Tensor:
    tokens = vit_tokens(tensors, "", imagenet(resized(seen)))[0]
    return {"cls": tokens[0], "mean": tokens[1:].mean(0), "gem": gem(tokens[1:], 3, 0)}[pooling]


NETWORK = PublishedNetwork(
    "dinov2",
    lambda: vit_checkpoint(Draw(1)),
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    128,
    described,
    arguments={"height": None, "width": None},
    wrong={"norm.weight": None, "blocks.0.mlp.fc2.bias": (129,)},
    options={
        "mean": ({"pooling": "mean"}, image(56, 98), {"pooling": "mean"}),
        "gem": ({"pooling": "gem"}, image(56, 98), {"pooling": "gem"}),
        "positions as they are": ({}, image(70, 70), {}),
        "nearest multiples of 14": ({}, image(50, 90), {"resized": lambda seen: pillow(seen, 56, 84)}),
    },
    forms={"no mask token": without("mask_token")},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_a_gate_in_place_of_gelu_is_told_from_the_file(tmp_path: Path) -> None:
    tensors = vit_checkpoint(Draw(2), swiglu=True)
    method = NETWORK.method(saved(tmp_path / "gate.pth", tensors), backbone="vitg14")
    seen = image(42, 56)
    assert distance(encoded(method, seen), NETWORK.slowly(seen, tensors=tensors)) < NETWORK.tolerance


def test_a_file_of_another_family_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path / "salad.ckpt", prefixed("backbone.model.", NETWORK.tensors))
    assert "patch_embed.proj.weight" in NETWORK.refusal(path)
