"""EfficientNet-Lite: block by block the published network, its parts as a descriptor, and VPRTempo that reads them."""

import itertools
from functools import cache

import numpy as np
import pytest
import torch
from backbones_oracle import Draw, prefixed
from described_images import composed, distance, drawn_images, encoded
from efficientnet_lite_pytorch import EfficientNet as Published
from published_networks import saved, unit
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode

from vprbench.api.arithmetic import counting_operations
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.compiled_blocks import compile_blocks
from vprbench.methods.parts.backbones.efficientnet_lite import EfficientNetLite, count_multiply_adds
from vprbench.plugins import registry
from vprbench.plugins.conformance import check_method
from vprbench.plugins.rules import RULES, Journey

#: Of each block of lite0: input and output channels, kernel, stride, expansion (Tan and Le 2019, table 1).
LITE0 = [
    (32, 16, 3, 1, 1),
    *((16, 24, 3, 2, 6), (24, 24, 3, 1, 6)),
    *((24, 40, 5, 2, 6), (40, 40, 5, 1, 6)),
    *((40, 80, 3, 2, 6), (80, 80, 3, 1, 6), (80, 80, 3, 1, 6)),
    *((80, 112, 5, 1, 6), (112, 112, 5, 1, 6), (112, 112, 5, 1, 6)),
    *((112, 192, 5, 2, 6), (192, 192, 5, 1, 6), (192, 192, 5, 1, 6), (192, 192, 5, 1, 6)),
    (192, 320, 3, 1, 6),
]
ALL = range(len(LITE0))
PUBLISHED = {"lite0": 224, "lite1": 240, "lite2": 260}  # pixels a side, for which alone the other program pads
SMALL = {"blocks": [1, 2], "grid": [[4, 5], [3, 4]], "height": 32, "width": 40}


@cache
def config(*overrides):
    return composed(*overrides)


def made(variant="lite0", method="efficientnet", **arguments):
    return registry.make_method({**config(f"method={method}", f"method.variant={variant}"), **arguments})


def blocks_of(variant, path=None):
    """Return the network up to its last block, as the method loads it."""
    count = {"lite0": 16, "lite1": 21, "lite2": 21}[variant]
    method = made(variant, blocks=[*range(count)], grid=[None] * count)
    return method.load(path or method.files()[0]).model


def seen(*images):
    """Return what the published weights want of images: (level - 127) / 128, in float64."""
    return (torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).double() - 127) / 128


def furthest(found, wanted):
    """Return the largest difference between outputs of as many blocks."""
    return max(float((one - other).abs().max()) for one, other in zip(found, wanted, strict=True))


@cache
def published_outputs(variant):
    """Return an image, and what every block of the published package makes of it in float64."""
    (image,) = drawn_images((PUBLISHED[variant],) * 2)
    network = Published.from_pretrained(f"efficientnet-{variant}", weights_path=str(made(variant).files()[0]))
    outputs = []
    for block in network.eval().double()._blocks:
        block.register_forward_hook(lambda *called: outputs.append(called[2]))
    with torch.inference_mode():
        network.extract_features(seen(image))
    return image, outputs


@pytest.mark.parametrize("variant", ["lite0", "lite1", pytest.param("lite2", marks=pytest.mark.extended)])
def test_every_block_gives_what_that_of_the_published_package_gives(variant):
    image, wanted = published_outputs(variant)
    with torch.inference_mode():
        found = blocks_of(variant).double()(seen(image), range(len(wanted)))  # rounded when folded, not when summed
    assert furthest(found, wanted) < 1e-4


def cells(maps, rows, columns):
    """Return the means of maps (channels, h, w) over cells that begin at whole parts and end at what they touch."""
    height, width = maps.shape[1:]
    found = np.zeros((len(maps), rows, columns))
    for row, column in np.ndindex(rows, columns):
        down = slice(row * height // rows, -(-(row + 1) * height // rows))
        across = slice(column * width // columns, -(-(column + 1) * width // columns))
        found[:, row, column] = maps[:, down, across].mean((1, 2))
    return found


def test_a_descriptor_is_blocks_of_the_published_package_each_of_unit_length_side_by_side():
    image, outputs = published_outputs("lite0")
    maps = [outputs[block][0].numpy() for block in (4, 10, 12)]
    parts = [unit(part.flatten()) for part in (maps[0], cells(maps[1], 3, 5), cells(maps[2], 2, 4))]
    codes = encoded(made(blocks=[4, 10, 12], grid=[None, [3, 5], [2, 4]], height=224, width=224), image)
    assert distance(codes, unit(np.concatenate(parts))) < 1e-6
    norms = [np.linalg.norm(part) for part in np.split(codes[0], np.cumsum([len(part) for part in parts])[:-1])]
    assert norms == pytest.approx([3**-0.5] * 3, abs=1e-6)


def drawn_file():
    """Return random values under the names of a published file of lite0: batch norms of small variance, and a head."""
    draw = Draw(1)

    def layer(name, norm, *shape):
        n_out, fan_in = shape[0], np.prod(shape[1:])
        return {
            f"{name}.weight": draw.normal(*shape, scale=0.1 / fan_in**0.5),
            **draw.norm(norm, n_out),
            f"{norm}.running_mean": draw.normal(n_out, scale=0.1),
            f"{norm}.running_var": 0.002 + 0.02 * torch.rand(n_out, generator=draw.generator),
            f"{norm}.num_batches_tracked": torch.tensor(7),
        }

    tensors = layer("_conv_stem", "_bn0", 32, 3, 3, 3) | layer("_conv_head", "_bn1", 1280, 320, 1, 1)
    for number, (n_in, n_out, kernel, _, expansion) in enumerate(LITE0):
        inner = n_in * expansion
        block = layer("_depthwise_conv", "_bn1", inner, 1, kernel, kernel)
        block |= layer("_project_conv", "_bn2", n_out, inner, 1, 1)
        block |= layer("_expand_conv", "_bn0", inner, n_in, 1, 1) if expansion > 1 else {}
        tensors |= prefixed(f"_blocks.{number}.", block)
    return tensors | draw.linear("_fc", 1280, 10)


def slowly(tensors, x):
    """Return the outputs of the blocks of lite0 in float64, a batch norm after each convolution, as in TensorFlow."""
    t = {name: tensor.double() for name, tensor in tensors.items()}

    def convolved(x, name, norm, stride=1, groups=1):
        weight, sides = t[f"{name}.weight"], x.shape[2:]
        both = [max(0, (-(-side // stride) - 1) * stride + weight.shape[2] - side) for side in sides]
        (top, bottom), (left, right) = ((n // 2, n - n // 2) for n in both)  # SAME: the odd one below and at the right
        x = functional.conv2d(functional.pad(x, (left, right, top, bottom)), weight, None, stride, groups=groups)
        parts = (t[f"{norm}.{part}"] for part in ("running_mean", "running_var", "weight", "bias"))
        return functional.batch_norm(x, *parts, eps=1e-3)

    outputs, x = [], convolved(x, "_conv_stem", "_bn0", stride=2).clamp(0, 6)
    for number, (n_in, n_out, _, stride, expansion) in enumerate(LITE0):
        way, own = x, f"_blocks.{number}."
        if expansion > 1:
            way = convolved(way, f"{own}_expand_conv", f"{own}_bn0").clamp(0, 6)
        way = convolved(way, f"{own}_depthwise_conv", f"{own}_bn1", stride, way.shape[1]).clamp(0, 6)
        way = convolved(way, f"{own}_project_conv", f"{own}_bn2")
        x = way + x if stride == 1 and n_in == n_out else way
        outputs.append(x)
    return outputs


@pytest.mark.parametrize("size", [(64, 64), (97, 131), (33, 70)])
def test_folded_batch_norms_give_what_batch_norms_give(size, folder):
    tensors, images = drawn_file(), drawn_images(size, size)
    network = blocks_of("lite0", saved(folder / "drawn.pth", tensors)).double()
    with torch.inference_mode():
        found, wanted = network(seen(*images), ALL), slowly(tensors, seen(*images))
    assert [maps.shape for maps in found] == [maps.shape for maps in wanted]
    assert furthest(found, wanted) < 1e-5
    assert float(wanted[-1].std()) > 0.1


@pytest.mark.parametrize("size", [(64, 96), (35, 67), (1, 1)])
def test_compiled_blocks_give_what_the_plain_network_gives(size):
    network = blocks_of("lite0")
    images = seen(*drawn_images(size, size)).float().contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        for blocks in (ALL, [0, 4]):
            compiled = compile_blocks(network, images, blocks)
            if compiled is None:
                assert size == (1, 1) or not torch.backends.mkldnn.is_available()  # no graph of maps of one pixel
                continue
            found = compiled(images)
            assert [maps.shape for maps in found] == [maps.shape for maps in network(images, blocks)]
            assert furthest(found, network(images, blocks)) < 1e-4


@pytest.mark.parametrize(
    ("variant", "blocks", "grid", "size", "lengths"),
    [
        ("lite0", [4, 10, 12], [None, None, [2, 4]], (128, 224), [40 * 16 * 28, 112 * 8 * 14, 192 * 2 * 4]),
        ("lite0", [0, 2, 7], [None, None, None], (97, 131), [16 * 49 * 66, 24 * 25 * 33, 80 * 7 * 9]),
        ("lite0", [0, 15], [[33, 1], [1, 2]], (65, 64), [16 * 33, 320 * 2]),
        ("lite0", [15], [None], (1, 2), [320]),
        # One block more in each repeated stage, and a tenth more channels, in whole eights: 24 to 24, 40 to 48.
        ("lite1", [3, 6], [None, [2, 4]], (128, 224), [24 * 32 * 56, 40 * 2 * 4]),
        ("lite2", [3, 6], [None, [2, 4]], (128, 224), [24 * 32 * 56, 48 * 2 * 4]),
    ],
)
def test_every_block_has_as_many_numbers_as_its_channels_have_positions_or_cells(variant, blocks, grid, size, lengths):
    method = made(variant, blocks=blocks, grid=grid, height=size[0], width=size[1])
    assert method.block_lengths() == lengths
    codes = encoded(method, *drawn_images((40, 60), (50, 50)))
    assert codes.shape == (2, sum(lengths))
    assert np.linalg.norm(codes, axis=1) == pytest.approx([1, 1], abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        *(({"blocks": blocks}, r"method\.blocks=") for blocks in ([10, 4], [4, 4], [], [-1, 4], [4, 16])),
        ({"blocks": [4, 21], "variant": "lite2"}, r"method\.blocks="),
        *(({"grid": grid}, r"method\.grid=") for grid in ([None], [[17, 28], None], [None, [8, 15]], [None, [0, 3]])),
    ],
    ids=str,
)
def test_blocks_and_cells_that_the_network_lacks_are_refused_by_name(arguments, named):
    refused = made(**{"blocks": [4, 10], "grid": [None, None], **arguments})
    images = Images.from_arrays(drawn_images((48, 64)))
    for ask in (refused.files, lambda: refused.encode(images)):
        with pytest.raises(BadInput, match=named):
            ask()


@pytest.mark.parametrize(
    ("variant", "last", "size"), [("lite0", 15, (64, 96)), ("lite0", 4, (97, 131)), ("lite2", 20, (33, 64))]
)
def test_multiply_adds_are_those_that_pytorch_counts_and_are_told_of_every_image(variant, last, size):
    with torch.device("meta"), FlopCounterMode(display=False) as counter:
        EfficientNetLite(variant, last)(torch.empty(1, 3, *size), [last])
    assert 2 * count_multiply_adds(variant, last, *size) == counter.get_total_flops()
    method = made(variant, blocks=[last], grid=[[1, 1]], height=size[0], width=size[1])
    with counting_operations() as told:
        encoded(method, *drawn_images((40, 60), (40, 60), (40, 60)))
    assert sum(each.multiply_adds for each in told) == 3 * counter.get_total_flops() / 2


# The contract, where a mean is taken off


@pytest.mark.parametrize(
    ("method", "adapt"),
    [
        *itertools.product(["hog", "vprtempo_oriented"], ["references", "running", "traverse"]),
        ("efficientnet", "running"),
    ],
)
def test_a_method_keeps_every_rule_under_a_mean_that_is_taken_off(method, adapt):
    small = {"efficientnet": SMALL, "hog": {"height": 32, "width": 40}}.get(method, {})
    results = [*check_method({**config(f"method={method}"), **small, "adapt": adapt})]
    assert [str(result) for result in results if result.state == "broken"] == []
    excepted = [result.rule for result in results if result.state == "excepted"]
    assert len(excepted) == bool(small) + (adapt != "references")  # stored networks; batches
    assert {result.rule for result in results} >= {*RULES}


# VPRTempo

WORLD = Journey.draw(0)
QUERIES = Images.from_arrays(WORLD.queries)


def tempo(**arguments):
    return made(method="vprtempo_efficientnet", **SMALL, max_module=10, **arguments)


def amplitudes(values):
    """Return each row's values as amplitudes: 0.5 is its mean, 0 and 1 are 3 standard deviations away, or more."""
    rows = values.astype(np.float64)
    return np.array([np.minimum(np.maximum(0.5 + (row - row.mean()) / (6 * row.std()), 0), 1) for row in rows])


def test_input_spikes_are_each_block_of_the_descriptor_scaled_on_its_own():
    codes = made(**SMALL).encode(QUERIES)
    wanted = [amplitudes(part) for part in np.split(codes, [24 * 4 * 5], axis=1)]
    found = tempo().encode(QUERIES)
    assert found == pytest.approx(np.concatenate(wanted, axis=1), abs=1e-5)
    assert (found.dtype, found.shape[1]) == (np.float32, 24 * 4 * 5 + 24 * 3 * 4)


def test_spikes_without_a_mean_are_scaled_anew_and_are_all_one_half_where_they_are_the_mean():
    spikes = tempo().encode(QUERIES)
    mean = spikes[1:].mean(0)
    found = tempo().centre(spikes, mean)
    assert found == pytest.approx(amplitudes(spikes - mean), abs=1e-5)
    assert np.array_equal(tempo().centre(spikes[:, None], mean)[:, 0], found)
    assert np.array_equal(tempo().centre(spikes[:1], spikes[0]), np.full_like(spikes[:1], 0.5))
