"""The request of one run: method, dataset and options as plain values, which travel to other processes as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, Literal

from pydantic import Field

from vprbench.errors import BadInput
from vprbench.metrics.bounds import Positive
from vprbench.metrics.catalogue import GROUPS, METRICS, load_plug_in_metrics
from vprbench.runs.corruption import parse_corruptions
from vprbench.runs.predictions import require_depth
from vprbench.runs.sequences import Views, parse_views
from vprbench.runs.timing_protocol import Protocol
from vprbench.runs.viewpoints import parse_viewpoints
from vprbench.storage.cores import count_cores
from vprbench.text import suggest_names

#: The fields that a stored run holds of its request.
RECORDED = (
    *("method", "dataset", "changed", "overrides"),
    *("corruption", "views", "seed", "device", "depth", "load", "limit_minutes"),
)


@dataclass(frozen=True)
class RunRequest:
    """A method, a dataset and the options of a run, all resolved; raises BadInput for options that do not fit."""

    method_name: str
    method: dict[str, Any]  # its class as `_target_`, and all of its arguments
    dataset_name: str
    dataset: dict[str, Any]  # the function that makes it as `_target_`, and all of its arguments
    changed: dict[str, Any] = field(default_factory=dict)  # arguments of the method that differ from its yaml
    tuned_on: dict[str, Any] = field(default_factory=dict)  # places that the method's settings were chosen on
    overrides: list[str] = field(default_factory=list)  # the options of the command line that make the same request
    seed: Annotated[int, Field(ge=0)] = 0
    device: str = "cpu"
    threads: Positive | None = None  # None: all cores this process may use
    results: str = "results"
    force: bool = False
    cache: bool = True  # keep descriptors of networks, and take those of an earlier run
    output: Literal["row", "json"] = "row"
    wide: bool = False  # show all columns of the row
    metrics: list[str] = field(default_factory=list)  # more accuracies of row and JSON, by their names in METRICS
    depth: Positive = 100  # best places that are kept of each query
    scores: bool = False  # keep all scores, however many
    sequence: Any = None
    filter: Any = None
    views: Any = None  # viewpoints of each query
    frames: bool = True  # keep small pictures of the dataset, for figures and report
    limit_minutes: Annotated[float, Field(gt=0)] | None = None  # after which a run has failed; None: none
    corruption: str | list[str] | None = None  # of the query frames, as in shift-1; several: a run each, fitted once
    save: str | None = None  # file for the trained network
    load: str | None = None  # file of a trained network; nothing is trained then
    stream: bool | int = False  # grow the map place by place, and ask at each so many places; true: ten times
    predictions: int | None = None  # best places of each query that are written as CSV; None: no file
    energy: bool = False  # count operations and joules of a query, and bytes of a place
    debug: bool = False  # print the traceback of an error
    timing: Protocol = field(default_factory=Protocol)

    def __post_init__(self) -> None:
        """Check the options that depend on no machine and on no file."""
        metrics = spell_out_metrics(self.metrics)
        object.__setattr__(self, "metrics", metrics)
        object.__setattr__(self, "energy", self.energy or bool({*metrics} & {*GROUPS["energy"]}))
        self.list_views()
        if self.views is not None and parse_viewpoints(self.views) and (self.stream or self.energy):
            raise BadInput(f"views={self.views}: stream= and energy= are of one view a query, leave them out")
        if self.corruptions:
            parse_corruptions(self.corruptions)
        if isinstance(self.corruption, list) and (self.save, self.load) != (None, None):
            raise BadInput(f"corruption={','.join(self.corruption)}: save= and load= take a run of one corruption")
        if self.predictions is not None:
            require_depth(self.predictions, self.depth, self.predictions)
        if self.save is not None and self.load is not None:
            raise BadInput(f"save={self.save} and load={self.load}: a loaded network is stored already, give one")
        if self.method.get("device", self.device) != self.device:
            raise BadInput(f"method.device={self.method['device']} differs from device={self.device}: set device alone")
        if re.fullmatch(r"cpu|cuda(:\d+)?", self.device) is None:
            raise BadInput(f"device={self.device} is unknown: give cpu, cuda or cuda:1")
        if self.device != "cpu" and "_target_" in self.method and "device" not in self.method:
            kind = self.method["_target_"].rpartition(".")[2]
            raise BadInput(f"device={self.device}: {kind} computes on the CPU, it has no option device; use device=cpu")

    @property
    def corruptions(self) -> list[str]:
        """The corruptions of the request; none for clean frames."""
        several = [] if self.corruption is None else self.corruption
        return [several] if isinstance(several, str) else several

    @property
    def n_threads(self) -> int:
        """How many threads the run uses on this machine."""
        return self.threads or count_cores()

    def list_views(self) -> tuple[Views, ...]:
        """Return the sequences and the filter that are applied to the run."""
        return () if self.sequence is None and self.filter is None else parse_views(self.sequence, self.filter)

    def with_corruption(self, name: str) -> RunRequest:
        """Return the request of one corruption."""
        clean = [option for option in self.overrides if not option.startswith("corruption=")]
        return replace(self, corruption=name, overrides=[*clean, f"corruption={name}"])

    def record(self) -> dict[str, Any]:
        """Return the fields that a stored run holds."""
        return {name: getattr(self, name) for name in RECORDED}

    def to_json(self) -> str:
        """Return all fields as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> RunRequest:
        """Return the request of a JSON; raises BadInput for options that do not fit."""
        content = json.loads(text)
        return cls(**{**content, "timing": Protocol(**content["timing"])})

    def require_machine(self) -> None:
        """Raise BadInput for more threads than this process may use, and for a GPU that torch does not see."""
        available = count_cores()
        if self.threads is not None and self.threads > available:
            raise BadInput(f"threads={self.threads}: this process may use 1 to {available} cores")
        if self.device != "cpu":
            import torch

            if torch.cuda.device_count() <= int(self.device.partition(":")[2] or 0):
                raise BadInput(f"device={self.device}: torch sees {torch.cuda.device_count()} GPUs; use device=cpu")


#: The options of a run; those of its method and dataset are given as method.NAME and dataset.NAME.
OPTIONS = tuple(
    name
    for name in RunRequest.__dataclass_fields__
    if name not in ("method_name", "dataset_name", "changed", "tuned_on", "overrides")
)


def spell_out_metrics(names: Iterable[str]) -> list[str]:
    """Return names of metrics, those of a group in its place; raises BadInput for the first that is neither."""
    metrics = [one for name in names for one in GROUPS.get(name, (name,))]
    if not METRICS.keys() >= {*metrics}:
        load_plug_in_metrics()
    for name in metrics:
        if name not in METRICS:
            raise BadInput(f"metrics={name} is unknown: {suggest_names(name, [*METRICS, *GROUPS])}")
    return metrics
