"""SuperVLAD, with and without its cross-image encoder, against a slow computation from the tensors of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_tokens
from cross_image_oracle import encoded_together, encoder_checkpoint
from described_images import distance, encoded, image
from published_networks import PublishedNetwork, with_checks

TOLERANCE = 1e-5
DIM, CLUSTERS = 128, 4
IMAGES = [image(56, 98, seed) for seed in range(5)]


def drawn() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    dino = vit_checkpoint(generator, DIM) | {"mask_token": torch.randn(1, DIM, generator=generator)}
    tensors = {f"module.backbone.{name}": tensor for name, tensor in dino.items()}
    weight = 6 * torch.randn(CLUSTERS + 1, DIM, 1, 1, generator=generator)
    encoder = encoder_checkpoint(generator, DIM, 48)
    return tensors | {"module.aggregation.conv.weight": weight} | {f"module.{k}": v for k, v in encoder.items()}


def saved(path: Path, tensors: Tensors) -> Path:
    """Write a checkpoint of a training, which keeps recalls as numpy has them."""
    torch.save({"model_state_dict": dict(tensors), "recalls": np.ones(4), "best_r5": np.float64(97.5)}, path)
    return path


def clusters(
    tensors: Tensors, image: np.ndarray, *, ghost: int = CLUSTERS, unit: bool = True, normed: bool = True
) -> torch.Tensor:
    """The clusters of one image as a vector of unit length, (CLUSTERS, DIM); the options step into traps."""
    t = {name.removeprefix("module."): value.double() for name, value in tensors.items()}
    patches = vit_tokens(t, "backbone.", imagenet(image), final_norm=normed)[0, 1:]
    patches = patches / patches.norm(dim=1, keepdim=True) if unit else patches
    shares = torch.softmax(patches @ t["aggregation.conv.weight"].flatten(1).T, dim=1)
    sums = []
    for cluster in (number for number in range(CLUSTERS + 1) if number != ghost):
        gathered = (shares[:, cluster, None] * patches).sum(0)
        sums.append(gathered / gathered.norm())
    return torch.stack(sums) / len(sums) ** 0.5


def together(tensors: Tensors, images: Sequence[np.ndarray]) -> np.ndarray:
    """Descriptors of images that see one another, (n, CLUSTERS * DIM)."""
    t = {name.removeprefix("module."): value for name, value in tensors.items()}
    vectors = encoded_together(t, torch.stack([clusters(tensors, seen) for seen in images])).flatten(1)
    return (vectors / vectors.norm(dim=1, keepdim=True)).numpy()


def expected(tensors: Tensors, images: Sequence[np.ndarray], **trap: Any) -> np.ndarray:
    return np.stack([clusters(tensors, seen, **trap).flatten().numpy() for seen in images])


def without_encoder() -> Tensors:
    return {name: tensor for name, tensor in drawn().items() if ".encoder." not in name}


def each_alone(tensors: Tensors, images: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([together(tensors, [seen]) for seen in images])


PLAIN = PublishedNetwork(
    "supervlad",
    without_encoder,
    [*IMAGES[:2], image(42, 70)],
    CLUSTERS * DIM,
    expected,
    saved,
    arguments={"height": None, "width": None},
    traps=[{"ghost": 0}, {"unit": False}, {"normed": False}],
    contract={"height": 28, "width": 42},
)
CROSS_IMAGE = replace(PLAIN, name="supervlad_crossimage", draw=drawn, expected=each_alone, traps=())


@with_checks(PLAIN, CROSS_IMAGE)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_images_that_see_one_another_except_two_rules(folder: Path) -> None:
    excepted = CROSS_IMAGE.check_contract(folder, images_together=16)
    assert excepted == {"a batch gives what its single images give", "the order of queries does not matter"}


@pytest.mark.parametrize("n", [1, 2])
def test_the_encoder_joins_as_many_images_as_asked(folder: Path, n: int) -> None:
    tensors, path = CROSS_IMAGE.tensors, CROSS_IMAGE.file(folder)
    codes = encoded(CROSS_IMAGE.method(path, images_together=n, batch_size=3), *IMAGES)
    groups = [IMAGES[first : first + n] for first in range(0, 5, n)]
    assert distance(codes, np.concatenate([together(tensors, group) for group in groups])) < TOLERANCE
    assert distance(together(tensors, IMAGES[:1]), together(tensors, IMAGES[:2])[:1]) > 100 * TOLERANCE


@pytest.mark.parametrize(("network", "other"), [(PLAIN, CROSS_IMAGE), (CROSS_IMAGE, PLAIN)])
def test_the_file_of_the_other_is_refused(network: PublishedNetwork, other: PublishedNetwork, folder: Path) -> None:
    assert "encoder.layers.0" in network.refusal(other.file(folder))
