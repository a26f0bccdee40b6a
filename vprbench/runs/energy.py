"""What a query of a fitted method costs in operations and joules, and a place of its map in bytes."""

from __future__ import annotations

import ctypes
import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arithmetic import Arithmetic, Kind, tallied
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.metrics.registry import METRICS
from vprbench.runs import timing_lock
from vprbench.runs.experiment import Experiment
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import synchroniser
from vprbench.terminal.console import table_text

#: Picojoules of a single operation and of a multiply-add in 45 nm (Horowitz, ISSCC 2014); 64 bits are priced as 32.
PICOJOULES: Mapping[Kind, tuple[float, float]] = {
    **dict.fromkeys(("float64", "float32"), (0.9, 0.9 + 3.7)),
    **dict.fromkeys(("int64", "int32"), (0.1, 0.1 + 3.1)),
    "int8": (0.03, 0.1 + 0.2),  # summed in 32 bits
}


def estimated_joules(arithmetic: Iterable[Arithmetic]) -> float:
    """Return the joules of some arithmetic."""
    prices = [(each, *PICOJOULES[each.kind]) for each in arithmetic]
    return 1e-12 * sum(each.single * single + each.multiply_adds * both for each, single, both in prices)


def synaptic_operations(spikes: Mapping[str, Any] | None) -> tuple[float, float] | None:
    """Return the accumulates and the multiply-accumulates of a query, of what a run keeps of spikes; None without any.

    NeuroBench's SynOps (2.3.0): a spike costs one for each synapse of a weight other than 0 that it reaches, an
    accumulate where all spikes are alike, a multiply-accumulate where they have amplitudes.
    """
    layers = [] if spikes is None else [layer for layer in spikes["layers"] if "synops" in layer]
    alike, graded = (sum(layer["synops"] for layer in layers if layer["operation"] == kind) for kind in ("AC", "MAC"))
    return (alike, graded) if layers else None


POWERCAP = Path("/sys/class/powercap")
_SECONDS = 2.0  # of rest, and at least of queries; counters move every 1 to 100 ms

Joules = Callable[[], float]  # since an arbitrary moment


class UnreadableError(Exception):
    """No counter of energy can be read; the message says why."""


def rapl(root: Path) -> tuple[str, Joules]:
    """Return the sum of the counters of Linux's powercap, right if asked before one wraps around a second time.

    They count whatever runs there. Raises UnreadableError where there is none, or where they may not be read.
    """
    try:  # domains that do not lie within one another
        names = {zone: (zone / "name").read_text().strip() for zone in sorted(root.glob("*-rapl*:*"))}
        zones = [zone for zone, name in names.items() if name.startswith(("package", "dram"))]
        ranges = [int((zone / "max_energy_range_uj").read_text()) for zone in zones]
        last = [int((zone / "energy_uj").read_text()) for zone in zones]
    except (OSError, ValueError) as error:
        raise UnreadableError(f"RAPL cannot be read in {root} ({getattr(error, 'strerror', error)})") from None
    if not zones:
        raise UnreadableError(f"{root} has no RAPL counter")
    microjoules = 0

    def joules() -> float:
        nonlocal last, microjoules
        now = [int((zone / "energy_uj").read_text()) for zone in zones]
        microjoules += sum((new - old) % most for new, old, most in zip(now, last, ranges, strict=True))
        last = now
        return microjoules / 1e6

    return f"RAPL {', '.join(names[zone] for zone in zones)}", joules


def nvml(device: str) -> tuple[str, Joules]:
    """Return the energy counter of an NVIDIA GPU (Volta and later); raises UnreadableError where it has none."""
    import torch

    gpu, millijoules = ctypes.c_void_p(), ctypes.c_ulonglong()

    def call(name: str, *arguments: object) -> None:
        if code := getattr(library, f"nvml{name}")(*arguments):
            raise OSError(f"nvml{name} gave {code}")

    def joules() -> float:
        call("DeviceGetTotalEnergyConsumption", gpu, ctypes.byref(millijoules))
        return millijoules.value / 1e3

    try:
        library = ctypes.CDLL("libnvidia-ml.so.1")
        call("Init_v2")
        uuid = torch.cuda.get_device_properties(device).uuid  # numbers of devices may differ from the driver's
        call("DeviceGetHandleByUUID", f"GPU-{uuid}".encode(), ctypes.byref(gpu))
        joules()
    except (OSError, AttributeError) as error:
        raise UnreadableError(f"NVML cannot be read ({error})") from None
    return "NVML", joules


def measured(
    joules: Joules,
    ask: Callable[[], Any],
    clock: Joules = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> dict[str, float]:
    """Return what a query takes beyond the idle machine; `ask` asks one, and waits for the device.

    After a rest of 2 s queries follow one another for as long, or for as long as one takes.
    """
    ask()
    before, began = joules(), clock()
    sleep(_SECONDS)
    rested, woke = joules(), clock()
    idle, asked = (rested - before) / (woke - began), 0
    while clock() - woke < _SECONDS or not asked:
        ask()
        asked += 1
    spent, seconds = joules() - rested, clock() - woke
    each = (spent - idle * seconds) / asked
    return {"joules": each, "watts": spent / seconds, "idle_watts": idle, "queries": asked, "seconds": seconds}


_QUERIES = 4  # over which arithmetic is averaged, at most

Cost = tuple[float | None, str]  # the value, None: not known, and how it was found or why not


def costs(experiment: Experiment, run: Run) -> dict[str, Any]:
    """Return what a run keeps of costs: `values` by name, None where one is not known, and `how` it was found or why.

    The estimate prices encode and match, in the place of match the synaptic operations of a network that spikes.
    """
    queries = experiment.dataset.queries.unnamed()
    some = queries[np.linspace(0, len(queries) - 1, min(_QUERIES, len(queries))).astype(np.int64)].in_memory()
    singles = [some[n : n + 1] for n in range(len(some))]
    synops = synaptic_operations(run.spikes)
    how = "no layer that spikes" if synops is None else "spikes x existing synapses"
    found: dict[str, Cost] = {"synops_ac": (synops and synops[0], how), "synops_mac": (synops and synops[1], how)}
    try:
        found |= _operations(experiment.method, singles, synops)
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        why = " ".join(f"not counted ({type(error).__name__}: {error})".split())
        found |= dict.fromkeys(("operations", "joules_estimated"), (None, why))
    found |= {"joules_measured": _measured(experiment, singles), "map_bytes": _map_bytes(experiment.method, run)}
    return {part: {name: cost[at] for name, cost in found.items()} for at, part in enumerate(("values", "how"))}


def text(run: Run, wide: bool = False) -> str:
    """Return the costs of a run as a small table, `n/a` with its reason for what is not known."""
    found = run.energy or {"values": {}, "how": {}}
    shown = {name: "n/a" if cost is None else METRICS[name].text(cost) for name, cost in found["values"].items()}
    rows = [[METRICS[name].head, shown[name], found["how"][name]] for name in shown]
    return table_text(("cost", "", "how"), rows, wide)


def _operations(method: Method, singles: Sequence[Images], synops: tuple[float, float] | None) -> dict[str, Cost]:
    """Return the operations of a query and the joules that they would take; the queries are asked for it."""
    encodes, matches = list[Arithmetic](), list[Arithmetic]()
    for single in singles:
        codes, told = _counted(partial(method.encode, single))
        encodes += told
        if method.reference_mean is not None:
            codes = method.centre(codes, method.reference_mean)
        matches += _counted(partial(method.match, codes))[1]
    each = [sum(one.operations for one in told) / len(singles) for told in (encodes, matches)]
    if not all(each):
        why = f"of {'match' if each[0] else 'encode'} no formula is told, and PyTorch multiplies nothing"
        return dict.fromkeys(("operations", "joules_estimated"), (None, why))
    kinds = "+".join(sorted({one.kind for one in encodes + matches}))
    how = f"encode {each[0]:,.0f}, match {each[1]:,.0f} ({kinds}), by formulas or PyTorch's count"
    priced = "an estimate by 45 nm, without memory: encode and match"
    if synops is not None:
        priced = priced.replace("match", "synaptic operations")
        matches = [Arithmetic(synops[1] * len(singles), synops[0] * len(singles), matches[0].kind)]
    joules_a_query = estimated_joules(encodes + matches) / len(singles)
    return {"operations": (sum(each), how), "joules_estimated": (joules_a_query, priced)}


def _counted(work: Callable[[], Any]) -> tuple[Any, Sequence[Arithmetic]]:
    """Return what work gives and its arithmetic: by formulas that are told, or as PyTorch counts products if more."""
    from torch.utils.flop_counter import FlopCounterMode

    with tallied() as told, FlopCounterMode(display=False) as counter:
        result = work()
    by_torch = Arithmetic(counter.get_total_flops() / 2)
    return result, told if sum(each.operations for each in told) >= by_torch.operations else [by_torch]


def _map_bytes(method: Method, run: Run) -> Cost:
    if (stated := method.map_bytes()) is not None:
        return stated / run.outcome.n_places, "references or weights, a place"
    if run.search is not None:
        return run.search["bytes_per_place"], f"index {run.search['index']}, a place"
    try:
        arrays = method.state()
    except BadInput:
        return None, "the method does not tell what its map holds"
    n_places = run.outcome.n_places
    slope, fixed = _slope_and_fixed(arrays, {n_places, run.n_references})
    how = "the arrays that save= keeps, a place"
    if slope and fixed:
        how += f": {slope / n_places:,.0f} bytes in those with rows for places, and {fixed:,} bytes in all in others"
    return (slope + fixed) / n_places, how


def _slope_and_fixed(arrays: Mapping[str, npt.NDArray[Any]], lengths: set[int]) -> tuple[int, int]:
    """Return the bytes of arrays that together have a row for each place or reference, and of the others.

    Arrays whose names differ in the number at the end are one array, in parts.
    """
    parts: dict[str, list[npt.NDArray[Any]]] = {}
    for name, array in arrays.items():
        parts.setdefault(name.rstrip("0123456789"), []).append(array)
    n_bytes = [0, 0]
    for of_one in parts.values():
        rows = sum(array.shape[0] if array.ndim else 0 for array in of_one)
        n_bytes[rows not in lengths] += sum(array.nbytes for array in of_one)
    return n_bytes[0], n_bytes[1]


def _measured(experiment: Experiment, singles: Sequence[Images]) -> Cost:
    device = experiment.request.device
    turns, finished = itertools.cycle(singles), synchroniser(device)

    def ask() -> None:
        experiment.method.query(next(turns))
        finished()

    try:
        source, read = nvml(device) if device.startswith("cuda") else rapl(POWERCAP)
    except UnreadableError as error:
        return None, str(error)
    with timing_lock.alone():
        told = measured(read, ask)
    how = "{watts:.1f} W less {idle_watts:.1f} W of the idle machine, {queries} queries in {seconds:.1f} s".format(
        **told
    )
    return (told["joules"] if told["joules"] > 0 else None), f"{source}: {how}"
