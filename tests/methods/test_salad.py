"""SALAD: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from backbones_oracle import Tensors, imagenet, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import distance, encoded, image, pillow
from published_networks import PublishedNetwork, saved, with_checks
from torch import Generator, Tensor, randn

from vprbench.api.arrays import Image
from vprbench.errors import BadInput

TOLERANCE = 1e-5
N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM = 7, 12, 10


def drawn(*sizes: int) -> dict[str, Tensor]:
    generator = Generator().manual_seed(1)
    dino = {**vit_checkpoint(generator), "mask_token": randn(1, 128, generator=generator)}
    aggregator = salad_checkpoint(generator, 128, *(sizes or (N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM)))
    return {f"backbone.model.{name}": tensor for name, tensor in dino.items()} | {
        f"aggregator.{name}": tensor for name, tensor in aggregator.items()
    }


def expected(tensors: Tensors, images: Sequence[Image], final_norm: bool = True) -> npt.NDArray[np.float64]:
    tokens = [vit_tokens(tensors, "backbone.model.", imagenet(seen), final_norm=final_norm)[0] for seen in images]
    return np.stack([salad(tensors, "aggregator.", own).numpy() for own in tokens])


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
    contract={"height": 42, "width": 56},
)
method, tensors = NETWORK.method, NETWORK.tensors


@pytest.fixture
def file(folder: Path) -> Path:
    return NETWORK.file(folder)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_in_the_published_sizes_there_are_8448_numbers(tmp_path: Path) -> None:
    large = drawn(64, 128, 256)
    codes = encoded(method(saved(tmp_path / "large.ckpt", large)), image(126, 112))
    assert codes.shape == (1, 8448)
    assert distance(codes, expected(large, [image(126, 112)])) < TOLERANCE


def test_one_patch_more_than_clusters_is_enough(file: Path) -> None:
    assert distance(encoded(method(file), image(28, 56)), expected(tensors, [image(28, 56)])) < TOLERANCE


def test_the_token_and_each_cluster_weigh_the_same(file: Path) -> None:
    code = encoded(method(file), image(56, 98))[0]
    clusters = code[TOKEN_DIM:].reshape(CLUSTER_DIM, N_CLUSTERS)
    parts = [np.linalg.norm(code[:TOKEN_DIM]), *np.linalg.norm(clusters, axis=0)]
    assert np.allclose(parts, (1 + N_CLUSTERS) ** -0.5, atol=1e-6)


def test_what_is_added_to_all_scores_of_a_cluster_changes_nothing_however_much(file: Path, tmp_path: Path) -> None:
    bias = tensors["aggregator.score.3.bias"].clone()
    bias[0], bias[1] = bias[0] + 300, bias[1] - 300  # exponentials of which float32 does not hold
    other = saved(tmp_path / "biased.ckpt", {**tensors, "aggregator.score.3.bias": bias})
    assert distance(encoded(method(other), image(56, 98)), encoded(method(file), image(56, 98))) < 10 * TOLERANCE


def test_an_image_is_seen_at_the_nearest_multiples_of_14(file: Path) -> None:
    seen = pillow(image(50, 90), 56, 84)
    assert distance(encoded(method(file), image(50, 90)), expected(tensors, [seen])) < TOLERANCE


def test_an_image_with_no_more_patches_than_clusters_is_refused(file: Path) -> None:
    with pytest.raises(BadInput, match=r"7 patches .* 7 clusters .* 42 pixels"):
        encoded(method(file), image(14, 98))


# Files


def test_tensors_may_lie_under_state_dict(file: Path, tmp_path: Path) -> None:
    nested = saved(tmp_path / "nested.ckpt", {"epoch": 3, "state_dict": dict(tensors)})
    assert np.array_equal(encoded(method(nested), image(42, 42)), encoded(method(file), image(42, 42)))


def test_a_file_of_dinov2_alone_is_refused(tmp_path: Path) -> None:
    dino = {name.removeprefix("backbone.model."): tensor for name, tensor in tensors.items() if "backbone" in name}
    assert "backbone.model.cls_token" in NETWORK.refusal(saved(tmp_path / "dinov2_vitb14_pretrain.pth", dino))
