"""The published sizes of DINOv2, of which the networks that use it test what they compute."""

from pathlib import Path

import backbones_oracle as oracle
import pytest
import torch
from backbones_oracle import Draw

from vprbench.api.weights import load_strictly
from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.vit import SIZES, VisionTransformer


@pytest.mark.parametrize("grid", [1, 23, 60])
def test_every_grid_gets_a_position_for_each_of_its_patches(grid):
    with torch.device("meta"):
        model = VisionTransformer.sized({}, "vits14", n_blocks=1)
        patches = model.tokens(torch.empty(1, 3, grid * 14, 2 * grid * 14), normalised=True).patches
    assert patches.shape == (1, grid, 2 * grid, 384)


@pytest.mark.parametrize(
    ("name", "n_weights"),
    [("vits14", 22_056_576), ("vitb14", 86_580_480), ("vitl14", 304_368_640), ("vitg14", 1_136_480_768)],
)
def test_a_published_size_is_read_off_its_checkpoint(name, n_weights):
    with torch.device("meta"):
        tensors = VisionTransformer(SIZES[name], mask_token=True).state_dict()
        other = "vits14" if name == "vitg14" else "vitg14"
        assert VisionTransformer.sized(tensors, other).sizes == SIZES[name]
        assert VisionTransformer.sized({}, name).sizes == SIZES[name]
    assert sum(tensor.numel() for tensor in tensors.values()) == n_weights


@pytest.mark.parametrize(
    ("key", "shape"),
    [
        ("patch_embed.proj.weight", None),
        ("blocks.0.mlp.fc1.weight", None),
        ("norm.weight", None),
        ("pos_embed", (26, 128)),
        ("pos_embed", (1, 28, 128)),
        ("patch_embed.proj.weight", (100, 3, 14, 14)),
        ("patch_embed.proj.weight", (128, 3, 0, 0)),
        ("blocks.999999999.ls1.gamma", (128,)),
    ],
)
def test_tensors_of_something_else_are_refused_by_name(key, shape):
    tensors = {name: t for name, t in oracle.vit_checkpoint(Draw()).items() if name not in (key, "mask_token")}
    tensors |= {} if shape is None else {key: torch.empty(shape)}
    with torch.device("meta"):
        model = VisionTransformer.sized(tensors)
    with pytest.raises(BadInput, match=key):
        load_strictly(model, tensors, Path("x"))
