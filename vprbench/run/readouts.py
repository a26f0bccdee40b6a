"""How many places the codes and the layers of a learnt method still tell apart, whatever its answer makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.search import Search
from vprbench.api.stepwise import StepwiseMethod
from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.ranking import Outcome, concatenate, outcome
from vprbench.run.answers import block_size
from vprbench.run.note import Note

_CODES = "codes"

Vectors = npt.NDArray[np.float32]  # (n_images, n_neurons), unit vectors


def read(method: Method, dataset: Dataset) -> tuple[list[dict[str, Any]] | None, tuple[Note, ...]]:
    """Return what the cosines of a fitted method's codes and layers find, as plain values, and what went wrong.

    A place is worth its most similar reference, as in a search by descriptors. Of each readout: its `name`, its
    `neurons`, and for each query the chance `hits` that the best place is right; of each answer of a stepwise method
    the mean number of `steps` too. Empty for a method without layers.
    """
    if type(method).layers is Method.layers:
        return [], ()
    try:
        return _hits(method, dataset) + (_in_time(method, dataset) if isinstance(method, StepwiseMethod) else []), ()
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        reason = " ".join(str(error).split())
        return None, (Note("readouts", f"no layer was read ({type(error).__name__}: {reason})"),)


def _hits(method: Method, dataset: Dataset) -> list[dict[str, Any]]:
    size = block_size(method, dataset.n_places)
    parts = [*_vectors(method, dataset.references.unnamed(), size)]
    maps = {name: Search(np.concatenate([part[name] for part in parts]), dataset.places) for name in parts[0]}
    del parts
    outcomes: dict[str, list[Outcome]] = {name: [] for name in maps}
    done = 0
    for block in _vectors(method, dataset.queries.unnamed(), size):
        for name, vectors in block.items():
            right = dataset.positives[done : done + len(vectors)]
            outcomes[name].append(outcome(maps[name].scores(vectors), right))
        done += len(vectors)
    return [
        {
            "name": name,
            "neurons": maps[name].references.shape[1],
            "hits": hits_at(concatenate(found), 1).tolist(),
        }
        for name, found in outcomes.items()
    ]


def _in_time(method: StepwiseMethod, dataset: Dataset) -> list[dict[str, Any]]:
    found: dict[str, tuple[list[float], list[int]]] = {}
    done = 0
    for block in dataset.queries.unnamed().blocks(block_size(method, dataset.n_places)):
        right = dataset.positives[done : done + len(block)]
        for name, taken, scores in method.answers(np.asarray(method.encode(block))):
            hits, steps = found.setdefault(name, ([], []))
            hits += hits_at(outcome(scores, right), 1).tolist()
            steps += taken.tolist()
        done += len(block)
        progress.report("asking step by step", done / len(dataset.queries))
    return [
        {"name": name, "neurons": dataset.n_places, "hits": hits, "steps": float(np.mean(steps))}
        for name, (hits, steps) in found.items()
    ]


def _vectors(method: Method, images: Images, size: int) -> Iterator[dict[str, Vectors]]:
    """Yield the codes and layers of consecutive images."""
    done = 0
    for block in images.blocks(size):
        codes = np.asarray(method.encode(block))
        yield {name: _unit(values) for name, values in {_CODES: codes, **method.layers(codes)}.items()}
        done += len(block)
        progress.report("reading layers", done / len(images))


def _unit(values: npt.NDArray[Any]) -> Vectors:
    """Return unit vectors; what has no length stays so, and is as unlike one image as another."""
    rows = np.asarray(values, np.float32).reshape(len(values), -1)
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(lengths > 0, lengths, 1), np.float32)
