"""VPRTempo networks drawn at random or trained on a little world, inputs to show them, and the two ways of asking."""

from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
import torch

from vprbench.api.images import Images
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.rules import RuleSet
from vprbench.plugins.rules import Journey

WORLD = Journey.draw(0)
REFERENCES, QUERIES = Images.from_arrays(WORLD.references), Images.from_arrays(WORLD.queries)
SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}  # modules of 7, 7 and 6 places
RULE_SETS = pytest.mark.parametrize("rules", get_args(RuleSet))

N_PIXELS = 20
SIZES = pytest.mark.parametrize("sizes", [[5, 5, 3], [7], [1], [2, 1]], ids=str)  # places of each module


def tensor(array):
    return torch.from_numpy(array.astype(np.float32))


def double(part):
    return part.numpy().astype(np.float64)


def network(sizes, n_features=37, n_pixels=N_PIXELS, seed=0):
    """Draw a network in which about half of all neurons spike and some reach the clip."""
    draw, modules = np.random.default_rng(seed), len(sizes)
    return Network(
        features=tensor(draw.normal(0, 1.2 / n_pixels**0.5, (modules, n_features, n_pixels))),
        constant=tensor(draw.uniform(0, 0.1, (modules, n_features))),
        feature_thresholds=tensor(draw.uniform(0, 0.2, (modules, n_features))),
        outputs=tuple(tensor(draw.normal(0, 3 / n_features**0.5, (n_features, size))) for size in sizes),
        output_thresholds=tuple(tensor(draw.uniform(0, 0.2, size)) for size in sizes),
    )


def one_layer(outputs, *thresholds):
    """One module whose features repeat the pixels; `outputs` is (n_pixels, n_places)."""
    n_pixels, n_places = outputs.shape
    none = torch.zeros(1, n_pixels)
    own = torch.tensor(thresholds) if thresholds else torch.zeros(n_places)
    return Network(torch.eye(n_pixels)[None], none, none, (tensor(outputs),), (own,))


def shown(count, n_pixels=N_PIXELS, seed=1):
    return np.random.default_rng(seed).uniform(0, 1, (count, n_pixels)).astype(np.float32)


def one_by_one(query, spikes):
    return np.concatenate([query.scores(x[None]) for x in spikes])


def in_a_batch(query, spikes):
    return query.scores(spikes)


WAYS = pytest.mark.parametrize("ask", [one_by_one, in_a_batch])


@cache
def fitted(kind=VPRTempo, **arguments):
    """Return what has learnt the little world; tests share it, so they change nothing in it."""
    return kind(**{**SMALL, **arguments}).fit(REFERENCES, WORLD.places)
