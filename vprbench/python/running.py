"""One run in this process, as a function: prepared, then found in the store or made."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypedDict, Unpack, get_type_hints

from vprbench.api.method import Method
from vprbench.config import make_request
from vprbench.plugins.options import check_values
from vprbench.python.choices import AnyDataset, AnyMethod, Choice, as_plain, choose_dataset, choose_method
from vprbench.python.result import Result
from vprbench.report.plan import flatten_arguments
from vprbench.runs.experiment import Experiment, build_experiment
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store

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
    where, data = choose_dataset(dataset)
    request, make = request_run(method, where, options)
    return finish_run(build_experiment(request, data, make))


def request_run(
    method: AnyMethod, dataset: Choice, options: Options
) -> tuple[RunRequest, Callable[[Mapping[str, Any]], Method] | None]:
    """Return the request of a run, whose results folder is empty if nothing is stored, and what makes an object.

    Raises BadInput for a method and for options that do not fit.
    """
    given = check_values("", as_plain(options), get_type_hints(Options))
    chosen = choose_method(method, given)
    timing = given.pop("timing", "quick")
    if chosen.unstored_reason is not None and given.get("results", "") is not None:
        logger.warning("the run of %s will not be stored: %s", chosen.overrides[0], chosen.unstored_reason)
        given["results"] = None
    if given.get("results", "") is None:
        given |= {"results": "", "cache": False, "frames": False}
    values = {**given, **chosen.values, **dataset.values}
    named = [each.overrides[0] for each in (chosen, dataset) if not each.described]
    if isinstance(timing, str):
        named.append(f"timing={timing}")
    else:
        values |= flatten_arguments(timing, "timing.")
    per_run = [f"{name}={values[name]}" for name in ("corruption", "seed") if values.get(name) is not None]
    described = {**chosen.described, **dataset.described}
    overrides = [*chosen.overrides, *dataset.overrides, *per_run]
    return make_request(named, values, {**described, "overrides": overrides}), chosen.make


def finish_run(experiment: Experiment) -> Result:
    """Return the result of a run, from the store or made now; raises what the method raises."""
    dataset, request = experiment.dataset, experiment.request
    if request.results:
        found = get_or_run(experiment, Store(Path(request.results).expanduser()))
        return Result(found.run, found.folder, dataset.queries.names, found.from_store, dataset)
    with TemporaryDirectory(prefix="vprbench-") as folder:
        found = get_or_run(experiment, Store(Path(folder)))
    return Result(found.run, None, dataset.queries.names, dataset=dataset)
