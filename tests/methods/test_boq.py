"""BoQ: against attention written out by hand in float64, straight from the tensors of a checkpoint."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import imagenet, layer_norm, resnet, resnet_checkpoint, vit_checkpoint, vit_tokens
from described_images import image
from published_networks import PublishedNetwork, saved, with_checks
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api.arrays import Image

DIM, QUERIES, ROWS = 128, 7, 5  # two heads; published are 384 or 512, 64 and 32
SIZES = {"dinov2": (42, 56), "resnet50": (48, 80)}

Tensors = dict[str, Tensor]


def aggregator(generator: torch.Generator, n_channels: int) -> Tensors:
    """Random values under the published names, so large that every part matters."""

    def normal(*shape: int, scale: float = 1.0, mean: float = 0.0) -> Tensor:
        return mean + scale * torch.randn(shape, generator=generator)

    def linear(name: str, n_in: int, n_out: int) -> Tensors:
        return {f"{name}.weight": normal(n_out, n_in, scale=n_in**-0.5), f"{name}.bias": normal(n_out, scale=0.3)}

    def norm(name: str) -> Tensors:
        return {f"{name}.weight": normal(DIM, scale=0.3, mean=1), f"{name}.bias": normal(DIM, scale=0.3)}

    def attention(name: str) -> Tensors:
        inner = {f"{name}.in_proj_weight": normal(3 * DIM, DIM, scale=1.5 * DIM**-0.5)}
        return inner | {f"{name}.in_proj_bias": normal(3 * DIM, scale=0.3)} | linear(f"{name}.out_proj", DIM, DIM)

    tensors = {"proj_c.weight": normal(DIM, n_channels, 3, 3, scale=(9 * n_channels) ** -0.5)}
    tensors |= {"proj_c.bias": normal(DIM, scale=0.3)} | norm("norm_input") | linear("fc", 2 * QUERIES, ROWS)
    for number in (0, 1):
        block = {"queries": normal(1, QUERIES, DIM)}
        block |= attention("self_attn") | attention("cross_attn") | norm("norm_q") | norm("norm_out")
        block |= attention("encoder.self_attn") | norm("encoder.norm1") | norm("encoder.norm2")
        block |= linear("encoder.linear1", DIM, 4 * DIM) | linear("encoder.linear2", 4 * DIM, DIM)
        tensors |= {f"boqs.{number}.{name}": value for name, value in block.items()}
    return {f"aggregator.{name}": value for name, value in tensors.items()}


def checkpoint(kind: str) -> Tensors:
    generator = torch.Generator().manual_seed(5)
    if kind == "resnet50":
        backbone, n_channels = resnet_checkpoint(generator, kind, "backbone.net.", n_stages=3), 1024
    else:
        n_channels = 64
        backbone = {f"backbone.dino.{name}": value for name, value in vit_checkpoint(generator, n_channels).items()}
        backbone["backbone.dino.mask_token"] = torch.randn(1, n_channels, generator=generator)
    return backbone | aggregator(generator, n_channels)


def images() -> list[Image]:
    return [image(*size, 3 + number) for number, size in enumerate([(64, 96), (64, 96), (93, 53)])]


def seen(image: Image, size: tuple[int, int], antialias: bool = True, mode: str = "bicubic") -> Tensor:
    return functional.interpolate(imagenet(image), size, mode=mode, antialias=antialias)


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


def local_features(tensors: Tensors, kind: str, image: Image, size: tuple[int, int], trap: str = "") -> Tensor:
    """What the backbone makes of an image, (1, n_channels, rows, columns)."""
    mode = "bilinear" if trap == "bilinear" else "bicubic"
    x = seen(image, size, antialias=trap != "not antialiased", mode=mode)
    if kind == "resnet50":
        return resnet(tensors, "backbone.net.", x, kind, n_stages=3)
    tokens = vit_tokens(tensors, "backbone.dino.", x, final_norm=trap == "with DINOv2's final norm")
    return tokens[:, 1:].transpose(1, 2).unflatten(2, (size[0] // 14, size[1] // 14))


def gathered(t: Tensors, features: Tensor, trap: str = "") -> npt.NDArray[np.float64]:
    """The descriptor of one image's features, before the last normalisation; `trap` names one deliberate mistake."""
    x = functional.conv2d(features, t["proj_c.weight"], t["proj_c.bias"], padding=1).flatten(2)[0].T
    if trap != "without the norm of the input":
        x = norm(t, "norm_input", x)
    outs = []
    for number in (0, 1):
        at, before = f"boqs.{number}", x
        if trap == "norms before":
            inner = norm(t, f"{at}.encoder.norm1", x)
            x = x + attention(t, f"{at}.encoder.self_attn", inner, inner)
            inner = norm(t, f"{at}.encoder.norm2", x)
        else:
            x = norm(t, f"{at}.encoder.norm1", x + attention(t, f"{at}.encoder.self_attn", x, x))
            inner = x
        inner = inner @ t[f"{at}.encoder.linear1.weight"].T + t[f"{at}.encoder.linear1.bias"]
        inner = functional.gelu(inner) if trap == "GELU" else inner.clamp(min=0)
        x = x + inner @ t[f"{at}.encoder.linear2.weight"].T + t[f"{at}.encoder.linear2.bias"]
        if trap != "norms before":
            x = norm(t, f"{at}.encoder.norm2", x)
        queries = t[f"{at}.queries"][0]
        mixed = attention(t, f"{at}.self_attn", queries, queries)
        asking = norm(t, f"{at}.norm_q", mixed if trap == "queries not added" else queries + mixed)
        out = attention(t, f"{at}.cross_attn", asking, before if trap == "features not refined" else x)
        outs.append(norm(t, f"{at}.norm_out", asking + out if trap == "queries added twice" else out))
    if trap == "blocks the other way round":
        outs.reverse()
    rows = torch.cat(outs).T @ t["fc.weight"].T + t["fc.bias"][None]  # (DIM, ROWS)
    return (rows.T if trap == "rows first" else rows).flatten().numpy()


def by_hand(
    tensors: Tensors, kind: str, image: Image, size: tuple[int, int], trap: str = ""
) -> npt.NDArray[np.float64]:
    t = {name.removeprefix("aggregator."): v.double() for name, v in tensors.items() if name.startswith("agg")}
    code = gathered(t, local_features(tensors, kind, image, size, trap), trap)
    return code / np.linalg.norm(code)


def expected(kind: str) -> Callable[..., npt.NDArray[np.float64]]:
    return lambda tensors, images, trap="", size=SIZES[kind]: np.stack(
        [by_hand(tensors, kind, x, size, trap) for x in images]
    )


def without(name: str) -> Callable[[Tensors], Tensors]:
    return lambda tensors: {key: value for key, value in tensors.items() if name not in key}


def renamed(tensors: Tensors) -> Tensors:
    """The names of the other public wrapper."""
    others = {
        "net.0.": "frozen_layers.0.0.",
        "net.1.": "frozen_layers.0.1.",
        "net.4.": "frozen_layers.1.",
        "net.5.": "frozen_layers.2.",
        "net.6.": "unfrozen_layers.0.",
    }
    return {
        re.sub(r"(?<=^backbone\.)net\.\d\.", lambda found: others[found[0]], name): value
        for name, value in tensors.items()
    }


def network(name: str, kind: str, **more: Any) -> PublishedNetwork:
    height, width = SIZES[kind]
    draw = partial(checkpoint, kind)
    arguments = {"height": height, "width": width}
    return PublishedNetwork(name, draw, images(), DIM * ROWS, expected(kind), arguments=arguments, **more)


DINO = network(
    "boq",
    "dinov2",
    alike_in_half=0.998,
    trap_distance=3e-3,
    traps=[
        {"trap": trap}
        for trap in (
            "with DINOv2's final norm",
            "bilinear",
            "not antialiased",
            "without the norm of the input",
            "norms before",
            "GELU",
            "queries not added",
            "queries added twice",
            "features not refined",
            "blocks the other way round",
            "rows first",
        )
    ],
    missing=[
        "backbone.dino.blocks.1.ls2.gamma",
        "backbone.dino.norm.bias",
        "backbone.dino.pos_embed",
        "aggregator.proj_c.weight",
        "aggregator.boqs.0.queries",
        "aggregator.boqs.1.queries",
        "aggregator.boqs.1.norm_q.weight",
        "aggregator.boqs.0.cross_attn.in_proj_bias",
        "aggregator.fc.bias",
    ],
    unexpected=["aggregator.fc.scale", "backbone.dino.head.weight", "aggregator.boqs.2.norm_q.weight"],
    misshapen={
        "aggregator.fc.bias": (9,),
        "aggregator.fc.weight": (5, 13),
        "aggregator.proj_c.weight": (96, 64, 3, 3),
    },
    options={"own size": ({"height": None, "width": None}, [image(93, 53)], {"size": (98, 56)})},
    refused=[("method.height=40", {"height": 40}, (64, 96))],
    forms={
        "no final norm": without("backbone.dino.norm."),
        "no mask token": without("mask_token"),
        "float64": lambda tensors: {name: value.double() for name, value in tensors.items()},
    },
    contract={"height": 28, "width": 28},
)
RESNET = network(
    "boq_resnet50",
    "resnet50",
    missing=["backbone.net.6.5.bn3.running_var", "backbone.net.0.weight"],
    unexpected=["backbone.net.7.0.bn1.bias", "backbone.unfrozen_layers.1.w"],
    options={"own size": ({"height": None, "width": None}, [image(93, 53)], {"size": (93, 53)})},
    forms={
        "other wrapper": renamed,
        "no counters": without("num_batches_tracked"),
        "nested": lambda tensors: {"epoch": 3, "state_dict": dict(tensors)},
    },
    contract={"height": 32, "width": 32},
)


@with_checks(DINO, RESNET)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_torchs_own_encoder_gives_what_is_written_out_here() -> None:
    layer = nn.TransformerEncoderLayer(DIM, DIM // 64, 4 * DIM, dropout=0, batch_first=True, dtype=torch.float64)
    prefix = "aggregator.boqs.0.encoder."
    t = {k.removeprefix(prefix): v.double() for k, v in DINO.tensors.items() if k.startswith(prefix)}
    layer.load_state_dict(t)
    x = torch.randn(9, DIM, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    inner = norm(t, "norm1", x + attention(t, "self_attn", x, x))
    hidden = (inner @ t["linear1.weight"].T + t["linear1.bias"]).clamp(min=0)
    wanted = norm(t, "norm2", inner + hidden @ t["linear2.weight"].T + t["linear2.bias"])
    with torch.no_grad():
        assert torch.allclose(layer.train()(x[None])[0], wanted, atol=1e-12)


def test_one_tensor_under_the_names_of_two_wrappers_is_refused(folder: Path) -> None:
    twice = {**RESNET.tensors, "backbone.frozen_layers.0.0.weight": RESNET.tensors["backbone.net.0.weight"]}
    assert "backbone.net.0.weight" in RESNET.refusal(saved(folder / "twice.pth", twice))


@pytest.mark.parametrize(("own", "other"), [(DINO, RESNET), (RESNET, DINO)])
def test_the_file_of_the_other_backbone_is_refused(own: PublishedNetwork, other: PublishedNetwork, folder) -> None:
    assert "aggregator.proj_c.weight" in own.refusal(other.file(folder))


@pytest.mark.parametrize("own", [DINO, RESNET])
def test_a_blank_network_has_the_names_and_sizes_of_the_published_file(own: PublishedNetwork) -> None:
    found = {name: tuple(value.shape) for name, value in own.method(Path("none")).blank().state_dict().items()}
    more = {name for name in found if re.match(r"backbone\.dino\.blocks\.([2-9]|1\d)\.", name)}
    optional = {f"backbone.dino.{name}" for name in ("norm.weight", "norm.bias", "mask_token")}
    assert set(found) - more == set(own.tensors) - optional
    dim, n_channels = (384, 768) if own is DINO else (512, 1024)
    assert found["aggregator.boqs.1.queries"] == (1, 64, dim)
    assert found["aggregator.boqs.0.encoder.linear1.weight"] == (4 * dim, dim)
    assert found["aggregator.fc.weight"] == (32, 128)
    assert found["aggregator.proj_c.weight"] == (dim, n_channels, 3, 3)
