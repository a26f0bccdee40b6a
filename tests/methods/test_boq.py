"""BoQ: against attention written out by hand in float64, straight from the tensors of a checkpoint."""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from backbones_oracle import (
    Draw,
    Tensors,
    imagenet,
    layer_norm,
    prefixed,
    resnet,
    resnet_checkpoint,
    under,
    vit_checkpoint,
    vit_tokens,
)
from described_images import image
from published_networks import PublishedNetwork, saved, with_checks, without
from torch import Tensor
from torch.nn import functional

from vprbench.api.arrays import Image

DIM, QUERIES, ROWS = 128, 7, 5  # two heads; published are 384 or 512, 64 and 32
SIZES = {"dinov2": (42, 56), "resnet50": (48, 80)}


def aggregator(draw: Draw, n_channels: int) -> Tensors:
    def attention(name: str) -> Tensors:
        inner = {f"{name}.in_proj_weight": draw.normal(3 * DIM, DIM, scale=1.5 * DIM**-0.5)}
        return (
            inner
            | {f"{name}.in_proj_bias": draw.normal(3 * DIM, scale=0.3)}
            | draw.linear(f"{name}.out_proj", DIM, DIM)
        )

    tensors = {"proj_c.weight": draw.normal(DIM, n_channels, 3, 3, scale=(9 * n_channels) ** -0.5)}
    tensors |= {"proj_c.bias": draw.normal(DIM, scale=0.3)}
    tensors |= draw.norm("norm_input", DIM) | draw.linear("fc", 2 * QUERIES, ROWS)
    for number in (0, 1):
        block = {"queries": draw.normal(1, QUERIES, DIM)}
        for name in ("self_attn", "cross_attn", "encoder.self_attn"):
            block |= attention(name)
        for name in ("norm_q", "norm_out", "encoder.norm1", "encoder.norm2"):
            block |= draw.norm(name, DIM)
        block |= draw.linear("encoder.linear1", DIM, 4 * DIM) | draw.linear("encoder.linear2", 4 * DIM, DIM)
        tensors |= prefixed(f"boqs.{number}.", block)
    return prefixed("aggregator.", tensors)


def checkpoint(kind: str) -> Tensors:
    draw = Draw(5)
    if kind == "resnet50":
        return resnet_checkpoint(draw, kind, "backbone.net.", n_stages=3) | aggregator(draw, 1024)
    return prefixed("backbone.dino.", vit_checkpoint(draw, 64)) | aggregator(draw, 64)


def attention(t: Tensors, at: str, asking: Tensor, asked: Tensor) -> Tensor:
    """One image, (n_asking, DIM) of (n_asked, DIM): softmax(Q K' / sqrt(64)) V in each head of 64 dimensions."""
    weights, biases = t[f"{at}.in_proj_weight"].chunk(3), t[f"{at}.in_proj_bias"].chunk(3)
    q, k, v = (x @ w.T + b for x, w, b in zip((asking, asked, asked), weights, biases, strict=True))
    heads = []
    for start in range(0, DIM, 64):
        of_head = slice(start, start + 64)
        shares = torch.softmax(q[:, of_head] @ k[:, of_head].T / math.sqrt(64), dim=1)
        heads.append(shares @ v[:, of_head])
    return torch.cat(heads, 1) @ t[f"{at}.out_proj.weight"].T + t[f"{at}.out_proj.bias"]


def norm(t: Tensors, at: str, x: Tensor) -> Tensor:
    return layer_norm(x, t[f"{at}.weight"], t[f"{at}.bias"], eps=1e-5)


def expected(kind: str, tensors: Tensors, image: Image, size: tuple[int, int] | None = None) -> Tensor:
    height, width = size or SIZES[kind]
    seen = functional.interpolate(imagenet(image), (height, width), mode="bicubic", antialias=True)
    if kind == "resnet50":
        features = resnet(tensors, "backbone.net.", seen, kind, n_stages=3)
    else:
        tokens = vit_tokens(tensors, "backbone.dino.", seen, final_norm=False)
        features = tokens[:, 1:].transpose(1, 2).unflatten(2, (height // 14, width // 14))
    t = under(tensors, "aggregator.")
    x = functional.conv2d(features, t["proj_c.weight"], t["proj_c.bias"], padding=1).flatten(2)[0].T
    x = norm(t, "norm_input", x)
    outs = []
    for number in (0, 1):
        b = under(t, f"boqs.{number}.")
        x = norm(b, "encoder.norm1", x + attention(b, "encoder.self_attn", x, x))
        inner = (x @ b["encoder.linear1.weight"].T + b["encoder.linear1.bias"]).clamp(min=0)
        x = norm(b, "encoder.norm2", x + inner @ b["encoder.linear2.weight"].T + b["encoder.linear2.bias"])
        queries = b["queries"][0]
        asking = norm(b, "norm_q", queries + attention(b, "self_attn", queries, queries))
        outs.append(norm(b, "norm_out", attention(b, "cross_attn", asking, x)))
    return (torch.cat(outs).T @ t["fc.weight"].T + t["fc.bias"]).flatten()  # (DIM, ROWS)


def renamed(tensors: Tensors) -> Tensors:
    """The names of the other public wrapper."""
    others = {
        "0": "frozen_layers.0.0",
        "1": "frozen_layers.0.1",
        "4": "frozen_layers.1",
        "5": "frozen_layers.2",
        "6": "unfrozen_layers.0",
    }
    return {re.sub(r"^(backbone\.)net\.(\d)", lambda m: m[1] + others[m[2]], name): t for name, t in tensors.items()}


def network(name: str, kind: str, **more: Any) -> PublishedNetwork:
    height, width = SIZES[kind]
    images = [image(*size, number) for number, size in enumerate([(64, 96), (64, 96), (93, 53)])]
    arguments = {"height": height, "width": width}
    draw = partial(checkpoint, kind)
    return PublishedNetwork(name, draw, images, DIM * ROWS, partial(expected, kind), arguments=arguments, **more)


DINO = network(
    "boq",
    "dinov2",
    alike_in_half=0.998,
    wrong={
        "backbone.dino.norm.bias": None,
        "aggregator.boqs.0.queries": None,
        "aggregator.boqs.2.norm_q.weight": (3, 3),
        "aggregator.fc.weight": (5, 13),
        "aggregator.proj_c.weight": (96, 64, 3, 3),
    },
    options={"own size": ({"height": None, "width": None}, image(93, 53), {"size": (98, 56)})},
    refused=[("method.height=40", {"height": 40}, (64, 96))],
    forms={
        "no final norm": without("backbone.dino.norm."),
        "no mask token": without("mask_token"),
        "float64": lambda tensors: {name: value.double() for name, value in tensors.items()},
    },
)
RESNET = network(
    "boq_resnet50",
    "resnet50",
    wrong={"backbone.unfrozen_layers.1.w": (3, 3)},
    options={"own size": ({"height": None, "width": None}, image(93, 53), {"size": (93, 53)})},
    forms={
        "other wrapper": renamed,
        "no counters": without("num_batches_tracked"),
        "nested": lambda tensors: {"epoch": 3, "state_dict": dict(tensors)},
    },
)


@with_checks(DINO, RESNET)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_one_tensor_under_the_names_of_two_wrappers_is_refused(folder: Path) -> None:
    twice = {**RESNET.tensors, "backbone.frozen_layers.0.0.weight": RESNET.tensors["backbone.net.0.weight"]}
    assert "backbone.net.0.weight" in RESNET.refusal(saved(folder / "twice.pth", twice))


@pytest.mark.parametrize(("own", "other"), [(DINO, RESNET), (RESNET, DINO)])
def test_the_file_of_the_other_backbone_is_refused(own: PublishedNetwork, other: PublishedNetwork, folder) -> None:
    assert "aggregator.proj_c.weight" in own.refusal(other.file(folder))
