"""Descriptors: frames through each method of this project; networks have their sizes and random weights."""

from math import sqrt

import pytest
import torch
from full_size import FULL

from vprbench.api.neural import NeuralDescriptor
from vprbench.plugins.entries import find_entries

METHODS = [
    name
    for name, entry in find_entries("method").items()
    if not name.startswith(("vprtempo", "vprsnn")) and (FULL or not entry.needs_weights)  # networks take long
]


def randomised(network):
    """Fill a network with random numbers under which its activations stay finite; returns it."""
    network = network.to_empty(device="cpu")
    with torch.no_grad():
        for name, values in [*network.named_parameters(), *network.named_buffers()]:
            if not values.is_floating_point():
                values.zero_()
            elif values.ndim > 1:  # weights: the variance of what goes in is kept
                values.normal_(0, sqrt(2 / values[0].numel()), generator=torch.Generator().manual_seed(0))
            else:
                values.fill_(0.0 if name.endswith(("bias", "running_mean")) else 1.0)
    return network


@pytest.mark.parametrize("frame", [(224, 224), (480, 640)] if FULL else [(48, 64)])
@pytest.mark.parametrize("name", METHODS)
def test_encode(name, frame, measure, size, route, build):
    shown = route(40, *frame)
    method = build(name)
    if isinstance(method, NeuralDescriptor):
        sized = method.fixed_size or name.startswith("efficientnet")  # whose descriptors grow with the image
        method = build(name, **({} if sized else {"height": None, "width": None}))
        method.use(randomised(method.blank()))
    else:  # it may learn from its references
        method.fit(*shown.references(40))
    image = shown.queries(40, 1)
    numbers = method.encode(image)[0].size
    measure(f"{name}, {frame[1]}x{frame[0]}", lambda: method.encode(image), numbers=numbers)
