"""One run in this process, as a function: prepared, then found in the store or made."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypedDict, Unpack

from vprbench.api.dataset import Dataset
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.python.choices import AnyDataset, AnyMethod, Choice, choose_dataset, choose_method
from vprbench.python.result import Result
from vprbench.runs.experiment import Experiment, build_experiment
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.request import OPTIONS
from vprbench.runs.store import Store
from vprbench.text import suggest_names

logger = logging.getLogger(__name__)


class Options(TypedDict, total=False):
    """How and where to run; those of the method and the dataset are given with these."""

    seed: int  # 0, or that of the object
    device: str  # "cpu", "cuda" or "cuda:1"
    threads: int | None  # None: all cores that this process may use
    timing: str | Mapping[str, Any]  # "quick", "standard", "publish", "none", or single options of the timing
    results: str | Path | None  # folder of the stored runs, "results"; None: nothing is stored or looked up
    force: bool  # run although the answer is stored
    cache: bool  # keep descriptors of networks, and take those of an earlier run
    depth: int  # best places kept for each query, 100
    scores: bool  # keep all scores, however many; those of small runs are kept anyway
    energy: bool  # count what a query and a place cost
    corruption: str | None  # of the query frames, as in "shift-1"; None: they are clean
    views: Sequence[float] | Mapping[str, Any] | None  # shifts in widths of the frame: viewpoints of each query
    save: str | Path | None  # file for the trained network
    load: str | Path | None  # file of a trained network: nothing is trained then


def run(method: AnyMethod, dataset: AnyDataset, **options: Unpack[Options]) -> Result:
    """Run a method on a dataset in this process, or find the stored run; see `Options` for the options.

    `method` is a registered name, `vprbench.method(...)`, or an object whose class subclasses `vprbench.api.Method`;
    it may come from a notebook, and is not fitted itself. `dataset` is a registered name, `vprbench.dataset(...)`, or a
    Dataset, as `vprbench.dataset_of(...)` makes one. Raises BadInput for values that do not fit, MissingData where
    weights or frames are missing, and what the method raises.
    """
    return finish(prepare(method, choose_dataset(dataset), options))


def prepare(method: AnyMethod, data: tuple[Choice, Dataset], options: Options) -> Experiment:
    """Build and check a run whose results folder is empty if nothing is stored; raises BadInput, MissingData."""
    for name in options:
        if name in OPTIONS and name not in Options.__annotations__:
            raise BadInput(f"option {name} is the command line's, where each run has a process: leave it out")
        if name not in Options.__annotations__:
            raise BadInput(f"option {name} is unknown: {suggest_names(name, Options.__annotations__)}")
    if not isinstance(options.get("corruption"), str | None):
        raise BadInput(f"corruption={options['corruption']}: give one name, as in corruption='shift-1'")
    chosen = choose_method(method, options.get("seed"), options.get("device"))
    where, dataset = data
    values: dict[str, Any] = {name: str(each) if isinstance(each, Path) else each for name, each in options.items()}
    timing = values.pop("timing", "quick")
    if isinstance(timing, Mapping):
        values |= {f"timing.{name}": value for name, value in timing.items()}
    if chosen.unstored_reason is not None and values.get("results", "results") is not None:
        logger.warning("the run of %s will not be stored: %s", chosen.name, chosen.unstored_reason)
        values["results"] = None
    if values.get("results", "results") is None:
        values |= {"results": "", "cache": False, "frames": False}
    values |= {**chosen.values, **where.values}
    named = [*chosen.options, *where.options, *([f"timing={timing}"] if isinstance(timing, str) else [])]
    per_run = [f"{name}={values[name]}" for name in ("corruption", "seed") if values.get(name) is not None]
    described = {**chosen.described, **where.described, "overrides": [*chosen.overrides, *where.overrides, *per_run]}
    return build_experiment(make_request(named, values, described), dataset, chosen.make)


def finish(experiment: Experiment) -> Result:
    """Return the result of a run, from the store or made now; raises what the method raises."""
    dataset, request = experiment.dataset, experiment.request
    if request.results:
        found = get_or_run(experiment, Store(Path(request.results).expanduser()))
        return Result(found.run, found.folder, dataset.queries.names, found.from_store, dataset)
    with TemporaryDirectory(prefix="vprbench-") as folder:
        found = get_or_run(experiment, Store(Path(folder)))
    return Result(found.run, None, dataset.queries.names, dataset=dataset)
