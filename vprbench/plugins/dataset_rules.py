"""The rules for datasets: each is a function that raises RuleBrokenError with the values that break it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset, has_ground_truth
from vprbench.api.images import Images
from vprbench.plugins.rules import RuleExceptedError, require
from vprbench.text import some, some_of

_N_SAMPLES = 8  # images of each traverse that are decoded


@dataclass(frozen=True)
class BuiltDataset:
    """A dataset, a function that makes it again, and its configuration."""

    dataset: Dataset
    make: Callable[[], Dataset]
    config: Mapping[str, Any]

    @property
    def parts(self) -> dict[str, Images]:
        """References and queries by name."""
        return {"references": self.dataset.references, "queries": self.dataset.queries}

    @cached_property
    def samples(self) -> dict[str, Image]:
        """Some images of each traverse, by part, number and name."""
        return {
            f"{part}[{i}] ({images.names[i]})": images[i]
            for part, images in self.parts.items()
            for i in _sample(images)
        }


def _check_again(made: BuiltDataset) -> None:
    first, second = made.dataset, made.make()
    for name in ("name", "n_places", "protocol", "notes"):
        one, other = getattr(first, name), getattr(second, name)
        require(one == other, f"{name} is {one}, and {other} when it is made again")
    for part, images in made.parts.items():
        others: Images = getattr(second, part)
        sample = np.array(_sample(images))
        same = images.names == others.names and images[sample].fingerprint() == others[sample].fingerprint()
        require(same, f"{part} are others when it is made again: draw from a seed, and sort the names in a folder")
    truth = zip((first.places, *first.positives), (second.places, *second.positives), strict=True)
    same = all(np.array_equal(one, other) for one, other in truth)
    require(same, "places or ground truth are others when it is made again")


def _check_name(made: BuiltDataset) -> None:
    wanted = made.config.get("name", made.dataset.name)
    require(made.dataset.name == wanted, f"name={wanted} was asked for, but it is {made.dataset.name}")


def _check_positives(made: BuiltDataset) -> None:
    for query, right in enumerate(made.dataset.positives):
        whole = _is_row(right) or not len(right)
        require(whole, f"the right places of query {query} are {_kind(right)}; wanted is an array of whole numbers")
        ascending = (np.diff(right) > 0).all()
        require(ascending, f"the right places of query {query} are {some(list(right))}: name each once, ascending")


def _check_answerable(made: BuiltDataset) -> None:
    right = made.dataset.positives
    if not has_ground_truth(made.dataset.protocol):
        raise RuleExceptedError("there is no ground truth, and no answer is judged")
    without = sum(not len(places) for places in right)
    complaint = f"{without} of {len(right)} queries have no right place: does the ground truth fit the map?"
    require(2 * without <= len(right), complaint)


def _check_wrong_places(made: BuiltDataset) -> None:
    everywhere = sum(len(right) == made.dataset.n_places > 1 for right in made.dataset.positives)
    require(not everywhere, f"for {everywhere} queries every place is right: is the tolerance too wide?")


def _check_images(made: BuiltDataset) -> None:
    for where, image in made.samples.items():
        right = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3
        right = right and image.shape[2] == 3 and image.size > 0
        require(right, f"{where} is {_kind(image)}; wanted is uint8 (height, width, 3)")


def _check_content(made: BuiltDataset) -> None:
    images = made.samples.values()
    n_plain = sum(bool((image == image.reshape(-1, image.shape[-1])[0]).all()) for image in images)
    require(2 * n_plain <= len(images), f"{n_plain} of {len(images)} images that were read have one colour all over")


def _check_sizes(made: BuiltDataset) -> None:
    for part, images in made.parts.items():
        shapes = [made.samples[where].shape for where in made.samples if where.startswith(f"{part}[")]
        sizes = sorted({f"{width}x{height}" for height, width, *_ in shapes})
        text = f"{part} have sizes {some(sizes)}"
        noted = any("size" in note for note in made.dataset.notes)
        if len(sizes) > 1 and (noted or images[:1].file_hashes() is not None):
            raise RuleExceptedError(f"{text}, as the files have")
        require(len(sizes) == 1, f"{text}: give them one, or say so in the dataset's notes")


def _check_reading(made: BuiltDataset) -> None:
    for part, images in made.parts.items():
        sample = _sample(images)
        for i, in_a_row in zip(sample, images[np.array(sample)], strict=True):  # threads read the row ahead
            first = np.array(images[i], copy=True)
            same = np.array_equal(first, images[i]) and np.array_equal(first, in_a_row)
            require(same, f"{part}[{i}] ({images.names[i]}) is another image when it is read again")


def _check_names(made: BuiltDataset) -> None:
    for part, images in made.parts.items():
        counts = Counter(images.names)
        wrong = sorted(name for name in counts if not name or counts[name] > 1)
        text = f"names of {part} that stand for several images or none: {some_of(wrong)}"
        if wrong and sum(wrong[0] in folder.used for folder in made.dataset.folders) >= counts[wrong[0]]:
            raise RuleExceptedError(f"{text}, as the files in several folders have them")
        require(not wrong, text)


def _check_protocol(made: BuiltDataset) -> None:
    protocol, text = made.dataset.protocol, ""
    try:
        text = json.dumps(dict(protocol), allow_nan=False)
    except (TypeError, ValueError) as error:
        require(False, f"the protocol is no JSON: {error}")
    stored = json.loads(text)
    for name, value in protocol.items():
        require(stored.get(name) == value, f"{name} of the protocol is {value!r}; JSON makes it {stored.get(name)!r}")


def _check_protocol_keys(made: BuiltDataset) -> None:
    keys = " ".join(made.dataset.protocol)
    named = "quer" in keys and ("reference" in keys or "database" in keys)
    require(named, f"the protocol names {keys or 'nothing'}; wanted are references and query too")


def _check_place_numbers(made: BuiltDataset) -> None:
    numbers = made.dataset.place_numbers
    ascend = numbers is None or (np.diff(numbers) > 0).all()
    require(ascend, "place_numbers do not ascend: number the places along the journey")


def _check_held_out(made: BuiltDataset) -> None:
    if made.dataset.held_out is None:
        return
    held_out, queries = made.dataset.held_out.queries, made.dataset.queries
    numbers = {name: i for i, name in enumerate(queries.names)}
    for i in _sample(held_out):
        name = held_out.names[i]
        same = name in numbers and np.array_equal(held_out[i], queries[numbers[name]])
        require(not same, f"the held-out query {name} is one of the queries: leave it out there")


def _check_notes(made: BuiltDataset) -> None:
    notes: Any = made.dataset.notes
    lines = isinstance(notes, tuple) and all(isinstance(note, str) and note.isprintable() for note in notes)
    require(lines, f"notes are {notes!r}; wanted is a tuple of lines")


def _sample(images: Images) -> list[int]:
    """Return the numbers of some images, spread over all."""
    return sorted({round(i) for i in np.linspace(0, len(images) - 1, _N_SAMPLES).tolist()})


def _is_row(numbers: npt.NDArray[Any]) -> bool:
    return isinstance(numbers, np.ndarray) and numbers.ndim == 1 and np.issubdtype(numbers.dtype, np.integer)


def _kind(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


#: The rules by the text that `check` prints, in its order.
DATASET_RULES: dict[str, Callable[[BuiltDataset], None]] = {
    "it is the same when it is made again": _check_again,
    "it has the name that was asked for": _check_name,
    "right places are whole numbers, ascending, each once": _check_positives,
    "most queries have a right place": _check_answerable,
    "no query is right everywhere": _check_wrong_places,
    "images are uint8 (height, width, 3)": _check_images,
    "images show something": _check_content,
    "images of a traverse have one size, or notes say so": _check_sizes,
    "an image is the same however it is read": _check_reading,
    "every image of a traverse has a name of its own": _check_names,
    "the protocol holds plain values": _check_protocol,
    "the protocol says what references and queries are": _check_protocol_keys,
    "place numbers ascend along the journey": _check_place_numbers,
    "held-out queries are none of the queries": _check_held_out,
    "notes are lines": _check_notes,
}
