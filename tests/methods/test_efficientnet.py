"""EfficientNet-Lite: block by block the published network, its parts as a descriptor, and VPRTempo that reads them."""

from functools import cache

import numpy as np
import pytest
import torch
from described_images import composed, distance, drawn_images, encoded
from efficientnet_lite_pytorch import EfficientNet as Published
from published_networks import unit

from vprbench.api.arithmetic import counting_operations
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.parts.backbones.compiled_blocks import compile_blocks
from vprbench.methods.parts.backbones.efficientnet_lite import EfficientNetLite, count_multiply_adds
from vprbench.plugins import registry
from vprbench.plugins.rules import Journey

N_BLOCKS = {"lite0": 16, "lite1": 21, "lite2": 21}
SMALL = {"blocks": [1, 2], "grid": [[4, 5], [3, 4]], "height": 32, "width": 40}


@cache
def config(*overrides):
    return composed(*overrides)


def made(variant="lite0", method="efficientnet", **arguments):
    return registry.make_method({**config(f"method={method}", f"method.variant={variant}"), **arguments})


def blocks_of(variant):
    """Return the network up to its last block, as the method loads it."""
    method = made(variant, blocks=[*range(N_BLOCKS[variant])], grid=[None] * N_BLOCKS[variant])
    return method.load(method.files()[0]).model


def seen(*images):
    """Return what the published weights want of images: (level - 127) / 128, in float64."""
    return (torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).double() - 127) / 128


def furthest(found, wanted):
    """Return the largest difference between outputs of as many blocks."""
    return max(float((one - other).abs().max()) for one, other in zip(found, wanted, strict=True))


@cache
def published_outputs(variant, size):
    """Return an image, and what every block of the published package makes of it in float64."""
    (image,) = drawn_images(size)
    weights = str(made(variant).files()[0])
    network = Published.from_pretrained(f"efficientnet-{variant}", weights_path=weights, image_size=None)
    outputs = []
    for block in network.eval().double()._blocks:
        block.register_forward_hook(lambda *called: outputs.append(called[2]))
    with torch.inference_mode():
        network.extract_features(seen(image))
    return image, outputs


@pytest.mark.parametrize(("variant", "size"), [("lite0", (224, 224)), ("lite0", (33, 70)), ("lite1", (240, 240))])
def test_every_block_gives_what_that_of_the_published_package_gives(variant, size):
    image, wanted = published_outputs(variant, size)
    with torch.inference_mode():
        found = blocks_of(variant).double()(seen(image), range(len(wanted)))  # rounded when folded, not when summed
    assert len(found) == N_BLOCKS[variant]
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
    image, outputs = published_outputs("lite0", (224, 224))
    maps = [outputs[block][0].numpy() for block in (4, 10, 12)]
    parts = [unit(part.flatten()) for part in (maps[0], cells(maps[1], 3, 5), cells(maps[2], 2, 4))]
    codes = encoded(made(blocks=[4, 10, 12], grid=[None, [3, 5], [2, 4]], height=224, width=224), image)
    assert distance(codes, unit(np.concatenate(parts))) < 1e-6
    norms = [np.linalg.norm(part) for part in np.split(codes[0], np.cumsum([len(part) for part in parts])[:-1])]
    assert norms == pytest.approx([3**-0.5] * 3, abs=1e-6)


@pytest.mark.parametrize("size", [(64, 96), (35, 67), (1, 1)])
def test_compiled_blocks_give_what_the_plain_network_gives(size):
    network = blocks_of("lite0")
    images = seen(*drawn_images(size, size)).float().contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        for blocks in (range(16), [0, 4]):
            compiled = compile_blocks(network, images, blocks)
            if compiled is None:
                assert size == (1, 1) or not torch.backends.mkldnn.is_available()  # no graph of maps of one pixel
                continue
            found = compiled(images)
            assert [maps.shape for maps in found] == [maps.shape for maps in network(images, blocks)]
            assert furthest(found, network(images, blocks)) < 1e-4


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
def test_multiply_adds_are_those_of_all_convolutions_and_are_told_of_every_image(variant, last, size):
    wanted = []
    with torch.device("meta"):
        network = EfficientNetLite(variant, last)
        for layer in filter(lambda layer: isinstance(layer, torch.nn.Conv2d), network.modules()):
            layer.register_forward_hook(lambda own, _, maps: wanted.append(own.weight.numel() * maps[0, 0].numel()))
        network(torch.empty(1, 3, *size), [last])
    assert count_multiply_adds(variant, last, *size) == sum(wanted)
    method = made(variant, blocks=[last], grid=[[1, 1]], height=size[0], width=size[1])
    with counting_operations() as told:
        encoded(method, *drawn_images((40, 60), (40, 60), (40, 60)))
    assert sum(each.multiply_adds for each in told) == 3 * sum(wanted)


def amplitudes(values):
    """Return each row's values as amplitudes: 0.5 is its mean, 0 and 1 are 3 standard deviations away, or more."""
    rows = values.astype(np.float64)
    return np.array([np.minimum(np.maximum(0.5 + (row - row.mean()) / (6 * row.std()), 0), 1) for row in rows])


def test_input_spikes_are_each_block_of_the_descriptor_scaled_on_its_own():
    queries = Images.from_arrays(Journey.draw(0).queries)
    codes = made(**SMALL).encode(queries)
    wanted = [amplitudes(part) for part in np.split(codes, [24 * 4 * 5], axis=1)]
    found = made(method="vprtempo_efficientnet", **SMALL, max_module=10).encode(queries)
    assert found == pytest.approx(np.concatenate(wanted, axis=1), abs=1e-5)
    assert (found.dtype, found.shape[1]) == (np.float32, 24 * 4 * 5 + 24 * 3 * 4)
