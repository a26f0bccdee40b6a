"""SALAD: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from backbones_oracle import Tensors, imagenet, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import distance, encoded, image, pillow
from published_networks import PublishedNetwork, saved, with_checks
from torch import Generator, Tensor, randn

from vprbench.api.arrays import Image

TOLERANCE = 1e-5
N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM = 7, 12, 10
Resize = Callable[[Image], Image]


def drawn(*sizes: int) -> dict[str, Tensor]:
    generator = Generator().manual_seed(1)
    dino = {**vit_checkpoint(generator), "mask_token": randn(1, 128, generator=generator)}
    aggregator = salad_checkpoint(generator, 128, *(sizes or (N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM)))
    return {f"backbone.model.{name}": tensor for name, tensor in dino.items()} | {
        f"aggregator.{name}": tensor for name, tensor in aggregator.items()
    }


def expected(
    tensors: Tensors, images: Sequence[Image], final_norm: bool = True, resized: Resize = lambda seen: seen
) -> npt.NDArray[np.float64]:
    seen = [imagenet(resized(image)) for image in images]
    tokens = [vit_tokens(tensors, "backbone.model.", one, final_norm=final_norm)[0] for one in seen]
    return np.stack([salad(tensors, "aggregator.", own).numpy() for own in tokens])


def biased(tensors: Tensors) -> Tensors:
    """Scores moved together for each cluster, which changes nothing: float32 does not hold their exponentials."""
    bias = tensors["aggregator.score.3.bias"].clone()
    bias[0], bias[1] = bias[0] + 300, bias[1] - 300
    return {**tensors, "aggregator.score.3.bias": bias}


NETWORK = PublishedNetwork(
    "salad",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    N_CLUSTERS * CLUSTER_DIM + TOKEN_DIM,
    expected,
    arguments={"height": None, "width": None},
    alike_in_half=0.995,
    traps=[{"final_norm": False}],
    missing=[
        "aggregator.dust_bin",
        "aggregator.score.0.weight",
        "aggregator.cluster_features.3.weight",
        "aggregator.token_features.2.bias",
        "backbone.model.norm.weight",
        "backbone.model.pos_embed",
    ],
    unexpected=["aggregator.linear.weight", "backbone.model.register_tokens", "loss.weight"],
    misshapen={
        "aggregator.score.3.bias": (N_CLUSTERS + 1,),
        "aggregator.cluster_features.0.weight": (32, 64, 1, 1),
        "aggregator.dust_bin": (1,),
    },
    hidden_prefixes=("backbone.model.",),
    options={
        "one patch more than clusters": ({}, [image(28, 56)], {}),
        "nearest multiples of 14": ({}, [image(50, 90)], {"resized": lambda seen: pillow(seen, 56, 84)}),
    },
    refused=[("7 patches", {}, (14, 98))],
    forms={"under state_dict": lambda tensors: {"epoch": 3, "state_dict": dict(tensors)}, "biased": biased},
    batch_tolerance=1e-5,
    contract={"height": 42, "width": 56},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_in_the_published_sizes_there_are_8448_numbers(tmp_path: Path) -> None:
    large = drawn(64, 128, 256)
    codes = encoded(NETWORK.method(saved(tmp_path / "large.ckpt", large)), image(126, 112))
    assert codes.shape == (1, 8448)
    assert distance(codes, expected(large, [image(126, 112)])) < TOLERANCE


def test_the_token_and_each_cluster_weigh_the_same(folder: Path) -> None:
    code = NETWORK.encode(folder, image(56, 98))[0]
    clusters = code[TOKEN_DIM:].reshape(CLUSTER_DIM, N_CLUSTERS)
    parts = [np.linalg.norm(code[:TOKEN_DIM]), *np.linalg.norm(clusters, axis=0)]
    assert np.allclose(parts, (1 + N_CLUSTERS) ** -0.5, atol=1e-6)


def test_a_file_of_dinov2_alone_is_refused(tmp_path: Path) -> None:
    dino = {
        name.removeprefix("backbone.model."): tensor for name, tensor in NETWORK.tensors.items() if "backbone" in name
    }
    assert "backbone.model.cls_token" in NETWORK.refusal(saved(tmp_path / "dinov2_vitb14_pretrain.pth", dino))
