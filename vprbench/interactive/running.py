"""One run in this process, as a function: prepared, then found in the store or made."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypedDict, Unpack

from vprbench.errors import BadInput
from vprbench.interactive.choices import AnyDataset, AnyMethod, Place, Recipe, place, recipe
from vprbench.interactive.result import Result
from vprbench.plugins import registry
from vprbench.runs.build_request import request_of
from vprbench.runs.compose import composed_in_python
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.identity import Request
from vprbench.runs.settings import KNOWN, Settings, checked_settings
from vprbench.runs.store import Store
from vprbench.text import near

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
    Dataset, as `vprbench.dataset_of(...)` makes one. Raises BadInput for what does not fit, NotThere where weights or
    frames are missing, and what the method raises.
    """
    return finished(prepared(method, place(dataset), options))


@dataclass(frozen=True)
class Prepared:
    """A run whose method and dataset are built and checked."""

    request: Request
    settings: Settings
    store: Store | None  # None: nothing is stored


def prepared(method: AnyMethod, where: Place, options: Options) -> Prepared:
    """Build and check what a run needs; raises BadInput, NotThere."""
    for name in options:
        if name in KNOWN and name not in Options.__annotations__:
            raise BadInput(f"option {name} is the command line's, where each run has a process: leave it out")
        if name not in Options.__annotations__:
            raise BadInput(f"option {name} is unknown: {near(name, Options.__annotations__)}")
    if not isinstance(options.get("corruption"), str | None):
        raise BadInput(f"corruption={options['corruption']}: give one name, as in corruption='shift-1'")
    chosen = recipe(method, options.get("seed"), options.get("device"))
    stored = options.get("results", "results") is not None
    if stored and chosen.untold is not None:
        logger.warning("the run of %s will not be stored: %s", chosen.name, chosen.untold)
        stored = False
    settings, config = _settings(chosen, where, options, stored)
    store = Store(Path(settings.results).expanduser())
    method_config, tuned_on = registry.declared(chosen.name, config["method"])
    named = ("dataset", "corruption", "views", "seed", "device", "depth", "load", "limit_minutes")
    asked = {name: config[name] for name in named}
    asked |= {"method": method_config, "changed": dict(chosen.changed)}
    corrupted = [f"corruption={settings.corruption}"] * (settings.corruption is not None)
    asked |= {"overrides": [*chosen.overrides, *where.overrides, *corrupted, f"seed={settings.seed}"]}
    request = request_of(chosen.name, chosen.build, where.dataset, asked, settings, store, tuned_on)
    return Prepared(request, settings, store if stored else None)


def finished(ready: Prepared) -> Result:
    """Return the result of a run, from the store or made now; raises what the method raises."""
    dataset = ready.request.dataset
    queries = dataset.queries.names
    if ready.store is not None:
        found = get_or_run(ready.request, ready.settings, ready.store)
        return Result(found.run, found.folder, queries, found.from_store, dataset)
    with TemporaryDirectory(prefix="vprbench-") as folder:
        found = get_or_run(ready.request, ready.settings, Store(Path(folder)))
    return Result(found.run, None, queries, dataset=dataset)


def _settings(chosen: Recipe, where: Place, options: Options, stored: bool) -> tuple[Settings, dict[str, Any]]:
    """Return the settings of a run, and its configuration."""
    values: dict[str, Any] = {name: _plain(value) for name, value in options.items() if name != "timing"}
    values |= {name: chosen.config[name] for name in ("seed", "device") if name in chosen.config}
    timing = options.get("timing", "quick")
    if isinstance(timing, Mapping):
        values |= {f"timing.{name}": value for name, value in timing.items()}
    if not stored:
        values |= {"results": "", "cache": False, "frames": False}
    config = composed_in_python([f"timing={timing}"] if isinstance(timing, str) else [], values)
    config |= {"method": chosen.config, "dataset": where.config}
    return checked_settings(config), config


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value
