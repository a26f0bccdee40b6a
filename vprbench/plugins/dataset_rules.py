"""The rules for datasets, each a function that raises RuleBrokenError with what was seen."""

from __future__ import annotations

import json
import random
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset, has_ground_truth
from vprbench.api.images import Images
from vprbench.plugins.rules import RuleBrokenError, RuleExceptedError, sentence
from vprbench.text import plural, some, some_of

_SAMPLE = 8  # images of each traverse that are decoded


@dataclass(frozen=True)
class BuiltDataset:
    """A dataset, and what makes it again from its configuration."""

    dataset: Dataset
    again: Callable[[], Dataset]
    config: Mapping[str, Any]

    def parts(self) -> Iterator[tuple[str, Images]]:
        """Yield references and queries with their names."""
        yield from (("references", self.dataset.references), ("queries", self.dataset.queries))

    def samples(self) -> Iterator[tuple[str, Image]]:
        """Yield some images of each traverse with words for where they stand."""
        for part, images in self.parts():
            yield from ((f"{part}[{i}] ({images.names[i]})", images[i]) for i in _sample(images))


DATASET_RULES: dict[str, Callable[[BuiltDataset], None]] = {}  # by what they say


def dataset_rule(test: Callable[[BuiltDataset], None]) -> Callable[[BuiltDataset], None]:
    """Put a function among the rules for datasets, in the order of the file."""
    DATASET_RULES[sentence(test)] = test
    return test


@dataset_rule
def _same_when_made_again(made: BuiltDataset) -> None:
    """It is the same when it is made again."""
    first, second = made.dataset, made.again()
    for what in ("name", "n_places", "protocol", "notes"):
        if getattr(first, what) != getattr(second, what):
            _broken(f"{what} is {getattr(first, what)}, and {getattr(second, what)} when it is made again")
    for part, images in made.parts():
        others: Images = getattr(second, part)
        chosen = np.array(_sample(images))
        if images.names != others.names or images[chosen].fingerprint() != others[chosen].fingerprint():
            _broken(f"{part} are others when it is made again: draw from a seed, and sort what a folder lists")
    truth = zip((first.places, *first.positives), (second.places, *second.positives), strict=True)
    if not all(np.array_equal(one, other) for one, other in truth):
        _broken("places or ground truth are others when it is made again")


@dataset_rule
def _named(made: BuiltDataset) -> None:
    """It has the name that was asked for."""
    wanted = made.config.get("name", made.dataset.name)
    if made.dataset.name != wanted:
        _broken(f"name={wanted} was asked for, but it is {made.dataset.name}")


@dataset_rule
def _places(made: BuiltDataset) -> None:
    """Place ids are whole numbers."""
    places = made.dataset.places
    if not _is_row(places):
        _broken(f"places are {_kind(places)}; wanted is an array of whole numbers, (n_references,)")


@dataset_rule
def _right(made: BuiltDataset) -> None:
    """Right places are whole numbers, ascending, each once."""
    for query, right in enumerate(made.dataset.positives):
        if not _is_row(right) and len(right):
            _broken(f"the right places of query {query} are {_kind(right)}; wanted is an array of whole numbers")
        if (np.diff(right) <= 0).any():
            _broken(f"the right places of query {query} are {some(list(right))}: name each once, ascending")


@dataset_rule
def _answerable(made: BuiltDataset) -> None:
    """Most queries have a right place."""
    right = made.dataset.positives
    if not has_ground_truth(made.dataset.protocol):
        raise RuleExceptedError("there is no ground truth, and no answer is judged")
    without = sum(not len(places) for places in right)
    if 2 * without > len(right):
        _broken(f"{without} of {len(right)} queries have no right place: does the ground truth fit the map?")


@dataset_rule
def _asks(made: BuiltDataset) -> None:
    """No query is right everywhere."""
    everywhere = [q for q, right in enumerate(made.dataset.positives) if len(right) == made.dataset.n_places > 1]
    if everywhere:
        _broken(f"for {len(everywhere)} queries every place is right: is the tolerance too wide?")


@dataset_rule
def _rgb(made: BuiltDataset) -> None:
    """Images are uint8 (height, width, 3)."""
    for where, image in made.samples():
        wrong = not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3
        if wrong or image.shape[2] != 3 or not image.size:
            _broken(f"{where} is {_kind(image)}; wanted is uint8 (height, width, 3)")


@dataset_rule
def _show(made: BuiltDataset) -> None:
    """Images show something."""
    plain = [bool((image == image.reshape(-1, image.shape[-1])[0]).all()) for _, image in made.samples()]
    if 2 * sum(plain) > len(plain):
        _broken(f"{sum(plain)} of {len(plain)} images that were looked at have one colour all over")


@dataset_rule
def _one_size(made: BuiltDataset) -> None:
    """Images of a traverse have one size, or notes say so."""
    for part, images in made.parts():
        sizes = {f"{image.shape[1]}x{image.shape[0]}" for image in (images[i] for i in _sample(images))}
        told = any("size" in note for note in made.dataset.notes)
        if len(sizes) > 1:
            text = f"{part} have sizes {some(sorted(sizes))}"
            if told or images[:1].file_hashes() is not None:
                raise RuleExceptedError(f"{text}, as the files have")
            _broken(f"{text}: give them one, or say so in the dataset's notes")


@dataset_rule
def _same_image(made: BuiltDataset) -> None:
    """An image is the same however it is read."""
    for part, images in made.parts():
        sample = _sample(images)
        view, unnamed = images[np.array(sample)], images.unnamed()
        for i, in_a_row in zip(sample, view, strict=True):  # which is read ahead by threads
            first = np.array(images[i], copy=True)
            for way, other in {
                "read again": images[i],
                "in a slice": images[i : i + 1][0],
                "counted from the end": images[i - len(images)],
                "in a row of others": in_a_row,
                "without its name": unnamed[i],
            }.items():
                if not np.array_equal(first, other):
                    _broken(f"{part}[{i}] ({images.names[i]}) is another image {way}")


@dataset_rule
def _names(made: BuiltDataset) -> None:
    """Every image of a traverse has a name of its own."""
    for part, images in made.parts():
        often = Counter(images.names)
        twice = sorted(name for name in often if not name or often[name] > 1)
        if twice:
            text = f"{plural(len(twice), 'name')} of {part} stand for several images or none ({some_of(twice)})"
            if sum(twice[0] in folder.used for folder in made.dataset.folders) >= often[twice[0]]:
                raise RuleExceptedError(f"{text}, as the files in several folders have them")
            _broken(text)


@dataset_rule
def _plain(made: BuiltDataset) -> None:
    """The protocol holds plain values."""
    protocol = made.dataset.protocol
    try:
        kept = json.loads(json.dumps(dict(protocol), allow_nan=False))
    except (TypeError, ValueError) as error:
        _broken(f"the protocol is no JSON: {error}")
    changed = [name for name in protocol if kept.get(name) != protocol[name]]
    if changed:
        _broken(
            f"{changed[0]} of the protocol is {protocol[changed[0]]!r}; JSON would make it {kept.get(changed[0])!r}"
        )


@dataset_rule
def _protocol_names_both(made: BuiltDataset) -> None:
    """The protocol says what references and queries are."""
    keys = " ".join(made.dataset.protocol)
    if "quer" not in keys or not any(word in keys for word in ("reference", "database")):
        _broken(f"the protocol says of {keys or 'nothing'}; wanted are references and query too")


@dataset_rule
def _journey(made: BuiltDataset) -> None:
    """Place numbers ascend along the journey."""
    numbers = made.dataset.place_numbers
    if numbers is not None and (np.diff(numbers) <= 0).any():
        _broken("place_numbers do not ascend: number the places along the journey")


@dataset_rule
def _held_out(made: BuiltDataset) -> None:
    """Held-out queries are none of the queries."""
    held_out, queries = made.dataset.held_out, made.dataset.queries
    if held_out is None:
        return
    where = {name: i for i, name in enumerate(queries.names)}
    for i, name in ((i, held_out.queries.names[i]) for i in _sample(held_out.queries)):
        if name in where and np.array_equal(held_out.queries[i], queries[where[name]]):
            _broken(f"the held-out query {name} is one of the queries: results may ask none of these")


@dataset_rule
def _leaves(made: BuiltDataset) -> None:
    """Reading leaves the working folder and random numbers alone."""
    folder, numbers, numpy_numbers = Path.cwd(), random.getstate(), repr(np.random.get_state())  # noqa: NPY002
    again = made.again()
    for images in (again.references, again.queries):
        list(images[np.array(_sample(images))])
    if Path.cwd() != folder:
        _broken(f"the working folder is {Path.cwd()} after reading, and was {folder}")
    if random.getstate() != numbers or repr(np.random.get_state()) != numpy_numbers:  # noqa: NPY002
        _broken("the random numbers of the whole program are others after reading: use numpy.random.default_rng(seed)")


@dataset_rule
def _lines(made: BuiltDataset) -> None:
    """Notes are lines."""
    notes: Any = made.dataset.notes
    if not isinstance(notes, tuple) or not all(isinstance(note, str) and note.isprintable() for note in notes):
        _broken(f"notes are {notes!r}; wanted is a tuple of lines")


def _sample(images: Images) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, len(images) - 1, _SAMPLE).tolist()})


def _is_row(numbers: npt.NDArray[Any]) -> bool:
    return isinstance(numbers, np.ndarray) and numbers.ndim == 1 and np.issubdtype(numbers.dtype, np.integer)


def _kind(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def _broken(message: str) -> None:
    raise RuleBrokenError(message)
