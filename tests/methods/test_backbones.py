"""The published sizes of the backbones, of which the networks that use them test what they compute."""

from pathlib import Path

import backbones_oracle as oracle
import pytest
import torch
from backbones_oracle import Draw

from vprbench.api.weights import load_strictly
from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.resnet import n_channels, resnet
from vprbench.methods.parts.backbones.vit import SIZES, VisionTransformer, first_blocks

RESNETS = {
    "resnet18": 11_176_512,
    "resnet34": 21_284_672,
    "resnet50": 23_508_032,
    "resnet101": 42_500_160,
    "resnet152": 58_143_808,
    "resnext101_32x8d": 86_742_336,
}


@pytest.mark.extended
@pytest.mark.parametrize("name", RESNETS)
def test_resnet_has_the_published_number_of_values_blocks_and_channels(name):
    with torch.device("meta"):
        model = resnet(name)
        found = [resnet(name, n_stages)(torch.empty(1, 3, 64, 64)).shape[1] for n_stages in (1, 2, 3, 4)]
    assert sum(weight.numel() for weight in model.parameters()) == RESNETS[name]
    assert tuple(len(stage) for stage in list(model)[4:]) == oracle.RESNETS[name][0]
    assert [n_channels(name, n_stages) for n_stages in (1, 2, 3, 4)] == found
    assert found == ([64, 128, 256, 512] if name in ("resnet18", "resnet34") else [256, 512, 1024, 2048])


def test_the_first_blocks_are_taken_by_their_whole_numbers():
    many = dict.fromkeys(("blocks.1.a", "blocks.2.a", "blocks.10.a", "norm.a"), torch.zeros(1))
    assert set(first_blocks(many, 2)) == {"blocks.1.a", "norm.a"}  # not the tenth


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
