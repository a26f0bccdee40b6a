"""MegaLoc: equal to a slow computation from the tensors of a file by their published names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from backbones_oracle import Tensors, imagenet, salad, salad_checkpoint, vit_checkpoint, vit_tokens
from described_images import image
from published_networks import PublishedNetwork, with_checks
from safetensors.torch import save_file
from torch import Generator, Tensor, randn
from torch.nn import functional

from vprbench.api.arrays import Image

N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM, N_DIMENSIONS = 7, 12, 10, 40


def drawn() -> dict[str, Tensor]:
    generator = Generator().manual_seed(3)
    dino = vit_checkpoint(generator)
    aggregator = salad_checkpoint(generator, 128, N_CLUSTERS, CLUSTER_DIM, TOKEN_DIM)
    n_inner = N_CLUSTERS * CLUSTER_DIM + TOKEN_DIM
    return {
        **{f"backbone.{name}": tensor for name, tensor in dino.items()},
        **{f"aggregator.agg.{name}": tensor for name, tensor in aggregator.items()},
        "aggregator.linear.weight": randn(N_DIMENSIONS, n_inner, generator=generator),
        "aggregator.linear.bias": 0.5 * randn(N_DIMENSIONS, generator=generator),
    }


def saved(path: Path, tensors: Tensors) -> Path:
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def described(
    tensors: Tensors, seen: Tensor, side: tuple[int, int] | None = None, final_norm: bool = True, unit: bool = True
) -> npt.NDArray[Any]:
    seen = seen if side is None else functional.interpolate(seen, side, mode="bilinear", antialias=True)
    tokens = vit_tokens(tensors, "backbone.", seen, final_norm=final_norm)[0]
    inner = salad(tensors, "aggregator.agg.", tokens) * (1 if unit else 7)
    weight, bias = (tensors[f"aggregator.linear.{part}"].double() for part in ("weight", "bias"))
    vector = weight @ inner + bias
    return (vector / vector.norm()).numpy()


def expected(tensors: Tensors, images: Sequence[Image], **how: Any) -> npt.NDArray[Any]:
    return np.stack([described(tensors, imagenet(seen), **how) for seen in images])


NETWORK = PublishedNetwork(
    "megaloc",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    N_DIMENSIONS,
    expected,
    saved,
    traps=[{"final_norm": False}, {"unit": False}],
    missing=[
        "aggregator.linear.weight",
        "aggregator.linear.bias",
        "aggregator.agg.dust_bin",
        "aggregator.agg.score.3.weight",
        "backbone.norm.weight",
        "backbone.blocks.0.ls1.gamma",
    ],
    unexpected=["aggregator.score.0.weight", "backbone.model.cls_token"],
    misshapen={"aggregator.linear.weight": (3, 5), "aggregator.agg.token_features.2.bias": (3, 5)},
    hidden_prefixes=("backbone.",),
    options={
        f"antialiased floats of {rows}x{columns} patches": ({}, [image(*size)], {"side": (14 * rows, 14 * columns)})
        for size, rows, columns in [((50, 90), 4, 6), ((64, 96), 5, 7), ((41, 43), 3, 3)]
    },
    refused=[("6 patches", {}, (28, 42))],
)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)
