"""MegaLoc: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from pathlib import Path

from backbones_oracle import Draw, Tensors, imagenet, prefixed, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import image
from published_networks import PublishedNetwork, with_checks
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional

from vprbench.api.arrays import Image

N_INNER, N_DIMENSIONS = 7 * 12 + 10, 40


def drawn() -> dict[str, Tensor]:
    draw = Draw(3)
    aggregator = prefixed("agg.", salad_checkpoint(draw, clusters=7, cluster_dim=12, token_dim=10))
    aggregator |= {
        "linear.weight": draw.normal(N_DIMENSIONS, N_INNER),
        "linear.bias": draw.normal(N_DIMENSIONS, scale=0.5),
    }
    return prefixed("backbone.", vit_checkpoint(draw)) | prefixed("aggregator.", aggregator)


def saved(path: Path, tensors: Tensors) -> Path:
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def expected(tensors: Tensors, image: Image, side: tuple[int, int] | None = None) -> Tensor:
    """An image is seen as antialiased floats at the nearest multiples of 14."""
    seen = imagenet(image)
    seen = seen if side is None else functional.interpolate(seen, side, mode="bilinear", antialias=True)
    inner = salad(tensors, "aggregator.agg.", vit_tokens(tensors, "backbone.", seen)[0])
    return tensors["aggregator.linear.weight"].double() @ inner + tensors["aggregator.linear.bias"].double()


NETWORK = PublishedNetwork(
    "megaloc",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    N_DIMENSIONS,
    expected,
    saved,
    wrong={"aggregator.agg.dust_bin": None, "aggregator.linear.weight": (3, 5)},
    options={
        f"{height}x{width} pixels": ({}, image(height, width), {"side": (14 * rows, 14 * columns)})
        for height, width, rows, columns in [(50, 90, 4, 6), (64, 96, 5, 7), (41, 43, 3, 3)]
    },
    refused=[("6 patches", {}, (28, 42))],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)
