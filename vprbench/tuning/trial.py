"""One training of a search: the method learns a stretch of places under some settings and answers its queries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.adaptation import adapt_traverse
from vprbench.api.arrays import Places
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import TrainingDivergedError
from vprbench.metrics.accuracy import count_hits
from vprbench.metrics.ranking import judge_scores
from vprbench.plugins import registry
from vprbench.runs import machine

_TOGETHER = 64  # images encoded together


@dataclass(frozen=True)
class Stretch:
    """A stretch of places, its images encoded: how an image becomes spikes is not searched."""

    references: npt.NDArray[Any]  # (n_references, ...)
    places: Places  # (n_references,)
    queries: npt.NDArray[Any]  # (n_queries, ...)
    positives: tuple[npt.NDArray[np.int64], ...]  # per query the right places


@dataclass(frozen=True)
class Hits:
    """The answers to the queries of a stretch; all are wrong if the training diverged."""

    expected: npt.NDArray[np.float64]  # (n_queries,), 0 to 1 under ties
    diverged: str = ""  # how the divergence was seen


def encode_stretch(dataset: Dataset, method: Method, name: str) -> Stretch:
    """Encode the images of a stretch for all trials."""
    codes = [_encode_images(images, method, name) for images in (dataset.references, dataset.queries)]
    return Stretch(codes[0], dataset.places, codes[1], dataset.positives)


def train_and_query(arguments: Mapping[str, Any], stretch: Stretch) -> Hits:
    """Train a method of these arguments on one thread, and match all queries of a stretch."""
    machine.pin_threads(1)
    method = registry.make_method(arguments)
    vars(method)["encode"] = lambda images: stretch.references  # codes stand in for images
    try:
        method.fit(Images.from_arrays([]), stretch.places)
    except TrainingDivergedError as error:
        return Hits(np.zeros(len(stretch.queries)), str(error))
    ranked = judge_scores(method.match(adapt_traverse(method, stretch.queries)), stretch.positives)
    return Hits(count_hits(ranked, 1))


def _encode_images(images: Images, method: Method, name: str) -> npt.NDArray[Any]:
    codes: list[npt.NDArray[Any]] = []
    for block in images.blocks(_TOGETHER):
        progress.report(f"encoding the {name} places", len(codes) * _TOGETHER / len(images))
        codes.append(np.array(method.encode(block)))  # a method may use its array again
    return np.concatenate(codes)
