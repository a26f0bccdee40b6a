"""How many places the codes and the layers of a learnt method still tell apart, whatever its answer makes of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from vprbench.metrics.intervals import share_interval
from vprbench.metrics.ranking import outcome
from vprbench.metrics.registry import METRICS
from vprbench.runs.answers import block_size
from vprbench.runs.notes import Note
from vprbench.runs.recall_intervals import along_the_journey
from vprbench.runs.record import Run
from vprbench.terminal.console import line_text, table_text

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


_ANSWER = "answer"


def readout_numbers(run: Run) -> list[dict[str, Any]] | None:
    """Return R@1 of each readout and of the answer, 0 to 1, with the ends of its 95 % interval as in the row.

    None if no layer was read; empty for a method without layers, and where no query has a right place.
    """
    if not run.readouts or not run.outcome.answerable.any():
        return None if run.readouts is None else []
    order = along_the_journey(run)
    answer = {"name": _ANSWER, "neurons": run.outcome.n_places, "hits": hits_at(run.outcome, 1)}
    return [_recall(readout, order) for readout in (*run.readouts, answer)]


def readout_text(run: Run) -> str:
    """Return the readouts of a run as a small table, or a line that says why there is none."""
    found = readout_numbers(run)
    if found:
        columns = ("readout", "neurons", "R@1 % [95 %]", *["time steps"] * any("steps" in each for each in found))
        return table_text(columns, [_row(readout)[: len(columns)] for readout in found])
    missing = f"{run.method} learns no layer that it shows" if run.readouts == [] else "see the notes"
    return line_text(f"readouts: none, {missing}")


def _recall(readout: Mapping[str, Any], order: npt.NDArray[np.int64]) -> dict[str, Any]:
    hits = np.asarray(readout["hits"], np.float64)[order]
    interval = share_interval(hits)
    assert interval is not None  # there are queries
    return {
        "name": readout["name"],
        "neurons": readout["neurons"],
        "recall_at_1": float(hits.mean()),
        "recall_at_1_low": interval.low,
        "recall_at_1_high": interval.high,
        **({"steps": float(np.mean(readout["steps"]))} if "steps" in readout else {}),
    }


def _row(readout: Mapping[str, Any]) -> list[str]:
    name, first = readout["name"], METRICS["recall_at_1"].text(readout["recall_at_1"])
    ends = f"[{100 * readout['recall_at_1_low']:.1f}, {100 * readout['recall_at_1_high']:.1f}]"
    steps = f"{readout['steps']:.4g}" if "steps" in readout else ""
    said = name if name == _ANSWER or steps else f"{name}, cosine"
    return [said, f"{readout['neurons']:,}", f"{first} {ends}", steps]
