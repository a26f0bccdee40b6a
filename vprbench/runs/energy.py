"""Costs of a fitted method: operations and joules of a query, bytes of a place of its map."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vprbench.api.arithmetic import Arithmetic, Kind, counting_operations
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.metrics.catalogue import METRICS
from vprbench.runs.experiment import Experiment
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import make_synchroniser
from vprbench.runs.timing_lock import TimingLock
from vprbench.terminal.console import format_table

Counters = list[tuple[int, int]]  # microjoules since an arbitrary moment, and at how many each begins anew
Cost = tuple[float | None, str]  # the value, None: not known, and its source, or why it is not known

POWERCAP = Path("/sys/class/powercap")
_SECONDS = 2.0  # of rest, and at least of queries; counters move every 1 to 100 ms
_QUERIES = 4  # over which arithmetic is averaged, at most

#: Picojoules of a single operation and of a multiply-add in 45 nm (Horowitz, ISSCC 2014); 64 bits are priced as 32.
PICOJOULES: Mapping[Kind, tuple[float, float]] = {
    **dict.fromkeys(("float64", "float32"), (0.9, 0.9 + 3.7)),
    **dict.fromkeys(("int64", "int32"), (0.1, 0.1 + 3.1)),
    "int8": (0.03, 0.1 + 0.2),  # summed in 32 bits
}


def estimate_joules(arithmetic: Iterable[Arithmetic]) -> float:
    """Return the joules of some arithmetic."""
    prices = [(each, *PICOJOULES[each.kind]) for each in arithmetic]
    return 1e-12 * sum(each.single * single + each.multiply_adds * both for each, single, both in prices)


def count_synops(spikes: Mapping[str, Any] | None) -> tuple[float, float] | None:
    """Return the accumulates and the multiply-accumulates of a query, from a run's `spikes`; None without any.

    NeuroBench's SynOps (2.3.0): a spike costs one for each synapse of a weight other than 0 that it reaches, an
    accumulate where all spikes are alike, a multiply-accumulate where they have amplitudes.
    """
    layers = [] if spikes is None else [layer for layer in spikes["layers"] if "synops" in layer]
    alike, graded = (sum(layer["synops"] for layer in layers if layer["operation"] == kind) for kind in ("AC", "MAC"))
    return (alike, graded) if layers else None


def read_rapl(root: Path) -> Counters:
    """Return the counters of processor and memory in Linux's powercap; raises OSError if none can be read."""
    # zones of these names do not lie within one another
    zones = [each for each in root.glob("*-rapl*:*") if (each / "name").read_text().startswith(("package", "dram"))]
    if not zones:
        raise FileNotFoundError(f"no counter in {root}")
    files = [(zone / "energy_uj", zone / "max_energy_range_uj") for zone in zones]
    return [(int(energy.read_text()), int(most.read_text())) for energy, most in files]


def read_nvml(device: str) -> Counters:
    """Return the counter of an NVIDIA GPU, Volta and later; raises pynvml's errors if it cannot be read."""
    import pynvml
    import torch

    pynvml.nvmlInit()
    uuid = torch.cuda.get_device_properties(device).uuid  # numbers of devices may differ from the driver's
    gpu = pynvml.nvmlDeviceGetHandleByUUID(f"GPU-{uuid}")
    return [(1000 * pynvml.nvmlDeviceGetTotalEnergyConsumption(gpu), 1 << 64)]


def measure_joules(read: Callable[[], Counters], ask: Callable[[], Any]) -> float:
    """Return the joules of a query beyond the idle machine; `ask` asks one and waits for the device.

    After a rest of 2 s queries follow one another for as long, or for as long as one takes.
    """

    def subtract(first: Counters, last: Counters) -> float:
        return 1e-6 * sum((new - old) % most for (old, _), (new, most) in zip(first, last, strict=True))

    ask()
    began, before = time.perf_counter(), read()
    time.sleep(_SECONDS)
    rested, idle, queries = time.perf_counter(), read(), 0
    while time.perf_counter() - rested < _SECONDS or not queries:
        ask()
        queries += 1
    ended, after = time.perf_counter(), read()
    idle_watts = subtract(before, idle) / (rested - began)
    return (subtract(idle, after) - idle_watts * (ended - rested)) / queries


def find_costs(experiment: Experiment, run: Run, lock: TimingLock) -> dict[str, Any]:
    """Return the costs of a query: `values` by name, None where one is not known, and `how` each was found or why not.

    The estimate prices encode and match, in the place of match the synaptic operations of a network that spikes.
    """
    method, queries = experiment.method, experiment.dataset.queries.unnamed()
    some = queries[np.linspace(0, len(queries) - 1, min(_QUERIES, len(queries))).astype(np.int64)].in_memory()
    singles = [some[n : n + 1] for n in range(len(some))]
    synops = count_synops(run.spikes)
    how = "no layer that spikes" if synops is None else "spikes x existing synapses"
    found = dict(zip(("synops_ac", "synops_mac"), ((count, how) for count in synops or (None, None)), strict=True))
    for names, find in (
        (("operations", "joules_estimated"), partial(_count_operations, method, singles, synops)),
        (("joules_measured",), partial(_measure_query, method, singles, experiment.request.device, lock)),
        (("map_bytes",), partial(_find_map_bytes, method, run)),
    ):
        try:
            costs = find()
        except Exception as error:  # a plug-in or a counter may fail in any way, and answers and times still stand
            costs = [(None, " ".join(f"{type(error).__name__}: {error}".split()))] * len(names)
        found |= zip(names, costs, strict=True)
    return {part: {name: cost[at] for name, cost in found.items()} for at, part in enumerate(("values", "how"))}


def format_costs(run: Run, wide: bool = False) -> str:
    """Return the costs of a run as a small table, `n/a` with its reason for an unknown cost."""
    found = run.energy or {"values": {}, "how": {}}
    shown = {name: "n/a" if cost is None else METRICS[name].text(cost) for name, cost in found["values"].items()}
    rows = [[METRICS[name].head, shown[name], found["how"][name]] for name in shown]
    return format_table(("cost", "", "how"), rows, wide)


def _count_operations(method: Method, singles: Sequence[Images], synops: tuple[float, float] | None) -> list[Cost]:
    """Return the operations of a query and the joules that they would take."""
    encodes, matches = list[Arithmetic](), list[Arithmetic]()
    for single in singles:
        codes, arithmetic = _count_call_operations(partial(method.encode, single))
        encodes += arithmetic
        if method.reference_mean is not None:
            codes = method.centre(codes, method.reference_mean)
        matches += _count_call_operations(partial(method.match, codes))[1]
    encode, match = (sum(one.operations for one in stage) / len(singles) for stage in (encodes, matches))
    if not encode or not match:
        unknown = f"{'match' if encode else 'encode'}: no formula, and no product of PyTorch"
        return [(None, unknown), (None, unknown)]
    kinds = "+".join(sorted({one.kind for one in encodes + matches}))
    stages = "encode and match"
    if synops is not None:
        stages = "encode and synaptic operations"
        matches = [Arithmetic(synops[1] * len(singles), synops[0] * len(singles), matches[0].kind)]
    joules = estimate_joules(encodes + matches) / len(singles)
    counted = encode + match, f"encode {encode:,.0f}, match {match:,.0f} ({kinds})"
    return [counted, (joules, f"{stages} in 45 nm, without memory")]


def _count_call_operations(work: Callable[[], Any]) -> tuple[Any, Sequence[Arithmetic]]:
    """Return the result of `work` and its arithmetic: by the method's formulas, or PyTorch's count if that is more."""
    from torch.utils.flop_counter import FlopCounterMode

    with counting_operations() as by_formulas, FlopCounterMode(display=False) as counter:
        result = work()
    by_torch = Arithmetic(counter.get_total_flops() / 2)
    return result, by_formulas if sum(one.operations for one in by_formulas) >= by_torch.operations else [by_torch]


def _measure_query(method: Method, singles: Sequence[Images], device: str, lock: TimingLock) -> list[Cost]:
    turns, wait = itertools.cycle(singles), make_synchroniser(device)
    on_gpu = device.startswith("cuda")
    read = partial(read_nvml, device) if on_gpu else partial(read_rapl, POWERCAP)

    def ask() -> None:
        method.query(next(turns))
        wait()

    read()  # before anybody waits
    with lock.hold_alone():
        joules = measure_joules(read, ask)
    return [(joules if joules > 0 else None, f"{'NVML' if on_gpu else 'RAPL'}, less the idle machine")]


def _find_map_bytes(method: Method, run: Run) -> list[Cost]:
    n_places = run.outcome.n_places
    if (stated := method.map_bytes()) is not None:
        return [(stated / n_places, "references or weights, a place")]
    if run.search is not None:
        return [(run.search["bytes_per_place"], f"index {run.search['index']}, a place")]
    n_bytes = sum(array.nbytes for array in method.state().values())
    return [(n_bytes / n_places, "the arrays that save= keeps, a place")]
