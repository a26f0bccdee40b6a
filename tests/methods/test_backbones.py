"""The published sizes of DINOv2, of which the networks that use it test what they compute."""

import pytest
import torch

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
