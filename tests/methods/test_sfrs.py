"""SFRS against a float64 version written from the key names of its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import torch
from described_images import drawn_images, pillow
from published_networks import PublishedNetwork, with_checks

MEAN = (0.48501960784313836, 0.4579568627450961, 0.4076039215686255)  # of RGB, 0 to 1, as its authors have it
TOLERANCE = 1e-4
CLUSTERS, COMPONENTS = 3, 8


def drawn() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    tensors = oracle.vgg16_checkpoint(generator, "base_model.base.")
    tensors["base_model.base.0.weight"] /= 60  # it sees levels
    return tensors | {
        "net_vlad.centroids": torch.randn(CLUSTERS, 512, generator=generator) / 512**0.5,
        "net_vlad.conv.weight": 4 * torch.randn(CLUSTERS, 512, 1, 1, generator=generator),
        "pca_layer.weight": torch.randn(COMPONENTS, CLUSTERS * 512, 1, 1, generator=generator),
        "pca_layer.bias": 0.5 * torch.randn(COMPONENTS, generator=generator),
    }


def expected(
    tensors: dict[str, torch.Tensor],
    images: Sequence[np.ndarray],
    *,
    deviation: float = 1 / 255,
    cluster_fastest: bool = False,
    residuals: bool = True,
    resized: Callable[[np.ndarray], np.ndarray] = lambda image: image,
    last: int = 28,
) -> np.ndarray:
    """Descriptors in float64; the options step into traps."""
    t = {name: tensor.double() for name, tensor in tensors.items()}
    descriptors = []
    for image in images:
        x = torch.from_numpy(resized(image).astype(np.float64)).permute(2, 0, 1)[None] / 255
        x = (x - torch.tensor(MEAN, dtype=torch.float64)[:, None, None]) / deviation
        local = oracle.vgg16(tensors, "base_model.base.", x, last)[0].flatten(1).T
        local = local / local.norm(dim=1, keepdim=True)
        shares = torch.softmax(local @ t["net_vlad.conv.weight"].flatten(1).T, dim=1)
        vlad = torch.zeros(CLUSTERS, 512, dtype=torch.float64)
        for k in range(CLUSTERS):
            centre = t["net_vlad.centroids"][k] if residuals else 0
            vlad[k] = (shares[:, k, None] * (local - centre)).sum(0)
            vlad[k] /= vlad[k].norm()
        vector = (vlad.T if cluster_fastest else vlad).flatten()
        whitened = t["pca_layer.weight"].flatten(1) @ (vector / vector.norm()) + t["pca_layer.bias"]
        descriptors.append((whitened / whitened.norm()).numpy())
    return np.array(descriptors)


NETWORK = PublishedNetwork(
    "sfrs",
    drawn,
    drawn_images((64, 96), (49, 70)),
    COMPONENTS,
    expected,
    arguments={"height": None, "width": None},
    tolerance=TOLERANCE,
    batch_tolerance=1e-5,
    traps=[{"deviation": 0.226}, {"cluster_fastest": True}, {"residuals": False}, {"last": 29}],
    missing=["base_model.base.28.bias", "net_vlad.centroids", "pca_layer.bias"],
    options={
        "as Pillow resizes": (
            {"height": 48, "width": 64},
            drawn_images((90, 130)),
            {"resized": partial(pillow, height=48, width=64)},
        )
    },
    contract={"height": 16, "width": 16},
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)
