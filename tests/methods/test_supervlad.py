"""SuperVLAD, with and without its cross-image encoder, against a slow computation from the tensors of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from backbones_oracle import Draw, Tensors, imagenet, prefixed, under, vit_checkpoint, vit_tokens
from cross_image_oracle import encoded_together, encoder_checkpoint
from described_images import distance, image
from published_networks import PublishedNetwork, saved_training, unit, with_checks, without

from vprbench.api.arrays import Image

DIM, CLUSTERS = 128, 4
IMAGES = [image(56, 98, seed) for seed in range(5)]


def drawn() -> Tensors:
    draw = Draw(5)
    tensors = prefixed("backbone.", vit_checkpoint(draw)) | encoder_checkpoint(draw, DIM, 48)
    tensors["aggregation.conv.weight"] = draw.normal(CLUSTERS + 1, DIM, 1, 1, scale=6)
    return prefixed("module.", tensors)


def clusters(tensors: Tensors, image: Image) -> torch.Tensor:
    """The clusters of one image, but for the ghost, as a vector of unit length, (CLUSTERS, DIM)."""
    t = under(tensors, "module.")
    patches = torch.nn.functional.normalize(vit_tokens(t, "backbone.", imagenet(image))[0, 1:], dim=1)
    shares = torch.softmax(patches @ t["aggregation.conv.weight"].flatten(1).T, dim=1)
    sums = [(shares[:, cluster, None] * patches).sum(0) for cluster in range(CLUSTERS)]
    return torch.stack([gathered / gathered.norm() for gathered in sums]) / CLUSTERS**0.5


def together(tensors: Tensors, *images: Image) -> np.ndarray:
    """Descriptors of images that see one another, (n, CLUSTERS * DIM)."""
    own = torch.stack([clusters(tensors, seen) for seen in images])
    return unit(encoded_together(under(tensors, "module."), own).flatten(1).numpy())


PLAIN = PublishedNetwork(
    "supervlad",
    lambda: without(".encoder.")(drawn()),
    [*IMAGES[:2], image(42, 70)],
    CLUSTERS * DIM,
    lambda tensors, image: clusters(tensors, image).flatten(),
    saved_training,
    arguments={"height": None, "width": None},
)
CROSS_IMAGE = replace(
    PLAIN, name="supervlad_crossimage", draw=drawn, expected=lambda tensors, image: together(tensors, image)[0]
)


@with_checks(PLAIN, CROSS_IMAGE)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_images_that_see_one_another_except_two_rules(folder: Path) -> None:
    excepted = CROSS_IMAGE.check_contract(folder, images_together=16, height=28, width=42)
    assert excepted == {"a batch gives what its single images give", "the order of queries does not matter"}


def test_the_encoder_joins_as_many_images_as_asked(folder: Path) -> None:
    codes = CROSS_IMAGE.encode(folder, *IMAGES, images_together=2, batch_size=3)
    wanted = [together(CROSS_IMAGE.tensors, *IMAGES[first : first + 2]) for first in (0, 2, 4)]
    assert distance(codes, np.concatenate(wanted)) < 1e-5
    assert distance(codes[:1], CROSS_IMAGE.slowly(IMAGES[0])) > 1e-3


@pytest.mark.parametrize(("network", "other"), [(PLAIN, CROSS_IMAGE), (CROSS_IMAGE, PLAIN)])
def test_the_file_of_the_other_is_refused(network: PublishedNetwork, other: PublishedNetwork, folder: Path) -> None:
    assert "encoder.layers.0" in network.refusal(other.file(folder))
