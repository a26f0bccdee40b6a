"""The rules for datasets: each is a function that raises RuleBrokenError with the values that break it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.plugins.rules import RuleBrokenError, require
from vprbench.text import join_names

_N_SAMPLES = 8  # images of each traverse that are decoded


@dataclass(frozen=True)
class BuiltDataset:
    """A dataset, and a function that makes it again."""

    dataset: Dataset
    make: Callable[[], Dataset]

    @property
    def parts(self) -> dict[str, Images]:
        """References and queries by name."""
        return {"references": self.dataset.references, "queries": self.dataset.queries}


def _check_again(built: BuiltDataset) -> None:
    first, second = built.dataset, built.make()
    for name in ("name", "n_places", "protocol", "notes"):
        one, other = getattr(first, name), getattr(second, name)
        require(one == other, f"{name} is {one}, and {other} when it is made again")
    for part, images in built.parts.items():
        others: Images = getattr(second, part)
        sample = np.array(_sample_numbers(images))
        same = images.names == others.names and images[sample].fingerprint() == others[sample].fingerprint()
        require(same, f"{part} are others when it is made again: draw from a seed, and sort the names in a folder")
    truth = zip((first.places, *first.positives), (second.places, *second.positives), strict=True)
    same = all(np.array_equal(one, other) for one, other in truth)
    require(same, "places or ground truth are others when it is made again")


def _check_positives(built: BuiltDataset) -> None:
    for query, right in enumerate(built.dataset.positives):
        whole = isinstance(right, np.ndarray) and right.ndim == 1 and (right.dtype.kind in "iu" or not len(right))
        require(whole, f"right places of query {query}: {_format_type(right)} came, wanted an array of whole numbers")
        ascending = (np.diff(right) > 0).all()
        require(ascending, f"right places of query {query}: {join_names(right)} came, wanted each once, ascending")


def _check_images(built: BuiltDataset) -> None:
    for part, images in built.parts.items():
        for i in _sample_numbers(images):
            image: Any = images[i]
            right = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.size > 0
            right = right and image.ndim == 3 and image.shape[2] == 3
            name = f"{part}[{i}] ({images.names[i]})"
            require(right, f"{name} is {_format_type(image)}; wanted is uint8 (height, width, 3)")


def _check_rereading(built: BuiltDataset) -> None:
    for part, images in built.parts.items():
        sample = _sample_numbers(images)
        for i, in_a_row in zip(sample, images[np.array(sample)], strict=True):  # threads read the row ahead
            first = np.array(images[i], copy=True)
            same = np.array_equal(first, images[i]) and np.array_equal(first, in_a_row)
            require(same, f"{part}[{i}] ({images.names[i]}) is another image when it is read again")


def _check_protocol(built: BuiltDataset) -> None:
    protocol = built.dataset.protocol
    try:
        stored = json.loads(json.dumps(dict(protocol), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise RuleBrokenError(f"the protocol is no JSON: {error}") from error
    for name, value in protocol.items():
        require(stored.get(name) == value, f"{name} of the protocol is {value!r}; JSON makes it {stored.get(name)!r}")


def _check_held_out(built: BuiltDataset) -> None:
    if built.dataset.held_out is None:
        return
    held_out, queries = built.dataset.held_out.queries, built.dataset.queries
    numbers = {name: i for i, name in enumerate(queries.names)}
    for i in _sample_numbers(held_out):
        name = held_out.names[i]
        same = name in numbers and np.array_equal(held_out[i], queries[numbers[name]])
        require(not same, f"the held-out query {name} is one of the queries: leave it out there")


def _sample_numbers(images: Images) -> list[int]:
    """Return the numbers of some images, spread over all."""
    return sorted({round(i) for i in np.linspace(0, len(images) - 1, _N_SAMPLES).tolist()})


def _format_type(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


#: The rules by the text that `check` prints, in its order.
DATASET_RULES: dict[str, Callable[[BuiltDataset], None]] = {
    "it is the same when it is made again": _check_again,
    "right places are whole numbers, ascending, each once": _check_positives,
    "images are uint8 (height, width, 3)": _check_images,
    "an image is the same however it is read": _check_rereading,
    "the protocol holds plain values": _check_protocol,
    "held-out queries are none of the queries": _check_held_out,
}
