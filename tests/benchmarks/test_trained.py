"""EfficientNet-Lite on frames of 128x224 pixels, encode and match together, beside matrix products as large."""

from contextlib import suppress
from functools import cache
from math import ceil

import pytest
import torch

from vprbench.methods.parts.backbones.efficientnet_lite import count_multiply_adds

SIDE = 1024  # of square matrices

#: Method and arguments of each.
NETWORKS = {
    "efficientnet to block 4": ("efficientnet_aligned", {}),
    "efficientnet to block 10": ("efficientnet", {"blocks": [10], "grid": [None]}),
    "efficientnet": ("efficientnet", {}),
    "efficientnet, running mean": ("efficientnet", {"adapt": "running"}),
    "efficientnet_viewpoint": ("efficientnet_viewpoint", {}),
    "vprtempo_efficientnet": ("vprtempo_efficientnet", {}),
    "vprtempo_efficientnet_int8": ("vprtempo_efficientnet_int8", {}),
}


@pytest.fixture(scope="module")
def fitted(size, route, build):
    @cache
    def fit(name):
        method, arguments = NETWORKS[name]
        return build(method, **arguments).fit(*route(size(1000, 20), 128, 224).references(size(1000, 20)))

    return fit


@pytest.fixture(scope="module")
def products(size):
    """Return matrix products of so many multiply-adds, with all threads: what no network can be faster than."""
    first, second = torch.ones(size(SIDE, 64), size(SIDE, 64)), torch.ones(size(SIDE, 64), size(SIDE, 64))

    def floor(multiply_adds):
        columns = max(1, ceil(multiply_adds / first.numel()))
        some = second[:, : min(columns, len(second))].contiguous()
        return {f"{multiply_adds / 1e6:,.0f} M multiply-adds": lambda: first @ some}

    return floor


def plain(method):
    """Return the same descriptor computed by PyTorch's own convolutions, channels last."""
    network = method._network

    def encode(images):
        compiled, network.compiled = network.compiled, None
        try:
            return method.encode(images)
        finally:
            network.compiled = compiled

    return encode


@pytest.mark.parametrize("images", [1, 32])
@pytest.mark.parametrize("name", NETWORKS)
def test_query(name, images, measure, size, route, fitted, products):
    method, queries = fitted(name), route(size(1000, 20), 128, 224).queries(size(1000, 20), images)
    descriptor = method if name.startswith("efficientnet") else method.encoder().descriptor
    floor = products(images * count_multiply_adds("lite0", descriptor.blocks[-1], 128, 224)) if images == 1 else {}
    encode = {"encode alone": lambda: method.encode(queries)}
    plainly = {} if descriptor is not method else {"PyTorch's convolutions": lambda: plain(method)(queries)}
    measure(f"{name}, {images} together", lambda: method.query(queries), images, {**encode, **plainly, **floor})


@pytest.mark.parametrize("block", [4, 10, 12])
def test_bfloat16(block, measure, size, fitted):
    """bfloat16 beside float32: measured, and not offered."""
    from vprbench.methods.parts.backbones.compiled_blocks import compile_blocks

    network = fitted("efficientnet")._network.model
    images = torch.ones(1, 3, size(128, 32), size(224, 32)).contiguous(memory_format=torch.channels_last)
    calls = {}
    with torch.inference_mode(), suppress(RuntimeError):  # a processor without bfloat16
        for kind in (torch.float32, torch.bfloat16):
            shown = images.to(kind)
            run = compile_blocks(network.to(kind), shown, [block])
            calls[kind] = lambda run=run, shown=shown: run(shown)
            calls[kind]()
    network.float()
    if len(calls) < 2:
        pytest.skip("oneDNN has no convolution in bfloat16 here")
    with torch.inference_mode():
        measure(f"to block {block}, bfloat16", calls[torch.bfloat16], 1, {"float32": calls[torch.float32]})
