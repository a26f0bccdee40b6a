"""What a query of a fitted method costs in operations and joules, and a place of its map in bytes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from vprbench.api.arithmetic import Arithmetic, tallied
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.metrics.energy import estimated_joules, synaptic_operations
from vprbench.metrics.registry import METRICS
from vprbench.run import joules, slot
from vprbench.run.identity import Request
from vprbench.run.record import Run
from vprbench.run.stopwatch import synchroniser
from vprbench.terminal.console import table_text

_QUERIES = 4  # over which arithmetic is averaged, at most
_UNKNOWN = "no formula is told, and PyTorch multiplies nothing"

Found = dict[str, tuple[float | None, str]]  # by name a value, None: not known, and how it was found or why not


def costs(request: Request, run: Run) -> dict[str, Any]:
    """Return what a run keeps of costs: `values` by name, None where one is not known, and `how` it was found or why.

    The estimate prices encode and match; in the place of match the synaptic operations of a network that spikes.
    """
    queries = request.dataset.queries.unnamed()
    chosen = queries[np.linspace(0, len(queries) - 1, min(_QUERIES, len(queries))).astype(np.int64)].in_memory()
    found = _synops(run)
    try:
        found |= _operations(request.method, chosen, synaptic_operations(run.spikes))
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        why = " ".join(f"not counted ({type(error).__name__}: {error})".split())
        found |= dict.fromkeys(("operations", "joules_estimated"), (None, why))
    found["map_bytes"] = _map_bytes(request.method, run)
    told = _measured(request, chosen)
    found["joules_measured"] = told[:2]
    values, how = ({name: each[part] for name, each in found.items()} for part in (0, 1))
    return {"values": values, "how": how, "meter": told[2]}


def text(run: Run) -> str:
    """Return the costs of a run as a small table, `n/a` with its reason for what is not known."""
    found = run.energy or {"values": {}, "how": {}}
    rows = [
        [METRICS[name].head, "n/a" if value is None else METRICS[name].text(value), found["how"][name]]
        for name, value in found["values"].items()
    ]
    return table_text(("cost", "a query", "how"), rows)


def _synops(run: Run) -> Found:
    found = synaptic_operations(run.spikes)
    names = ("synops_ac", "synops_mac")
    if found is None:
        return dict.fromkeys(names, (None, "no layer that spikes"))
    return {name: (each, "spikes x existing synapses") for name, each in zip(names, found, strict=True)}


def _operations(method: Method, queries: Images, synops: tuple[float, float] | None) -> Found:
    """Return the operations of encode and match, and the joules that they would take; the queries are asked for it."""
    encodes, matches = list[Arithmetic](), list[Arithmetic]()
    for n in range(len(queries)):
        codes, one = _counted(lambda n=n: method.encode(queries[n : n + 1]))
        encodes += one
        matches += _counted(lambda codes=codes: method.match(codes))[1]
    encode, match = (sum(each.operations for each in step) / len(queries) for step in (encodes, matches))
    steps = f"encode {encode:,.0f}, match {match:,.0f}; {'+'.join(sorted({each.kind for each in encodes + matches}))}"
    lacking = [f"{name}: {_UNKNOWN}" for name, step in (("encode", encode), ("match", match)) if not step]
    total = (None, "; ".join(lacking)) if lacking else (encode + match, f"{steps}, formulas or PyTorch's count")
    if synops is not None and matches:
        matches = [Arithmetic(synops[1] * len(queries), synops[0] * len(queries), matches[0].kind)]
    estimate = estimated_joules(encodes + matches) / len(queries)
    how = f"an estimate: 45 nm table, encode and {'match' if synops is None else 'synaptic operations'}, no memory"
    return {"operations": total, "joules_estimated": (None, total[1]) if lacking else (estimate, how)}


def _counted(work: Callable[[], Any]) -> tuple[Any, Sequence[Arithmetic]]:
    """Return what work gives and its arithmetic: by formulas that are told, or as PyTorch counts products if more."""
    from torch.utils.flop_counter import FlopCounterMode

    with tallied() as told, FlopCounterMode(display=False) as counter:
        result = work()
    by_torch = Arithmetic(counter.get_total_flops() / 2)
    return result, told if sum(each.operations for each in told) >= by_torch.operations else [by_torch]


def _map_bytes(method: Method, run: Run) -> tuple[float | None, str]:
    if (stated := method.map_bytes()) is not None:
        return stated / run.outcome.n_places, "references or weights, a place"
    if run.search is not None:
        return run.search["bytes_per_place"], f"index {run.search['index']}, a place"
    try:
        return sum(
            array.nbytes for array in method.state().values()
        ) / run.outcome.n_places, "what save= keeps, a place"
    except BadInput:
        return None, "the method does not tell what its map holds"


def _measured(request: Request, queries: Images) -> tuple[float | None, str, dict[str, Any] | None]:
    device = request.config["device"]
    try:
        meter = joules.meter(device)
    except joules.UnreadableError as error:
        return None, str(error), None
    singles = itertools.cycle([queries[n : n + 1] for n in range(len(queries))])
    with slot.alone():
        told = joules.measured(meter, lambda: request.method.query(next(singles)), synchroniser(device))
    how = f"{meter.source}, {told.watts:.1f} W less {told.idle_watts:.1f} W of the idle machine"
    return (told.joules if told.joules > 0 else None), how, asdict(told)
