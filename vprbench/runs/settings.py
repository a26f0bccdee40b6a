"""The options of a run that belong neither to its method nor to its dataset, checked."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_type_hints

from vprbench.errors import BadInput
from vprbench.metrics.registry import GROUPS, METRICS
from vprbench.plugins import registry
from vprbench.runs.corruption import corruptions
from vprbench.runs.predictions import require_depth
from vprbench.runs.sequences import views
from vprbench.runs.timing_protocol import Protocol
from vprbench.runs.viewpoints import viewpoints
from vprbench.storage.folders import require_homes
from vprbench.storage.owner import core_count


@dataclass(frozen=True)
class Settings:
    """How and where to run, and what to print."""

    seed: int = 0
    device: str = "cpu"
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"
    force: bool = False
    cache: bool = True  # keep descriptors of networks and rendered frames, and take those of an earlier run
    output: Literal["row", "json"] = "row"
    wide: bool = False  # show all columns of the row
    metrics: list[str] = field(default_factory=list)  # more accuracies of row and JSON, by their names in METRICS
    depth: int = 100
    scores: bool = False  # keep all scores, however many
    sequence: Any = None
    filter: Any = None
    views: Any = None  # viewpoints from which each query is asked
    frames: bool = True  # keep small pictures of the dataset, for figures and report
    limit_minutes: float | None = None  # after which a run has failed; None: none
    corruption: str | list[str] | None = None  # of the query frames, as in shift-1; several: a run each, fitted once
    save: str | None = None  # file for the trained network
    load: str | None = None  # file of a trained network; nothing is trained then
    stream: bool | int = False  # grow the map place by place, and ask at each so many places; true: ten times
    readouts: bool = False  # what the codes and the layers of a learnt method find on their own
    predictions: int | None = None  # best places of each query that are written as CSV; None: no file
    energy: bool = False  # what a query costs in operations and joules, and a place in bytes
    timing: Protocol = field(default_factory=Protocol)


KNOWN = (*Settings.__dataclass_fields__, "method", "dataset")

#: What a record tells of how a run was asked for.
RECORDED = ("method", "dataset", "corruption", "views", "seed", "device", "depth", "load", "limit_minutes")


def checked_settings(config: Mapping[str, Any]) -> Settings:
    """Return the settings of a configuration; raises BadInput that names the option that does not fit."""
    for name in (*config, *KNOWN):
        if name not in KNOWN:
            raise BadInput(f"option {name} is unknown: {registry.near(name, KNOWN)}")
        if name not in config:
            raise BadInput(f"option {name} is missing: leave its default in place")
    require_homes(config)
    timing = _checked_timing(config["timing"])
    hints = get_type_hints(Settings)
    plain = {name: registry.checked(name, config[name], hints[name]) for name in hints if name != "timing"}
    plain["metrics"] = require_metrics(plain["metrics"])
    plain["energy"] |= bool({*plain["metrics"]} & {*GROUPS["energy"]})
    settings = Settings(**plain, timing=timing)
    views(settings.sequence, settings.filter)
    if viewpoints(settings.views) is not None and (settings.stream or settings.energy):
        raise BadInput(f"views={settings.views}: stream= and energy= are of one view a query, leave them out")
    if settings.corruption is not None:
        corruptions([settings.corruption] if isinstance(settings.corruption, str) else settings.corruption)
    if isinstance(settings.corruption, list) and (settings.save, settings.load) != (None, None):
        raise BadInput(f"corruption={','.join(settings.corruption)}: save= and load= take a run of one corruption")
    if settings.depth < 1:
        raise BadInput(f"depth={settings.depth}: keep at least the best place of each query")
    if settings.predictions is not None:
        require_depth(settings.predictions, settings.depth, settings.predictions)
    if settings.seed < 0:
        raise BadInput(f"seed={settings.seed}: give 0 or a larger number")
    if settings.limit_minutes is not None and not settings.limit_minutes > 0:
        raise BadInput(f"limit_minutes={settings.limit_minutes}: give more than 0, or null for no limit")
    available = core_count()
    if settings.threads is not None and not 1 <= settings.threads <= available:
        raise BadInput(f"threads={settings.threads}: this process may use 1 to {available} cores")
    if settings.save is not None and settings.load is not None:
        raise BadInput(
            f"save={settings.save} and load={settings.load}: what is loaded is stored already, give one of them"
        )
    _check_device(settings.device, config["method"])
    return settings


def require_metrics(names: Iterable[str]) -> list[str]:
    """Return names of metrics, those of a group in its place; raises BadInput for the first that is neither."""
    spelt_out = [one for name in names for one in GROUPS.get(name, (name,))]
    for name in spelt_out:
        if name not in METRICS:
            raise BadInput(f"metrics={name} is unknown: {registry.near(name, [*METRICS, *GROUPS])}")
    return spelt_out


def n_threads(settings: Settings) -> int:
    """Return how many threads a run uses."""
    return settings.threads or core_count()


def timings() -> list[str]:
    """Return the names of the timing protocols in conf/timing."""
    return sorted(path.stem for path in (registry.conf_folders()["vprbench"] / "timing").glob("*.yaml"))


def _checked_timing(config: Any) -> Protocol:
    if not isinstance(config, Mapping):
        raise BadInput(f"timing={config}: give {', '.join(timings())}, or one option, as in timing.minimum_seconds=10")
    hints = get_type_hints(Protocol, include_extras=True)
    for name in config:
        if name not in hints:
            raise BadInput(f"option timing.{name} is unknown: {registry.near(name, hints)}")
    return Protocol(**{name: registry.checked(f"timing.{name}", config[name], hints[name]) for name in config})


def _check_device(device: str, method: Any) -> None:
    if isinstance(method, Mapping) and method.get("device", device) != device:
        raise BadInput(f"method.device={method['device']} differs from device={device}: set device alone, for both")
    if re.fullmatch(r"cpu|cuda(:\d+)?", device) is None:
        raise BadInput(f"device={device} is unknown: give cpu, cuda or cuda:1")
    if device != "cpu":
        if isinstance(method, Mapping) and "_target_" in method and "device" not in method:
            kind = method["_target_"].rpartition(".")[2]
            raise BadInput(f"device={device}: {kind} has no argument device, it computes on the CPU; use device=cpu")
        import torch

        if torch.cuda.device_count() <= int(device.partition(":")[2] or 0):
            raise BadInput(f"device={device}: torch sees {torch.cuda.device_count()} GPUs here; use device=cpu")
