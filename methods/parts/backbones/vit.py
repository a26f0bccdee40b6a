"""The Vision Transformer of DINOv2, under its key names and sized from a checkpoint's own tensors."""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Self, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..published import Tensors, read_size

_HEAD = 64  # dimensions of an attention head, in all published sizes
_PATCH = 14  # pixels along a side
_EPSILON = 1e-6
_OFFSET = 0.1  # patches that DINOv2 adds to a grid's side, against rounding, when it stretches the position embedding
_BLOCK = re.compile(r"blocks\.(\d{1,9})\.")


@dataclass(frozen=True)
class Sizes:
    """The sizes of a Vision Transformer."""

    dim: int  # a multiple of 64: one attention head for each 64
    n_blocks: int
    n_hidden: int  # between the two linear layers of a block
    swiglu: bool = False  # a gate instead of GELU
    grid: int = 37  # patches along a side of the image that the position embedding belongs to


SIZES: Mapping[str, Sizes] = MappingProxyType(
    {
        "vits14": Sizes(dim=384, n_blocks=12, n_hidden=1536),
        "vitb14": Sizes(dim=768, n_blocks=12, n_hidden=3072),
        "vitl14": Sizes(dim=1024, n_blocks=24, n_hidden=4096),
        "vitg14": Sizes(dim=1536, n_blocks=40, n_hidden=4096, swiglu=True),
    }
)


@dataclass(frozen=True)
class Tokens:
    """The output of a Vision Transformer for images."""

    cls: Tensor  # (n, dim), of the whole image
    patches: Tensor  # (n, rows, columns, dim)


class VisionTransformer(nn.Module):
    """DINOv2's Vision Transformer, in evaluation mode and without gradients.

    Images are (n, 3, height, width) of the parameters' type, both sides multiples of 14 pixels. `norm` and
    `mask_token` say if there are parameters for the final norm and for the token that masks patches in training,
    which has no use here: some published files hold it and some don't.
    Source: Oquab et al. 2024 and facebookresearch/dinov2; no register tokens.
    """

    mask_token: nn.Parameter | None

    def __init__(self, sizes: Sizes, *, norm: bool = True, mask_token: bool = False) -> None:
        super().__init__()
        self.sizes = sizes
        self.cls_token = nn.Parameter(torch.zeros(1, 1, sizes.dim))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + sizes.grid**2, sizes.dim))
        self.mask_token = nn.Parameter(torch.zeros(1, sizes.dim)) if mask_token else None
        self.patch_embed = nn.Sequential(OrderedDict(proj=nn.Conv2d(3, sizes.dim, kernel_size=_PATCH, stride=_PATCH)))
        self.blocks = nn.ModuleList(_TransformerBlock(sizes) for _ in range(sizes.n_blocks))
        self.norm = nn.LayerNorm(sizes.dim, eps=_EPSILON) if norm else nn.Identity()
        self.eval().requires_grad_(False)

    @classmethod
    def sized(
        cls, tensors: Tensors, published: str = "vitb14", *, norm: bool = True, n_blocks: int | None = None
    ) -> Self:
        """Build the transformer of a checkpoint's tensors, or its first `n_blocks` blocks; nothing is loaded.

        The names are DINOv2's own, without a prefix; sizes that no tensor has are the ones of `published`.
        """
        sizes = _read_sizes(tensors, SIZES[published])
        sizes = sizes if n_blocks is None else replace(sizes, n_blocks=n_blocks)
        return cls(sizes, norm=norm, mask_token="mask_token" in tensors)

    def tokens(self, images: Tensor, *, normalised: bool) -> Tokens:
        """Return the tokens after the last block, with or without the final norm."""
        x, grid = self._embed_images(images)
        for block in self.blocks:
            x = block(x)
        if normalised:
            x = self.norm(x)
        return Tokens(cls=x[:, 0], patches=_lay_on_grid(x[:, 1:], grid))

    def values(self, images: Tensor) -> Tensor:
        """Return the value facet of the last block's attention, (n, rows, columns, dim).

        It is the last third of what `qkv` puts out, of the patches alone (Amir et al. 2022).
        """
        x, grid = self._embed_images(images)
        for earlier in self.blocks[:-1]:
            x = earlier(x)
        last = cast(_TransformerBlock, self.blocks[-1])
        qkv, inner = last.attn.qkv, last.norm1(x[:, 1:])
        return _lay_on_grid(functional.linear(inner, qkv.weight.chunk(3)[2], qkv.bias.chunk(3)[2]), grid)

    def _embed_images(self, images: Tensor) -> tuple[Tensor, tuple[int, int]]:
        """Return the first block's input (n, 1 + rows * columns, dim), the CLS token first, and (rows, columns)."""
        grid = (images.shape[2] // _PATCH, images.shape[3] // _PATCH)
        patches = self.patch_embed(images).flatten(2).transpose(1, 2)
        x = torch.cat([self.cls_token.expand(len(images), -1, -1), patches], 1)
        return x + self._stretch_positions(*grid).to(x.dtype), grid

    def _stretch_positions(self, rows: int, columns: int) -> Tensor:
        """Return the position embedding (1, 1 + rows * columns, dim), stretched to this grid of patches."""
        stored = self.sizes.grid
        if (rows, columns) == (stored, stored):
            return self.pos_embed
        embedding = self.pos_embed.float()
        # Not by `size`: DINOv2's offset moves every sampling point a little, and its weights have seen that.
        stretched = functional.interpolate(
            _lay_on_grid(embedding[:, 1:], (stored, stored)).permute(0, 3, 1, 2),
            scale_factor=((rows + _OFFSET) / stored, (columns + _OFFSET) / stored),
            mode="bicubic",
            align_corners=False,
            antialias=False,
        )
        return torch.cat([embedding[:, :1], stretched.flatten(2).transpose(1, 2)], 1)


def keep_first_blocks(tensors: Tensors, n_blocks: int) -> dict[str, Tensor]:
    """Return the tensors without the tensors of the blocks from number `n_blocks` on."""
    return {
        key: tensor for key, tensor in tensors.items() if not (found := _BLOCK.match(key)) or int(found[1]) < n_blocks
    }


class _TransformerBlock(nn.Module):
    """Attention, then a network for each token, each behind a norm and scaled before it is added."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(sizes.dim, eps=_EPSILON)
        self.attn = _Attention(sizes.dim)
        self.ls1 = _LayerScale(sizes.dim)
        self.norm2 = nn.LayerNorm(sizes.dim, eps=_EPSILON)
        self.mlp = _SwiGLU(sizes.dim, sizes.n_hidden) if sizes.swiglu else _build_mlp(sizes.dim, sizes.n_hidden)
        self.ls2 = _LayerScale(sizes.dim)

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.ls1(self.attn(self.norm1(x)))
        out: Tensor = x + self.ls2(self.mlp(self.norm2(x)))
        return out


class _Attention(nn.Module):
    """Every token looks at all, in heads of 64 dimensions."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(dim, 3 * dim)
        self.proj = nn.Linear(dim, dim)

    def forward(self, x: Tensor) -> Tensor:
        query, key, value = self.qkv(x).unflatten(2, (3, -1, _HEAD)).permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(query, key, value)  # (n, heads, tokens, 64)
        out: Tensor = self.proj(seen.transpose(1, 2).flatten(2))
        return out


class _LayerScale(nn.Module):
    """A factor for each dimension."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(dim))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gamma


class _SwiGLU(nn.Module):
    """Two linear layers, of which the first gives a gate and what passes it (Shazeer 2020)."""

    def __init__(self, dim: int, n_hidden: int) -> None:
        super().__init__()
        self.w12 = nn.Linear(dim, 2 * n_hidden)
        self.w3 = nn.Linear(n_hidden, dim)

    def forward(self, x: Tensor) -> Tensor:
        gate, passing = self.w12(x).chunk(2, -1)
        out: Tensor = self.w3(functional.silu(gate) * passing)
        return out


def _build_mlp(dim: int, n_hidden: int) -> nn.Sequential:
    """Return two linear layers around an exact GELU."""
    return nn.Sequential(OrderedDict(fc1=nn.Linear(dim, n_hidden), gelu=nn.GELU(), fc2=nn.Linear(n_hidden, dim)))


def _lay_on_grid(patches: Tensor, grid: tuple[int, int]) -> Tensor:
    """Return (n, rows * columns, dim) as (n, rows, columns, dim)."""
    return patches.reshape(len(patches), *grid, patches.shape[-1])


def _read_sizes(tensors: Tensors, published: Sizes) -> Sizes:
    """Read the sizes off a checkpoint's tensors; a size that no tensor of DINOv2 has is the published one."""
    if not tensors:
        return published
    swiglu = "blocks.0.mlp.w3.weight" in tensors
    hidden, axis = ("blocks.0.mlp.w3.weight", 1) if swiglu else ("blocks.0.mlp.fc1.weight", 0)
    return Sizes(
        read_size(tensors, "patch_embed.proj.weight", 0, published.dim),
        # Counted, not the highest number: a file may hold any, and strict loading finds a gap.
        len({found[1] for key in tensors if (found := _BLOCK.match(key))}) or published.n_blocks,
        read_size(tensors, hidden, axis, published.n_hidden),
        swiglu,
        math.isqrt(read_size(tensors, "pos_embed", 1, 1 + published.grid**2) - 1) or published.grid,
    )
