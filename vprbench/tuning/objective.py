"""What a trial does: train the method on one stretch of places under some settings, and ask it all queries there."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.adaptation import adapt_traverse
from vprbench.api.arrays import Places
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import TrainingDivergedError
from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.ranking import outcome
from vprbench.plugins import registry
from vprbench.runs import machine

StretchName = Literal["searched", "checked"]

_TOGETHER = 64  # images encoded together


@dataclass(frozen=True)
class Task:
    """Settings to try, and where."""

    stretch: StretchName
    values: Mapping[str, float]
    seed: int | None = None  # of the training; None: the method's own, which is the searched one


@dataclass(frozen=True)
class Tried:
    """How the queries of a stretch were answered; all are wrong if the training diverged."""

    hits: npt.NDArray[np.float64]  # (n_queries,), expected under ties
    sure_hits: npt.NDArray[np.float64]  # (n_queries,), 0 or 1, ties pessimistic: for a paired test
    diverged: str | None = None  # how the divergence was seen

    @property
    def recall_at_1(self) -> float:
        """The share of queries whose best place is right."""
        return float(self.hits.mean())


@dataclass(frozen=True)
class Training:
    """Tries settings on stretches whose codes lie in a folder."""

    folder: Path
    method: Mapping[str, Any]  # its configuration; settings replace arguments

    def __call__(self, task: Task) -> Tried:
        """Train the method under the settings of a task on one thread, and ask it all queries of the stretch."""
        machine.pin_threads(1)
        stretch = _Stretch.read(self.folder / task.stretch)
        seed = {} if task.seed is None else {"seed": task.seed}
        method = registry.make_method({**self.method, **task.values, **seed})
        # How an image becomes spikes is not searched: they were made once, for all trials, and stand in for images.
        vars(method)["encode"] = lambda images: stretch.references
        try:
            method.fit(Images.from_arrays([]), stretch.places)
        except TrainingDivergedError as error:
            nothing = np.zeros(len(stretch.queries))
            return Tried(nothing, nothing, str(error))
        ranked = outcome(method.match(adapt_traverse(method, stretch.queries)), stretch.positives)
        return Tried(hits_at(ranked, 1), hits_at(ranked, 1, "pessimistic"))


@dataclass(frozen=True)
class _Stretch:
    """What a method needs of a stretch: codes instead of images."""

    references: npt.NDArray[Any]  # (n_references, ...)
    places: Places  # (n_references,)
    queries: npt.NDArray[Any]  # (n_queries, ...)
    positives: list[npt.NDArray[np.int64]]  # per query the right places

    @classmethod
    def read(cls, folder: Path) -> _Stretch:
        """Map the arrays into memory, which all processes share."""
        # Copy-on-write, because PyTorch warns of arrays that it may not write.
        references, places, queries, right, counts = (
            np.load(folder / f"{name}.npy", mmap_mode="c", allow_pickle=False) for name in _ARRAYS
        )
        return cls(references, np.asarray(places), queries, np.split(np.asarray(right), np.cumsum(counts)[:-1]))


_ARRAYS = ("references", "places", "queries", "right_places", "right_places_per_query")


def keep(folder: Path, dataset: Dataset, method: Method) -> None:
    """Encode a stretch once for all trials, in `folder`; does nothing if the folder exists."""
    if folder.exists():
        return
    partial = folder.with_name(f".partial-{folder.name}")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    encoded = {
        "references": _encoded(dataset.references, method, f"drawing the references of the {folder.name} places"),
        "queries": _encoded(dataset.queries, method, f"drawing the queries of the {folder.name} places"),
        "places": dataset.places,
        "right_places": np.concatenate(dataset.positives),
        "right_places_per_query": np.array([len(right) for right in dataset.positives]),
    }
    for name, array in encoded.items():
        np.save(partial / f"{name}.npy", array, allow_pickle=False)
    partial.rename(folder)


def _encoded(images: Images, method: Method, stage: str) -> npt.NDArray[Any]:
    codes: list[npt.NDArray[Any]] = []
    for block in images.blocks(_TOGETHER):
        progress.report(stage, len(codes) * _TOGETHER / len(images))
        codes.append(np.array(method.encode(block)))  # a method may use its array again
    progress.report(stage, 1.0)
    return np.concatenate(codes)
