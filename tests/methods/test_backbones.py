"""The backbones against float64 versions written straight from the key names, and the published sizes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.nn import functional

from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.resnet import NAMES, n_channels, resnet
from vprbench.methods.parts.backbones.vgg import vgg16_features
from vprbench.methods.parts.backbones.vit import SIZES, Sizes, VisionTransformer, first_blocks

WORDS = {"0": "conv1", "1": "bn1", "4": "layer1", "5": "layer2", "6": "layer3", "7": "layer4"}
NORM = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")


def on_meta(build, *arguments, **options):
    with torch.device("meta"):
        return build(*arguments, **options)


def loaded(build, *arguments, seed=0, **options):
    """A backbone with random weights, and those weights."""
    model = on_meta(build, *arguments, **options)
    state = random_state(model.state_dict(), seed)
    model.load_state_dict(state, strict=True, assign=True)
    return model, state


def random_state(tensors, seed=0):
    """Weights under which activations stay near 1, and the epsilons of batch and layer norms are felt."""
    generator = torch.Generator().manual_seed(seed)

    def normal(shape, deviation, mean=0.0):
        return torch.empty(shape).normal_(mean, deviation, generator=generator)

    state = {}
    for key, tensor in tensors.items():
        shape, last = tensor.shape, key.rsplit(".", 1)[-1]
        if last == "num_batches_tracked":
            state[key] = torch.tensor(7)
        elif last == "running_var":
            state[key] = torch.empty(shape).uniform_(0.5e-3, 2e-3, generator=generator)
        elif last == "running_mean":
            state[key] = normal(shape, 0.01)
        elif last in ("cls_token", "pos_embed", "mask_token"):
            state[key] = normal(shape, 0.02)
        elif "patch_embed" in key:
            state[key] = normal(shape, 0.02 / math.sqrt(3 * 14 * 14))
        elif last == "bias":
            state[key] = normal(shape, 0.1)
        elif last == "gamma" or len(shape) == 1:
            state[key] = normal(shape, 0.1, mean=0.3 if "bn3" in key else 0.8)
        else:
            # Before a batch norm the variance is some 0.001, and so is the running variance.
            gain = 2e-3 if key.removesuffix("weight") + "bias" not in tensors else 2 if len(shape) == 4 else 1
            state[key] = normal(shape, math.sqrt(gain / tensor[0].numel()))
    return state


def images(height, width, n=2, seed=1):
    return torch.randn(n, 3, height, width, generator=torch.Generator().manual_seed(seed))


def assert_same(fast, slow, tolerance=2e-5):
    """Equal to within a part of what the slow values typically are, which has to be near 1."""
    spread = slow.std().item()
    assert 0.05 < spread < 20
    np.testing.assert_allclose(fast.numpy(), slow.numpy(), rtol=0, atol=tolerance * spread)


def assert_different(one, other):
    assert (one - other).abs().max() > 1e-3 * other.std()


# VGG16


def slow_vgg(state, x, n_layers):
    x = x.double()
    for number in range(n_layers):
        if number in (4, 9, 16, 23, 30):
            x = functional.max_pool2d(x, 2)
        elif number in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28):
            weight, bias = state[f"{number}.weight"].double(), state[f"{number}.bias"].double()
            x = functional.conv2d(x, weight, bias, padding=1)
        else:
            x = functional.relu(x)
    return x


@pytest.fixture(scope="module")
def vgg_state():
    return random_state(on_meta(vgg16_features).state_dict())


@pytest.mark.parametrize(("n_layers", "shape"), [(29, (1, 512, 4, 6)), (31, (1, 512, 2, 3))])
def test_vgg16_equals_the_slow_version_at_both_cuts(vgg_state, n_layers, shape):
    model = on_meta(vgg16_features, n_layers)
    model.load_state_dict(vgg_state, strict=True, assign=True)
    x = images(64, 96, n=1)
    out = model(x)
    assert out.shape == shape
    assert_same(out, slow_vgg(vgg_state, x, n_layers))


def test_vgg16_of_29_layers_ends_before_the_last_relu(vgg_state):
    model = on_meta(vgg16_features, 29)
    model.load_state_dict(vgg_state, assign=True)
    assert (model(images(32, 32, n=1)) < 0).any()


def test_vgg16_has_the_published_keys_and_number_of_weights():
    state = on_meta(vgg16_features).state_dict()
    channels = dict(zip((0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28), outputs(), strict=True))
    assert list(state) == [f"{number}.{kind}" for number in channels for kind in ("weight", "bias")]
    assert [state[f"{number}.weight"].shape[0] for number in channels] == outputs()
    assert sum(tensor.numel() for tensor in state.values()) == 14_714_688


def outputs():
    return [64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]


@pytest.mark.parametrize("n_layers", [0, 32])
def test_vgg16_has_no_other_number_of_layers_than_1_to_31(n_layers):
    with pytest.raises(BadInput, match=f"n_layers={n_layers}: VGG16 has layers 1 to 31"):
        vgg16_features(n_layers)


# ResNet


def slow_resnet(state, x, n_groups=1):
    """Written with numbered keys; a bottleneck is a block with a conv3, and its stride sits on conv2."""

    def conv(key, x, stride=1, padding=0, groups=1):
        return functional.conv2d(x, state[f"{key}.weight"].double(), None, stride, padding, 1, groups)

    def norm(key, x):
        weight, bias, mean, variance = (state[f"{key}.{kind}"].double()[:, None, None] for kind in NORM[:4])
        return (x - mean) / torch.sqrt(variance + 1e-5) * weight + bias

    x = functional.relu(norm("1", conv("0", x.double(), stride=2, padding=3)))
    x = functional.max_pool2d(x, 3, 2, padding=1)
    for stage in "4567":
        for number in range(100):
            key = f"{stage}.{number}"
            if f"{key}.conv1.weight" not in state:
                break
            stride = 2 if stage > "4" and number == 0 else 1
            if f"{key}.conv3.weight" in state:
                out = functional.relu(norm(f"{key}.bn1", conv(f"{key}.conv1", x)))
                out = functional.relu(norm(f"{key}.bn2", conv(f"{key}.conv2", out, stride, 1, n_groups)))
                out = norm(f"{key}.bn3", conv(f"{key}.conv3", out))
            else:
                out = functional.relu(norm(f"{key}.bn1", conv(f"{key}.conv1", x, stride, 1)))
                out = norm(f"{key}.bn2", conv(f"{key}.conv2", out, 1, 1))
            if f"{key}.downsample.0.weight" in state:
                x = norm(f"{key}.downsample.1", conv(f"{key}.downsample.0", x, stride))
            x = functional.relu(x + out)
    return x


@pytest.mark.parametrize(
    ("name", "n_stages", "n_groups"),
    [("resnet18", 4, 1), ("resnet50", 4, 1), ("resnet50", 3, 1), ("resnext101_32x8d", 4, 32)],
)
def test_resnet_equals_the_slow_version(name, n_stages, n_groups):
    model, state = loaded(resnet, name, n_stages)
    x = images(64, 96, n=1)
    out = model(x)
    assert out.shape == (1, n_channels(name, n_stages), 64 >> (n_stages + 1), 96 >> (n_stages + 1))
    assert_same(out, slow_resnet(state, x, n_groups), tolerance=1e-4)


def test_resnet_halves_odd_sides_as_the_slow_version_does():
    model, state = loaded(resnet, "resnet18", 2)
    x = images(75, 50, n=1)
    assert model(x).shape == (1, 128, 10, 7)
    assert_same(model(x), slow_resnet(state, x))


def test_both_forms_of_names_are_the_same_network():
    numbers, state = loaded(resnet, "resnet18", 3)
    words = on_meta(resnet, "resnet18", 3, names="words")
    renamed = {".".join([WORDS[key.split(".")[0]], *key.split(".")[1:]]): tensor for key, tensor in state.items()}
    words.load_state_dict(renamed, strict=True, assign=True)
    assert torch.equal(words(images(64, 96)), numbers(images(64, 96)))


def test_the_children_are_numbered_from_0_to_7_or_called_by_words():
    assert list(dict(on_meta(resnet, "resnet18").named_children())) == list("01234567")
    words = dict(on_meta(resnet, "resnet18", 3, names="words").named_children())
    assert list(words) == ["conv1", "bn1", "relu", "maxpool", "layer1", "layer2", "layer3"]


@pytest.mark.parametrize(
    ("name", "n_blocks", "convolutions"),
    [
        ("resnet18", (2, 2, 2, 2), 2),
        ("resnet34", (3, 4, 6, 3), 2),
        ("resnet50", (3, 4, 6, 3), 3),
        ("resnet101", (3, 4, 23, 3), 3),
        ("resnet152", (3, 8, 36, 3), 3),
        ("resnext101_32x8d", (3, 4, 23, 3), 3),
    ],
)
def test_resnet_has_the_published_keys(name, n_blocks, convolutions):
    wanted = {"0.weight", *(f"1.{kind}" for kind in NORM)}
    for stage, n in enumerate(n_blocks):
        for block in range(n):
            key = f"{4 + stage}.{block}"
            for number in range(1, convolutions + 1):
                wanted |= {f"{key}.conv{number}.weight", *(f"{key}.bn{number}.{kind}" for kind in NORM)}
            if block == 0 and (stage > 0 or convolutions == 3):
                wanted |= {f"{key}.downsample.0.weight", *(f"{key}.downsample.1.{kind}" for kind in NORM)}
    assert set(on_meta(resnet, name).state_dict()) == wanted


@pytest.mark.parametrize(
    ("name", "n_weights"),
    [
        ("resnet18", 11_176_512),
        ("resnet34", 21_284_672),
        ("resnet50", 23_508_032),
        ("resnet101", 42_500_160),
        ("resnet152", 58_143_808),
        ("resnext101_32x8d", 86_742_336),
    ],
)
def test_resnet_has_the_published_number_of_weights(name, n_weights):
    assert sum(weight.numel() for weight in on_meta(resnet, name).parameters()) == n_weights


@pytest.mark.parametrize(
    ("name", "key", "shape"),
    [
        ("resnet152", "0.weight", (64, 3, 7, 7)),
        ("resnet152", "4.0.conv1.weight", (64, 64, 1, 1)),
        ("resnet152", "4.0.conv2.weight", (64, 64, 3, 3)),
        ("resnet152", "4.0.conv3.weight", (256, 64, 1, 1)),
        ("resnet152", "4.0.downsample.0.weight", (256, 64, 1, 1)),
        ("resnet152", "6.35.conv1.weight", (256, 1024, 1, 1)),
        ("resnet152", "7.0.downsample.0.weight", (2048, 1024, 1, 1)),
        ("resnet18", "7.0.conv1.weight", (512, 256, 3, 3)),
        ("resnext101_32x8d", "4.0.conv2.weight", (256, 8, 3, 3)),
        ("resnext101_32x8d", "7.2.conv2.weight", (2048, 64, 3, 3)),
    ],
)
def test_a_resnet_weight_has_the_published_shape(name, key, shape):
    assert on_meta(resnet, name).state_dict()[key].shape == shape


@pytest.mark.parametrize("name", NAMES)
def test_a_resnet_has_as_many_channels_after_each_stage_as_it_says(name):
    x = torch.empty(1, 3, 64, 64, device="meta")
    found = [on_meta(resnet, name, n_stages)(x).shape[1] for n_stages in (1, 2, 3, 4)]
    assert [n_channels(name, n_stages) for n_stages in (1, 2, 3, 4)] == found
    assert found == ([64, 128, 256, 512] if name in ("resnet18", "resnet34") else [256, 512, 1024, 2048])


def test_an_unknown_resnet_is_named_with_those_there_are():
    with pytest.raises(BadInput, match=r"there is no backbone resnet51: give one of resnet18, .*resnext101_32x8d"):
        resnet("resnet51")


@pytest.mark.parametrize("n_stages", [0, 5])
def test_a_resnet_has_no_other_number_of_stages_than_1_to_4(n_stages):
    for function in (resnet, n_channels):
        with pytest.raises(BadInput, match=f"n_stages={n_stages}: resnet18 has stages 1 to 4"):
            function("resnet18", n_stages)


# Vision Transformer


def cubic(t):
    """The weight of a sample at distance t, Keys 1981 with a = -0.75."""
    t = abs(t)
    if t <= 1:
        return 1.25 * t**3 - 2.25 * t**2 + 1
    return -0.75 * t**3 + 3.75 * t**2 - 6 * t + 3 if t < 2 else 0.0


def bicubic_matrix(n_from, n_to, offset):
    """(n_to, n_from): samples beyond an end repeat the last one; `offset` enlarges the scale and not the number."""
    matrix = np.zeros((n_to, n_from))
    for i in range(n_to):
        at = (i + 0.5) * n_from / (n_to + offset) - 0.5
        for j in range(math.floor(at) - 1, math.floor(at) + 3):
            matrix[i, min(max(j, 0), n_from - 1)] += cubic(at - j)
    return torch.from_numpy(matrix)


def slow_positions(state, rows, columns, offset):
    embedding = state["pos_embed"].double()[0]
    side = math.isqrt(len(embedding) - 1)
    if rows == columns == side:
        return embedding
    down, across = bicubic_matrix(side, rows, offset), bicubic_matrix(side, columns, offset)
    stretched = torch.einsum("yi,xj,ijd->yxd", down, across, embedding[1:].reshape(side, side, -1))
    return torch.cat([embedding[:1], stretched.flatten(0, 1)])


def erf_gelu(x):
    return x * (1 + torch.erf(x / math.sqrt(2))) / 2


def tanh_gelu(x):
    return x * (1 + torch.tanh(math.sqrt(2 / math.pi) * (x + 0.044715 * x**3))) / 2


def slow_vit(state, image, n_blocks, norm=True, values=False, offset=0.1, gelu=erf_gelu):
    """All tokens of one image (1 + rows * columns, dim), or the last block's value facet (rows * columns, dim)."""
    state = {key: tensor.double() for key, tensor in state.items()}
    patch = state["patch_embed.proj.weight"].shape[-1]
    rows, columns = image.shape[1] // patch, image.shape[2] // patch
    dim = state["cls_token"].shape[-1]

    def linear(key, x):
        return x @ state[f"{key}.weight"].T + state[f"{key}.bias"]

    def layer_norm(key, x):
        x = x - x.mean(1, keepdim=True)
        return x / torch.sqrt((x * x).mean(1, keepdim=True) + 1e-6) * state[f"{key}.weight"] + state[f"{key}.bias"]

    patches = []
    for row in range(rows):
        for column in range(columns):
            part = image.double()[:, row * patch : (row + 1) * patch, column * patch : (column + 1) * patch]
            patches.append(
                state["patch_embed.proj.weight"].flatten(1) @ part.flatten() + state["patch_embed.proj.bias"]
            )
    x = torch.stack([state["cls_token"][0, 0], *patches]) + slow_positions(state, rows, columns, offset)
    for number in range(n_blocks):
        key = f"blocks.{number}"
        qkv = linear(f"{key}.attn.qkv", layer_norm(f"{key}.norm1", x))
        if values and number == n_blocks - 1:
            return qkv[1:, 2 * dim :]
        heads = []
        for first in range(0, dim, 64):
            q, k, v = (qkv[:, part * dim + first : part * dim + first + 64] for part in range(3))
            heads.append(torch.softmax(q @ k.T / 8, 1) @ v)
        x = x + state[f"{key}.ls1.gamma"] * linear(f"{key}.attn.proj", torch.cat(heads, 1))
        y = layer_norm(f"{key}.norm2", x)
        if f"{key}.mlp.w12.weight" in state:
            y = linear(f"{key}.mlp.w12", y)
            half = y.shape[1] // 2
            y = linear(f"{key}.mlp.w3", y[:, :half] / (1 + torch.exp(-y[:, :half])) * y[:, half:])
        else:
            y = linear(f"{key}.mlp.fc2", gelu(linear(f"{key}.mlp.fc1", y)))
        x = x + state[f"{key}.ls2.gamma"] * y
    return layer_norm("norm", x) if norm else x


def vit_keys(sizes, norm=True, mask_token=False):
    """The tensors of a published file (key -> empty tensor), written from the key table."""
    dim, hidden = sizes.dim, sizes.n_hidden
    shapes = {
        "cls_token": (1, 1, dim),
        "pos_embed": (1, sizes.grid**2 + 1, dim),
        "patch_embed.proj.weight": (dim, 3, sizes.patch, sizes.patch),
        "patch_embed.proj.bias": (dim,),
        **({"mask_token": (1, dim)} if mask_token else {}),
        **({"norm.weight": (dim,), "norm.bias": (dim,)} if norm else {}),
    }
    linears = {"attn.qkv": (3 * dim, dim), "attn.proj": (dim, dim)}
    if sizes.swiglu:
        linears |= {"mlp.w12": (2 * hidden, dim), "mlp.w3": (dim, hidden)}
    else:
        linears |= {"mlp.fc1": (hidden, dim), "mlp.fc2": (dim, hidden)}
    for number in range(sizes.n_blocks):
        for name, shape in linears.items():
            shapes |= {f"blocks.{number}.{name}.weight": shape, f"blocks.{number}.{name}.bias": shape[:1]}
        for name in ("norm1.weight", "norm1.bias", "norm2.weight", "norm2.bias", "ls1.gamma", "ls2.gamma"):
            shapes[f"blocks.{number}.{name}"] = (dim,)
    return {key: torch.empty(shape, device="meta") for key, shape in shapes.items()}


SMALL = {
    "mlp": Sizes(dim=128, n_blocks=2, n_hidden=512, grid=5),
    "swiglu": Sizes(dim=128, n_blocks=2, n_hidden=344, swiglu=True, grid=5),
}
STORED_GRID, OTHER_GRID = (70, 70), (42, 98)  # pixels: 5x5 patches, and 3x7


def vit(kind="mlp", **options):
    """A small transformer built and loaded from a checkpoint, and that checkpoint."""
    tensors = random_state(vit_keys(SMALL[kind], **options))
    model = on_meta(VisionTransformer.for_checkpoint, tensors)
    model.load_state_dict(tensors, strict=True, assign=True)
    return model, tensors


def assert_same_tokens(tokens, x, slow):
    height, width = x.shape[2:]
    assert tokens.patches.shape == (len(x), height // 14, width // 14, 128)
    assert_same(torch.cat([tokens.cls[:, None], tokens.patches.flatten(1, 2)], 1), torch.stack([*map(slow, x)]))


@pytest.mark.parametrize("normalised", [True, False])
@pytest.mark.parametrize("side", [STORED_GRID, OTHER_GRID])
@pytest.mark.parametrize("kind", SMALL)
def test_the_transformer_equals_the_slow_version(kind, side, normalised):
    model, state = vit(kind)
    x = images(*side)
    tokens = model.tokens(x, normalised=normalised)
    assert_same_tokens(tokens, x, lambda image: slow_vit(state, image, 2, norm=normalised))


@pytest.mark.parametrize("n_blocks", [1, 2])
def test_the_value_facet_is_the_last_third_of_qkv_of_the_patches(n_blocks):
    model, state = vit("swiglu")
    x = images(*OTHER_GRID)
    values = model.values(x, n_blocks - 1)
    assert values.shape == (2, 3, 7, 128)
    slow = torch.stack([slow_vit(state, image, n_blocks, values=True) for image in x])
    assert_same(values.flatten(1, 2), slow)


def test_the_value_facet_of_the_last_built_block_is_the_default():
    model, _ = vit()
    assert torch.equal(model.values(images(*STORED_GRID)), model.values(images(*STORED_GRID), 1))


def test_the_value_facet_needs_nothing_that_comes_after_it():
    model, state = vit()
    x = images(*STORED_GRID)
    before = model.values(x, 1)
    later = [key for key in state if key.startswith(("norm.", "blocks.1.")) and "norm1" not in key and "qkv" not in key]
    for key in later:
        model.get_parameter(key).fill_(math.nan)
    assert len(later) == 12
    assert torch.equal(model.values(x, 1), before)


def test_the_first_blocks_alone_are_built_and_loaded():
    whole, tensors = vit()
    first = on_meta(VisionTransformer.for_checkpoint, tensors, n_blocks=1)
    first.load_state_dict(first_blocks(tensors, 1), strict=True, assign=True)
    x = images(*OTHER_GRID)
    assert len(first.blocks) == 1
    assert torch.equal(first.values(x), whole.values(x, 0))
    assert_same_tokens(first.tokens(x, normalised=False), x, lambda image: slow_vit(tensors, image, 1, norm=False))


def test_the_tenth_block_is_not_among_the_first_two():
    assert set(first_blocks({"blocks.1.a": 0, "blocks.2.a": 0, "blocks.10.a": 0, "norm.a": 0}, 2)) == {
        "blocks.1.a",
        "norm.a",
    }


def test_the_comparison_sees_positions_that_are_stretched_to_a_size_without_the_offset():
    model, state = vit()
    x = images(*OTHER_GRID, n=1)
    wrong = slow_vit(state, x[0], 2, offset=0.0)
    assert_different(model.tokens(x, normalised=True).patches.flatten(1, 2)[0], wrong[1:])


def test_the_slow_positions_without_the_offset_are_those_of_a_size():
    state = random_state(vit_keys(SMALL["mlp"]))
    by_size = functional.interpolate(
        state["pos_embed"][:, 1:].reshape(1, 5, 5, 128).permute(0, 3, 1, 2), size=(3, 7), mode="bicubic"
    )
    slow = slow_positions(state, 3, 7, offset=0.0)[1:]
    np.testing.assert_allclose(by_size.flatten(2)[0].T.numpy(), slow.numpy(), atol=1e-7)


def test_the_comparison_sees_a_gelu_by_tanh():
    model, state = vit()
    x = images(*STORED_GRID, n=1)
    wrong = slow_vit(state, x[0], 2, gelu=tanh_gelu)
    fast = model.tokens(x, normalised=True).patches.flatten(1, 2)[0]
    assert (fast - wrong[1:]).abs().max() > 5 * 2e-5 * wrong.std()


def test_as_many_patches_in_another_grid_are_stretched():
    tensors = random_state(vit_keys(Sizes(dim=64, n_blocks=1, n_hidden=256, grid=4)))
    model = on_meta(VisionTransformer.for_checkpoint, tensors)
    model.load_state_dict(tensors, strict=True, assign=True)
    x = images(2 * 14, 8 * 14, n=1)
    assert_same(model.tokens(x, normalised=True).patches.flatten(1, 2)[0], slow_vit(tensors, x[0], 1)[1:])


@pytest.mark.parametrize("grid", [1, 16, 23, 27, 36, 38, 60])
def test_every_grid_gets_a_position_for_each_of_its_patches(grid):
    model = on_meta(VisionTransformer, Sizes(dim=64, n_blocks=1, n_hidden=64))
    x = torch.empty(1, 3, grid * 14, 2 * grid * 14, device="meta")
    assert model.tokens(x, normalised=True).patches.shape == (1, grid, 2 * grid, 64)


@pytest.mark.parametrize(("norm", "mask_token"), [(True, True), (True, False), (False, True), (False, False)])
@pytest.mark.parametrize("kind", SMALL)
def test_a_checkpoint_loads_strictly_with_or_without_final_norm_and_mask_token(kind, norm, mask_token):
    model, tensors = vit(kind, norm=norm, mask_token=mask_token)
    assert set(model.state_dict()) == set(tensors)
    assert model.sizes == SMALL[kind]


def test_the_mask_token_changes_nothing():
    x = images(*STORED_GRID)
    model, tensors = vit(mask_token=True)
    without, _ = vit()
    without.load_state_dict({key: tensor for key, tensor in tensors.items() if key != "mask_token"})
    assert torch.equal(without.tokens(x, normalised=True).cls, model.tokens(x, normalised=True).cls)


def test_a_normalised_token_is_not_to_be_had_without_the_final_norm():
    model, _ = vit(norm=False)
    with pytest.raises(BadInput, match=r"the checkpoint holds no norm\.weight"):
        model.tokens(images(*STORED_GRID), normalised=True)


@pytest.mark.parametrize("name", SIZES)
def test_a_published_size_is_read_off_its_checkpoint(name):
    tensors = vit_keys(SIZES[name], mask_token=True)
    model = on_meta(VisionTransformer.for_checkpoint, tensors)
    assert model.sizes == SIZES[name]
    found = {key: tensor.shape for key, tensor in model.state_dict().items()}
    assert found == {key: tensor.shape for key, tensor in tensors.items()}


def test_vit_b_has_the_published_number_of_weights():
    model = on_meta(VisionTransformer, SIZES["vitb14"], mask_token=True)
    assert sum(weight.numel() for weight in model.parameters()) == 86_580_480


def test_vit_g_has_the_published_widths():
    state = on_meta(VisionTransformer, SIZES["vitg14"]).state_dict()
    assert state["blocks.39.mlp.w12.weight"].shape == (8192, 1536)
    assert state["blocks.39.mlp.w3.weight"].shape == (1536, 4096)


@pytest.mark.parametrize(
    ("height", "width", "message"),
    [
        (70, 64, "images of 64x70 pixels: .* multiples of 14, such as 70x70"),
        (480, 640, "images of 640x480 pixels: .* multiples of 14, such as 644x476"),
        (0, 70, "images of 70x0 pixels: .* multiples of 14, such as 70x14"),
    ],
)
def test_sides_that_are_no_multiples_of_the_patch_are_refused(height, width, message):
    model, _ = vit()
    for ask in (model.values, lambda x: model.tokens(x, normalised=False)):
        with pytest.raises(BadInput, match=message):
            ask(torch.zeros(1, 3, height, width))


@pytest.mark.parametrize(
    ("key", "shape", "message"),
    [
        (
            "patch_embed.proj.weight",
            None,
            r"\(33 tensors\) holds no patch_embed.proj.weight: wanted DINOv2's own names",
        ),
        ("blocks.0.mlp.fc1.weight", None, r"holds no blocks\.0\.mlp\.fc1\.weight"),
        ("pos_embed", (26, 128), r"pos_embed has the shape \(26, 128\): wanted 3 axes"),
        ("pos_embed", (1, 28, 128), "pos_embed is for 27 patches and a CLS token: wanted a square number"),
        ("pos_embed", (1, 1, 128), "pos_embed is for 0 patches"),
        ("patch_embed.proj.weight", (100, 3, 14, 14), "tokens have 100 dimensions: wanted a multiple of 64"),
        ("patch_embed.proj.weight", (128, 3, 0, 0), "wanted 4 axes, none of length 0"),
    ],
)
def test_tensors_of_something_else_are_refused(key, shape, message):
    tensors = vit_keys(SMALL["mlp"])
    del tensors[key]
    if shape is not None:
        tensors[key] = torch.empty(shape, device="meta")
    with pytest.raises(BadInput, match=message):
        VisionTransformer.for_checkpoint(tensors)


@pytest.mark.parametrize("n_blocks", [0, 3])
def test_more_blocks_than_the_checkpoint_has_are_refused(n_blocks):
    with pytest.raises(BadInput, match=f"n_blocks={n_blocks}: the checkpoint has blocks 1 to 2"):
        VisionTransformer.for_checkpoint(vit_keys(SMALL["mlp"]), n_blocks)


def test_one_block_of_a_huge_number_is_no_reason_to_build_as_many():
    tensors = vit_keys(SMALL["mlp"])
    tensors["blocks.999999999.ls1.gamma"] = torch.empty(128)
    assert on_meta(VisionTransformer.for_checkpoint, tensors).sizes.n_blocks == 3


# All


@pytest.mark.parametrize(
    "build",
    [vgg16_features, lambda: resnet("resnet18"), lambda: VisionTransformer(SMALL["mlp"])],
    ids=["vgg16", "resnet", "transformer"],
)
def test_a_backbone_is_in_evaluation_mode_and_keeps_no_gradients(build):
    model = on_meta(build)
    assert not any(module.training for module in model.modules())
    assert not any(weight.requires_grad for weight in model.parameters())


def test_a_batch_gives_what_its_single_images_give():
    for model, call in [
        (loaded(resnet, "resnet18", 2)[0], lambda model, x: model(x)),
        (vit()[0], lambda model, x: model.tokens(x, normalised=True).patches),
    ]:
        x = images(*STORED_GRID, n=3)
        single = torch.cat([call(model, x[i : i + 1]) for i in range(3)])
        torch.testing.assert_close(call(model, x), single, rtol=1e-5, atol=1e-5)
