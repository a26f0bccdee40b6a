"""How many places the codes and the layers of a learnt method still tell apart, whatever its answer makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.search import Search
from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.ranking import outcome
from vprbench.runs.answers import block_size
from vprbench.runs.notes import Note

_CODES = "codes"

Vectors = npt.NDArray[np.float32]  # (n_images, n_neurons), unit vectors


def read(method: Method, dataset: Dataset) -> tuple[list[dict[str, Any]] | None, tuple[Note, ...]]:
    """Return what the cosines of a fitted method's codes and layers find, as plain values, and what went wrong.

    A place is worth its most similar reference, as in a search by descriptors. Of each readout: its `name`, its
    `neurons`, and for each query the chance `hits` that the best place is right; of answers in time the `steps`
    too. Empty for a method without layers.
    """
    if type(method).layers is Method.layers:
        return [], ()
    try:
        return _hits(method, dataset), ()
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        reason = " ".join(str(error).split())
        return None, (Note("readouts", f"no layer was read ({type(error).__name__}: {reason})"),)


def _hits(method: Method, dataset: Dataset) -> list[dict[str, Any]]:
    size = block_size(method, dataset.n_places)
    parts = [*_values(method, dataset.references.unnamed(), size)]
    maps = {name: Search(np.concatenate([_unit(part[name]) for part in parts]), dataset.places) for name in parts[0]}
    del parts
    found: dict[str, dict[str, Any]] = {}
    done = 0
    for block in _values(method, dataset.queries.unnamed(), size):
        right = dataset.positives[done : done + len(block[_CODES])]
        by_cosine = ((name, None, maps[name].scores(_unit(values))) for name, values in block.items())
        for name, steps, scores in chain(by_cosine, method.answers(block[_CODES])):
            neurons = maps[name].references.shape[1] if name in maps else scores.shape[1]
            readout = found.setdefault(name, {"name": name, "neurons": neurons, "hits": []})
            readout["hits"] += hits_at(outcome(scores, right), 1).tolist()
            if steps is not None:
                readout.setdefault("steps", []).extend(steps.tolist())
        done += len(right)
    return [*found.values()]


def _values(method: Method, images: Images, size: int) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """Yield the codes and layers of consecutive images."""
    done = 0
    for block in images.blocks(size):
        codes = np.asarray(method.encode(block))
        yield {_CODES: codes, **method.layers(codes)}
        done += len(block)
        progress.report("reading layers", done / len(images))


def _unit(values: npt.NDArray[Any]) -> Vectors:
    """Return unit vectors; what has no length stays so, and is as unlike one image as another."""
    rows = np.asarray(values, np.float32).reshape(len(values), -1)
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(lengths > 0, lengths, 1), np.float32)
