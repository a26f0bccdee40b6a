"""A cross-image encoder computed slowly, in float64, from the names of `torch.nn.TransformerEncoder`'s tensors."""

from __future__ import annotations

import math

import torch
from backbones_oracle import Tensors, layer_norm
from torch import Tensor

HEADS = 16


def encoded_together(tensors: Tensors, parts: Tensor) -> Tensor:
    """What becomes of the parts (n_images, n_parts, dim) of images of which each sees all: norms after additions."""
    for number in range(2):
        at = f"encoder.layers.{number}."
        t = {name.removeprefix(at): value.double() for name, value in tensors.items() if name.startswith(at)}
        seen = torch.empty_like(parts)
        for part in range(parts.shape[1]):  # a part sees the same part of all images
            seen[:, part] = _attention(t, parts[:, part])
        parts = layer_norm(parts + seen, t["norm1.weight"], t["norm1.bias"], eps=1e-5)
        inner = parts @ t["linear1.weight"].T + t["linear1.bias"]
        inner = inner * (1 + torch.erf(inner / math.sqrt(2))) / 2
        inner = inner @ t["linear2.weight"].T + t["linear2.bias"]
        parts = layer_norm(parts + inner, t["norm2.weight"], t["norm2.bias"], eps=1e-5)
    return parts


def encoder_checkpoint(
    generator: torch.Generator, dim: int, hidden: int, prefix: str = "encoder."
) -> dict[str, Tensor]:
    """Random values, so large that images change one another."""

    def normal(*shape: int, scale: float = 1.0) -> Tensor:
        return scale * torch.randn(shape, generator=generator)

    tensors = {}
    for number in range(2):
        at = f"encoder.layers.{number}."
        tensors |= {
            f"{at}self_attn.in_proj_weight": normal(3 * dim, dim, scale=2 * dim**-0.5),
            f"{at}self_attn.in_proj_bias": normal(3 * dim, scale=0.3),
        }
        for name, (n_out, n_in) in {
            "self_attn.out_proj": (dim, dim),
            "linear1": (hidden, dim),
            "linear2": (dim, hidden),
        }.items():
            tensors |= {f"{at}{name}.weight": normal(n_out, n_in, scale=n_in**-0.5)}
            tensors |= {f"{at}{name}.bias": normal(n_out, scale=0.3)}
        for name in ("norm1", "norm2"):
            tensors |= {f"{at}{name}.weight": 1 + normal(dim, scale=0.2), f"{at}{name}.bias": normal(dim, scale=0.2)}
    return tensors


def _attention(t: Tensors, x: Tensor) -> Tensor:
    """Attention of (n_images, dim) among the images, in 16 heads."""
    width = x.shape[1] // HEADS
    query, key, value = (x @ t["self_attn.in_proj_weight"].T + t["self_attn.in_proj_bias"]).chunk(3, dim=1)
    mixed = []
    for head in range(HEADS):
        own = slice(head * width, (head + 1) * width)
        weights = torch.softmax(query[:, own] @ key[:, own].T / math.sqrt(width), dim=1)
        mixed.append(weights @ value[:, own])
    return torch.cat(mixed, dim=1) @ t["self_attn.out_proj.weight"].T + t["self_attn.out_proj.bias"]
