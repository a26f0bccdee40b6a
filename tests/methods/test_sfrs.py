"""SFRS against a float64 version written from the key names of its file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import torch
from described_images import drawn_images, pillow
from published_networks import PublishedNetwork, with_checks

from vprbench.api.arrays import Image

MEAN = (0.48501960784313836, 0.4579568627450961, 0.4076039215686255)  # of RGB, 0 to 1, as its authors have it
CLUSTERS, COMPONENTS = 3, 8


def drawn() -> oracle.Tensors:
    draw = oracle.Draw(2)
    tensors = oracle.vgg16_checkpoint(draw)
    tensors["0.weight"] /= 60  # it sees levels
    return oracle.prefixed("base_model.base.", tensors) | {
        "net_vlad.centroids": draw.normal(CLUSTERS, 512, scale=512**-0.5),
        "net_vlad.conv.weight": draw.normal(CLUSTERS, 512, 1, 1, scale=4),
        "pca_layer.weight": draw.normal(COMPONENTS, CLUSTERS * 512, 1, 1),
        "pca_layer.bias": draw.normal(COMPONENTS, scale=0.5),
    }


def expected(
    tensors: oracle.Tensors, image: Image, resized: Callable[[Image], Image] = lambda image: image
) -> torch.Tensor:
    x = torch.from_numpy(resized(image).astype(np.float64)).permute(2, 0, 1)[None] / 255
    x = (x - torch.tensor(MEAN, dtype=torch.float64)[:, None, None]) * 255
    features = oracle.vgg16(tensors, "base_model.base.", x, 28)[0]
    found = oracle.residuals(features, tensors["net_vlad.conv.weight"], tensors["net_vlad.centroids"])
    return oracle.vlad(found.sum(0), tensors["pca_layer.weight"], tensors["pca_layer.bias"])


NETWORK = PublishedNetwork(
    "sfrs",
    drawn,
    drawn_images((64, 96), (49, 70)),
    COMPONENTS,
    expected,
    arguments={"height": None, "width": None},
    tolerance=1e-4,
    wrong={"net_vlad.centroids": None},
    options={
        "as Pillow resizes": (
            {"height": 48, "width": 64},
            drawn_images((90, 130))[0],
            {"resized": partial(pillow, height=48, width=64)},
        )
    },
    refused=[("16 pixels", {}, (15, 40))],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)
