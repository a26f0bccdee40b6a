"""SALAD: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from backbones_oracle import Draw, Tensors, imagenet, prefixed, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import image, pillow
from published_networks import PublishedNetwork, saved, with_checks
from torch import Tensor

from vprbench.api.arrays import Image


def drawn() -> dict[str, Tensor]:
    draw = Draw(1)
    dino = prefixed("backbone.model.", vit_checkpoint(draw))
    return dino | prefixed("aggregator.", salad_checkpoint(draw, clusters=7, cluster_dim=12, token_dim=10))


def expected(tensors: Tensors, seen: Image, resized: Callable[[Image], Image] = lambda seen: seen) -> Tensor:
    tokens = vit_tokens(tensors, "backbone.model.", imagenet(resized(seen)))[0]
    return salad(tensors, "aggregator.", tokens)


def biased(tensors: Tensors) -> Tensors:
    """Scores moved together for each cluster, which changes nothing: float32 does not hold their exponentials."""
    bias = tensors["aggregator.score.3.bias"].clone()
    bias[0], bias[1] = bias[0] + 300, bias[1] - 300
    return {**tensors, "aggregator.score.3.bias": bias}


NETWORK = PublishedNetwork(
    "salad",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    7 * 12 + 10,
    expected,
    arguments={"height": None, "width": None},
    alike_in_half=0.995,
    wrong={
        "backbone.model.norm.weight": None,
        "aggregator.score.3.bias": (8,),
        "aggregator.cluster_features.0.weight": (32, 64, 1, 1),
    },
    options={
        "one patch more than clusters": ({}, image(28, 56), {}),
        "nearest multiples of 14": ({}, image(50, 90), {"resized": lambda seen: pillow(seen, 56, 84)}),
    },
    refused=[("need more: set method.height and method.width to 42", {}, (14, 98))],
    forms={"under state_dict": lambda tensors: {"epoch": 3, "state_dict": dict(tensors)}, "biased": biased},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_a_file_of_dinov2_alone_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path / "dinov2_vitb14_pretrain.pth", vit_checkpoint(Draw()))
    assert "backbone.model.cls_token" in NETWORK.refusal(path)
