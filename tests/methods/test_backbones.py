"""The backbones against float64 versions written straight from the key names, and the published sizes."""

from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from backbones_oracle import Draw

from vprbench.api.weights import load_strictly
from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.resnet import n_channels, resnet
from vprbench.methods.parts.backbones.vgg import vgg16_features
from vprbench.methods.parts.backbones.vit import SIZES, VisionTransformer, first_blocks

RESNETS = {
    "resnet18": 11_176_512,
    "resnet34": 21_284_672,
    "resnet50": 23_508_032,
    "resnet101": 42_500_160,
    "resnet152": 58_143_808,
    "resnext101_32x8d": 86_742_336,
}


def loaded(tensors, build, *arguments, **options):
    """A backbone with these tensors, taken strictly."""
    with torch.device("meta"):
        model = build(*arguments, **options)
    model.load_state_dict(tensors, strict=True, assign=True)
    return model


def images(height, width, n=2):
    return Draw(1).normal(n, 3, height, width)


def assert_same(fast, slow, tolerance=2e-5):
    """Equal to within a part of what the slow values typically are."""
    np.testing.assert_allclose(fast.detach().numpy(), slow.numpy(), rtol=0, atol=tolerance * slow.std().item())


@pytest.mark.parametrize(("n_layers", "shape"), [(29, (1, 512, 4, 6)), (31, (1, 512, 2, 3))])
def test_vgg16_equals_the_slow_version_at_both_cuts(n_layers, shape):
    tensors, x = oracle.vgg16_checkpoint(Draw()), images(64, 96, n=1)
    out = loaded(tensors, vgg16_features, n_layers)(x)
    assert out.shape == shape
    assert_same(out, oracle.vgg16(tensors, "", x, n_layers - 1))


@pytest.mark.parametrize(
    ("name", "n_stages"),
    [("resnet18", 2), ("resnet50", 4), pytest.param("resnext101_32x8d", 4, marks=pytest.mark.extended)],
)
def test_resnet_equals_the_slow_version(name, n_stages):
    tensors, x = oracle.resnet_checkpoint(Draw(), name, n_stages=n_stages), images(75, 50, n=1)
    out = loaded(tensors, resnet, name, n_stages)(x)
    assert out.shape[:2] == (1, n_channels(name, n_stages))
    assert_same(out, oracle.resnet(tensors, "", x, name, n_stages), tolerance=1e-4)


@pytest.mark.parametrize("name", RESNETS)
def test_resnet_has_the_published_number_of_values_blocks_and_channels(name):
    with torch.device("meta"):
        model = resnet(name)
        found = [resnet(name, n_stages)(torch.empty(1, 3, 64, 64)).shape[1] for n_stages in (1, 2, 3, 4)]
    assert sum(weight.numel() for weight in model.parameters()) == RESNETS[name]
    assert tuple(len(stage) for stage in list(model)[4:]) == oracle.RESNETS[name][0]
    assert [n_channels(name, n_stages) for n_stages in (1, 2, 3, 4)] == found
    assert found == ([64, 128, 256, 512] if name in ("resnet18", "resnet34") else [256, 512, 1024, 2048])


# Vision Transformer

STORED_GRID, OTHER_GRID = (70, 70), (42, 98)  # pixels: 5x5 patches, and 3x7


def vit(tensors, **options):
    return loaded(tensors, VisionTransformer.sized, tensors, **options)


@pytest.mark.parametrize(
    ("swiglu", "side", "normalised"),
    [(False, STORED_GRID, True), (True, STORED_GRID, False), (False, OTHER_GRID, False), (True, OTHER_GRID, True)],
)
def test_the_transformer_equals_the_slow_version(swiglu, side, normalised):
    tensors, x = oracle.vit_checkpoint(Draw(), swiglu=swiglu), images(*side)
    tokens = vit(tensors).tokens(x, normalised=normalised)
    assert tokens.patches.shape == (2, side[0] // 14, side[1] // 14, 128)
    slow = oracle.vit_tokens(tensors, "", x, final_norm=normalised)
    assert_same(torch.cat([tokens.cls[:, None], tokens.patches.flatten(1, 2)], 1), slow)


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
        ("pos_embed", (1, 1, 128)),
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


@pytest.mark.parametrize("build", [vgg16_features, lambda: resnet("resnet18"), lambda: VisionTransformer.sized({})])
def test_a_backbone_is_in_evaluation_mode_and_keeps_no_gradients(build):
    with torch.device("meta"):
        model = build()
    assert not any(module.training for module in model.modules())
    assert not any(weight.requires_grad for weight in model.parameters())
