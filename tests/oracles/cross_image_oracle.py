"""A cross-image encoder computed slowly, in float64, from the names of `torch.nn.TransformerEncoder`'s tensors."""

import torch
from backbones_oracle import attention, layer_norm, linear, prefixed, under
from torch.nn import functional

HEADS = 16


def encoded_together(tensors, parts):
    """What becomes of the parts (n_images, n_parts, dim) of images of which each sees all: norms after additions."""
    for number in range(2):
        t = under(tensors, f"encoder.layers.{number}.")
        together = parts.unbind(1)  # a part sees the same part of all images
        seen = torch.stack([attention(t, "self_attn", part, part, HEADS) for part in together], 1)
        parts = layer_norm(parts + seen, t["norm1.weight"], t["norm1.bias"], eps=1e-5)
        inner = linear(t, "linear2", functional.gelu(linear(t, "linear1", parts)))
        parts = layer_norm(parts + inner, t["norm2.weight"], t["norm2.bias"], eps=1e-5)
    return parts


def encoder_checkpoint(draw, dim, hidden):
    """Random values, so large that images change one another."""
    tensors = {}
    for number in range(2):
        layer = draw.attention("self_attn", dim) | draw.norm("norm1", dim) | draw.norm("norm2", dim)
        layer |= draw.linear("linear1", dim, hidden) | draw.linear("linear2", hidden, dim)
        tensors |= prefixed(f"encoder.layers.{number}.", layer)
    return tensors
