"""A cross-image encoder computed slowly, in float64, from the names of `torch.nn.TransformerEncoder`'s tensors."""

from __future__ import annotations

import math

import torch
from backbones_oracle import Draw, Tensors, attention, layer_norm, prefixed, under
from torch import Tensor

HEADS = 16


def encoded_together(tensors: Tensors, parts: Tensor) -> Tensor:
    """What becomes of the parts (n_images, n_parts, dim) of images of which each sees all: norms after additions."""
    for number in range(2):
        t = under(tensors, f"encoder.layers.{number}.")
        seen = torch.empty_like(parts)
        for part in range(parts.shape[1]):  # a part sees the same part of all images
            seen[:, part] = attention(t, "self_attn", parts[:, part], parts[:, part], HEADS)
        parts = layer_norm(parts + seen, t["norm1.weight"], t["norm1.bias"], eps=1e-5)
        inner = parts @ t["linear1.weight"].T + t["linear1.bias"]
        inner = inner * (1 + torch.erf(inner / math.sqrt(2))) / 2
        inner = inner @ t["linear2.weight"].T + t["linear2.bias"]
        parts = layer_norm(parts + inner, t["norm2.weight"], t["norm2.bias"], eps=1e-5)
    return parts


def encoder_checkpoint(draw: Draw, dim: int, hidden: int) -> dict[str, Tensor]:
    """Random values, so large that images change one another."""
    tensors = {}
    for number in range(2):
        layer = {
            **draw.attention("self_attn", dim),
            **draw.linear("linear1", dim, hidden),
            **draw.linear("linear2", hidden, dim),
            **draw.norm("norm1", dim),
            **draw.norm("norm2", dim),
        }
        tensors |= prefixed(f"encoder.layers.{number}.", layer)
    return tensors
