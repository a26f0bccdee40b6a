"""Networks on DINOv2, each against a slow computation from the tensors of a file by their published names."""

import re
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import backbones_oracle as oracle
import numpy as np
import pytest
import torch
from backbones_oracle import Draw, imagenet, prefixed, under, vit_checkpoint, vit_tokens
from described_images import distance, encoded, image
from published_networks import PublishedNetwork, saved, saved_training, unit, with_checks
from safetensors.torch import save_file
from torch.nn import functional

pytestmark = pytest.mark.extended  # published networks at full size

DIM = 128
IMAGES = [image(56, 98), image(42, 70, 1), image(42, 70, 2)]
OWN_SIZE = {"height": None, "width": None}


def floats(seen, height, width, mode="bilinear"):
    """What a network sees of an image that is resized as antialiased floats."""
    return functional.interpolate(imagenet(seen), (height, width), mode=mode, antialias=True)


def dinov2(tensors, seen, pooling="cls"):
    tokens = vit_tokens(tensors, "", imagenet(seen))[0]
    return {"cls": tokens[0], "mean": tokens[1:].mean(0), "gem": oracle.gem(tokens[1:], 3, 0)}[pooling]


DINOV2 = PublishedNetwork(
    "dinov2",
    lambda: vit_checkpoint(Draw(1)),
    IMAGES,
    DIM,
    dinov2,
    arguments=OWN_SIZE,
    options={
        "mean": ({"pooling": "mean"}, IMAGES[0], {"pooling": "mean"}),
        "gem": ({"pooling": "gem"}, IMAGES[0], {"pooling": "gem"}),
        "positions as they are": ({}, image(70, 70), {}),
    },
)


# SALAD, and with a linear layer MegaLoc

PARTS, N_DIMENSIONS = {"clusters": 7, "cluster_dim": 12, "token_dim": 10}, 40


def draw_salad():
    backbone, aggregator = vit_checkpoint(draw := Draw(1)), oracle.salad_checkpoint(draw, **PARTS)
    return prefixed("backbone.model.", backbone) | prefixed("aggregator.", aggregator)


SALAD = PublishedNetwork(
    "salad",
    draw_salad,
    IMAGES,
    7 * 12 + 10,
    lambda tensors, seen: oracle.salad(
        tensors, "aggregator.", vit_tokens(tensors, "backbone.model.", imagenet(seen))[0]
    ),
    arguments=OWN_SIZE,
    options={"one patch more than clusters": ({}, image(28, 56), {})},
    refused=[("need more: set method.height and method.width to 42", {}, (14, 98))],
)


def draw_megaloc():
    aggregator = prefixed("agg.", oracle.salad_checkpoint(draw := Draw(3), **PARTS))
    aggregator |= draw.linear("linear", 7 * 12 + 10, N_DIMENSIONS)
    return prefixed("backbone.", vit_checkpoint(draw)) | prefixed("aggregator.", aggregator)


def described_by_megaloc(tensors, seen):
    inner = oracle.salad(tensors, "aggregator.agg.", vit_tokens(tensors, "backbone.", imagenet(seen))[0])
    return oracle.linear(under(tensors, "aggregator."), "linear", inner)


MEGALOC = PublishedNetwork(
    "megaloc",
    draw_megaloc,
    IMAGES,
    N_DIMENSIONS,
    described_by_megaloc,
    lambda path, tensors: save_file(dict(tensors), path) or path,
    refused=[("6 patches", {}, (28, 42))],
)

# SuperVLAD and CricaVPR, whose images may see one another

CLUSTERS = 4
SMALL, LARGE = ([image(*size, seed) for seed in range(5)] for size in ((56, 98), (224, 224)))


def norm(t, at, x):
    return oracle.layer_norm(x, t[f"{at}.weight"], t[f"{at}.bias"], eps=1e-5)


def encoder_layer(t, x, heads, activation):
    """What a `torch.nn.TransformerEncoderLayer`, whose norms come after additions, makes of x (n, dim)."""
    x = norm(t, "norm1", x + oracle.attention(t, "self_attn", x, x, heads))
    return norm(t, "norm2", x + oracle.linear(t, "linear2", activation(oracle.linear(t, "linear1", x))))


def draw_layer(draw, dim, hidden):
    layer = draw.attention("self_attn", dim) | draw.norm("norm1", dim) | draw.norm("norm2", dim)
    return layer | draw.linear("linear1", dim, hidden) | draw.linear("linear2", hidden, dim)


def encoded_together(tensors, parts):
    """What becomes of the parts (n_images, n_parts, dim) of images: a part sees the same part of all images."""
    for number in range(2):
        t = under(tensors, f"encoder.layers.{number}.")
        parts = torch.stack([encoder_layer(t, part, 16, functional.gelu) for part in parts.unbind(1)], 1)
    return parts


def encoder_checkpoint(draw):
    """Random values, so large that images change one another."""
    layers = [prefixed(f"encoder.layers.{number}.", draw_layer(draw, DIM, 48)) for number in range(2)]
    return layers[0] | layers[1]


def draw_supervlad():
    draw = Draw(5)
    tensors = prefixed("backbone.", vit_checkpoint(draw)) | encoder_checkpoint(draw)
    tensors["aggregation.conv.weight"] = draw.normal(CLUSTERS + 1, DIM, 1, 1, scale=6)
    return prefixed("module.", tensors)


def clusters(tensors, seen):
    """The clusters of one image, but for the ghost, as a vector of unit length, (CLUSTERS, DIM)."""
    t = under(tensors, "module.")
    patches = functional.normalize(vit_tokens(t, "backbone.", imagenet(seen))[0, 1:], dim=1)
    shares = torch.softmax(patches @ t["aggregation.conv.weight"].flatten(1).T, dim=1)
    return functional.normalize(shares[:, :CLUSTERS].T @ patches, dim=1) / CLUSTERS**0.5


def supervlad_together(tensors, *images):
    own = torch.stack([clusters(tensors, seen) for seen in images])
    return unit(encoded_together(under(tensors, "module."), own).flatten(1).numpy())


SUPERVLAD = PublishedNetwork(
    "supervlad",
    lambda: {name: tensor for name, tensor in draw_supervlad().items() if ".encoder." not in name},
    [*SMALL[:2], image(42, 70)],
    CLUSTERS * DIM,
    lambda tensors, seen: clusters(tensors, seen).flatten(),
    saved_training,
    arguments=OWN_SIZE,
)
CROSS_IMAGE = replace(
    SUPERVLAD,
    name="supervlad_crossimage",
    draw=draw_supervlad,
    expected=lambda tensors, seen: supervlad_together(tensors, seen)[0],
)


def draw_cricavpr():
    """Random values under the names of a file of several devices, whose adapters weigh as much as the MLPs."""
    draw, inner = Draw(3), DIM // 2
    tensors, few = vit_checkpoint(draw), inner // 16
    sizes = {"branch1": (inner, inner // 2, 1), "branch2.0": (inner, few, 1), "branch2.1": (few, inner // 4, 3)}
    sizes |= {"branch3.0": (inner, few, 1), "branch3.1": (few, inner // 4, 5)}
    for number in range(2):
        adapter = draw.linear("D_fc1", DIM, inner) | draw.linear("D_fc2", inner, DIM)
        for name, (n_in, n_out, side) in sizes.items():
            adapter[f"{name}.conv.weight"] = draw.normal(n_out, n_in, side, side, scale=0.1 / (side * n_in**0.5))
            adapter[f"{name}.conv.bias"] = draw.normal(n_out, scale=0.02)
            adapter |= draw.norm(f"{name}.bn", n_out)
            adapter[f"{name}.bn.running_mean"] = draw.normal(n_out, scale=0.02)
            # As small as the published epsilon, so that another epsilon would show.
            adapter[f"{name}.bn.running_var"] = 0.001 + 0.001 * torch.rand(n_out, generator=draw.generator)
        tensors |= prefixed(f"blocks.{number}.adapter.", adapter)
    tensors = prefixed("backbone.", tensors) | {"aggregation.1.p": torch.tensor([2.4])}
    return prefixed("module.", tensors | encoder_checkpoint(draw))


def adapted(block, tokens):
    """What an adapter adds to the MLP, from its definition: half the dimensions, three kinds of surroundings."""
    b = under(block, "adapter.")

    def convolution(name, x):
        x = functional.conv2d(x, b[f"{name}.conv.weight"], b[f"{name}.conv.bias"], padding="same")
        return functional.batch_norm(x, **under(b, f"{name}.bn."), eps=1e-3).clamp(min=0)

    inner = oracle.linear(b, "D_fc1", tokens).clamp(min=0)
    grid = inner[:, 1:].reshape(len(inner), 16, 16, -1).permute(0, 3, 1, 2)
    seen = [convolution("branch1", grid)]
    seen += [convolution(f"{name}.1", convolution(f"{name}.0", grid)) for name in ("branch2", "branch3")]
    inner[:, 0] *= 2
    inner[:, 1:] += torch.cat(seen, 1).flatten(2).transpose(1, 2)
    return 0.2 * oracle.linear(b, "D_fc2", inner)


def cricavpr_together(tensors, *images):
    t = under(tensors, "module.")
    tokens = vit_tokens(t, "backbone.", imagenet(*images), beside_mlp=adapted)
    grid = functional.normalize(tokens[:, 1:].reshape(len(images), 16, 16, DIM), dim=3)
    parts = [tokens[:, 0]]
    for bounds in ([0, 8, 16], [0, 5, 11, 16]):
        for rows, columns in product(pairwise(bounds), repeat=2):
            parts.append(oracle.gem(grid[:, slice(*rows), slice(*columns)], t["aggregation.1.p"], (1, 2)))
    return unit(encoded_together(t, torch.stack(parts, 1)).flatten(1).numpy())


CRICAVPR = PublishedNetwork(
    "cricavpr",
    draw_cricavpr,
    LARGE[:2],
    14 * DIM,
    lambda tensors, seen: cricavpr_together(tensors, seen)[0],
    saved_training,
    tolerance=2e-5,
    refused=[
        (f"method.{name}={wanted}", {name: value}, (224, 224))
        for name, wanted, value in [("height", 224, 238), ("width", 224, 238), ("images_together", 0, 0)]
    ],
)


def test_images_that_see_one_another_except_one_rule(folder):
    excepted = CROSS_IMAGE.check_contract(folder, images_together=16, height=28, width=42)
    assert excepted == {"a batch gives what its single images give"}


@pytest.mark.parametrize(
    ("network", "together", "images", "batch_size"),
    [
        (CROSS_IMAGE, supervlad_together, SMALL, 3),
        *((CRICAVPR, cricavpr_together, LARGE, batch_size) for batch_size in (1, 3)),
    ],
)
def test_consecutive_images_see_one_another_whatever_the_batch(network, together, images, batch_size, folder):
    codes = network.encode(folder, *images, images_together=2, batch_size=batch_size)
    wanted = [together(network.tensors, *images[first : first + 2]) for first in (0, 2, 4)]
    assert distance(codes, np.concatenate(wanted)) < 2e-5
    assert distance(codes[:1], network.slowly(images[0])) > 1e-3


def test_a_run_whose_images_see_one_another_says_so_and_keeps_no_descriptors():
    how = {"images_together": 1}, {"images_together": 16}, {"index": "sq8"}
    alone, together, coarse = (CRICAVPR.method(Path("none"), **each) for each in how)
    assert (alone.notes(), alone.keeps_descriptors(), alone.extends) == ((), True, True)
    assert "16 consecutive images" in together.notes()[0]
    assert (together.keeps_descriptors(), together.extends, coarse.extends) == (False, False, False)


# BoQ, of two heads; published are 384 or 512 dimensions, 64 queries and 32 rows

QUERIES, ROWS = 7, 5


def draw_boq(backbone, n_channels):
    draw = Draw(5)
    tensors = {"proj_c.weight": draw.normal(DIM, n_channels, 3, 3, scale=(9 * n_channels) ** -0.5)}
    tensors["proj_c.bias"] = draw.normal(DIM, scale=0.3)
    tensors |= draw.norm("norm_input", DIM) | draw.linear("fc", 2 * QUERIES, ROWS)
    for number in (0, 1):
        block = {"queries": draw.normal(1, QUERIES, DIM)}
        block |= draw.attention("self_attn", DIM) | draw.attention("cross_attn", DIM)
        block |= draw.norm("norm_q", DIM) | draw.norm("norm_out", DIM)
        block |= prefixed("encoder.", draw_layer(draw, DIM, 4 * DIM))
        tensors |= prefixed(f"boqs.{number}.", block)
    return prefixed("backbone.", backbone(draw)) | prefixed("aggregator.", tensors)


def gathered(tensors, features):
    """BoQ's descriptor of one image's features (1, n_channels, rows, columns)."""
    t = under(tensors, "aggregator.")
    x = functional.conv2d(features, t["proj_c.weight"], t["proj_c.bias"], padding=1).flatten(2)[0].T
    x = norm(t, "norm_input", x)
    outs = []
    for number in (0, 1):
        b = under(t, f"boqs.{number}.")
        x = encoder_layer(under(b, "encoder."), x, 2, torch.relu)
        queries = b["queries"][0]
        asking = norm(b, "norm_q", queries + oracle.attention(b, "self_attn", queries, queries, 2))
        outs.append(norm(b, "norm_out", oracle.attention(b, "cross_attn", asking, x, 2)))
    return oracle.linear(t, "fc", torch.cat(outs).T).flatten()  # (DIM, ROWS)


def described_by_boq(tensors, seen):
    tokens = vit_tokens(tensors, "backbone.dino.", floats(seen, 42, 56, "bicubic"), final_norm=False)
    return gathered(tensors, tokens[:, 1:].transpose(1, 2).unflatten(2, (3, 4)))


BOQ = PublishedNetwork(
    "boq",
    lambda: draw_boq(lambda draw: prefixed("dino.", vit_checkpoint(draw, 64)), 64),
    [image(64, 96), image(64, 96, 1), image(93, 53)],
    DIM * ROWS,
    described_by_boq,
    arguments={"height": 42, "width": 56},
    refused=[("method.height=40", {"height": 40}, (64, 96))],
)
BOQ_RESNET = PublishedNetwork(
    "boq_resnet50",
    lambda: draw_boq(lambda draw: oracle.resnet_checkpoint(draw, "resnet50", "net.", n_stages=3), 1024),
    BOQ.images,
    DIM * ROWS,
    lambda tensors, seen: gathered(tensors, oracle.resnet(tensors, "backbone.net.", floats(seen, 48, 80, "bicubic"))),
    arguments={"height": 48, "width": 80},
)


def test_the_names_of_the_other_public_wrapper_are_those_of_the_same_tensors(folder):
    others = {"0": "frozen_layers.0.0", "1": "frozen_layers.0.1", "4": "frozen_layers.1", "5": "frozen_layers.2"}
    others["6"] = "unfrozen_layers.0"
    wrapped = {
        re.sub(r"(?<=^backbone\.)net\.(\d)", lambda number: others[number[1]], name): tensor
        for name, tensor in BOQ_RESNET.tensors.items()
    }
    method = BOQ_RESNET.method(saved(folder / "wrapped.pth", wrapped))
    assert distance(encoded(method, *BOQ_RESNET.images), BOQ_RESNET.codes(folder)) < 1e-5


@with_checks(DINOV2, SALAD, MEGALOC, SUPERVLAD, CROSS_IMAGE, CRICAVPR, BOQ, BOQ_RESNET)
def test_it_is_the_published_network(check, folder):
    check(folder)
