"""The benchmark of VPRSNN: its parts are those of the training itself, its queries go to as many modules as it says."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from vprbench.errors import BadInput
from vprbench.methods.vprsnn import benchmark, model, training
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol
from vprbench.speed import bench, vprsnn
from vprbench.speed.measure import Fit
from vprbench.speed.report import Failed, Report
from vprbench.speed.route import Route
from vprbench.speed.settings import SECTIONS, Settings
from vprbench.speed.vprsnn import AskingCell, ModuleCell, affordable, copies

MODULE = {"height": 6, "width": 6, "patch": 3, "places_per_module": 2, "n_excitatory": 12, "epochs": 4, "seed": 3}
HOMES = {"spike_train": model, "normalise": training, "show": training}


def watched():
    return benchmark.watched(vprsnn.Stopwatch(Protocol()).lap)


def shown():
    return Route.drawn(2, 12, 12, 0).references(2, 2)


@pytest.mark.parametrize("fast", [False, True])
def test_a_training_that_is_watched_learns_what_any_other_does_and_its_spikes_are_counted(fast):
    asked = {**MODULE, "fast": fast, "recorded_presentations": 16}
    network = VPRSNN(**asked)
    functions = [getattr(home, name) for name, home in HOMES.items()]
    with contextlib.suppress(KeyboardInterrupt), watched() as watch:
        seen = network.fit(*shown()).state()
        assert training.show != functions[-1]
        raise KeyboardInterrupt
    assert [getattr(home, name) for name, home in HOMES.items()] == functions  # whatever happened
    own = VPRSNN(**asked).fit(*shown()).state()
    assert seen.keys() == own.keys()
    for name in own:
        np.testing.assert_array_equal(seen[name], own[name])
    levels = network.encode(shown()[0]).astype(float)
    expected = 4 * (levels / 4 * 0.35).sum()  # epochs, levels a Hz, seconds of a presentation
    assert watch.presentations == 4 * 4
    assert {len(laps) for laps in watch.laps.values()} == {3}  # of every seventh presentation
    assert watch.input_spikes == pytest.approx(expected, abs=5 * expected**0.5)
    assert watch.excitatory_spikes == own["sums"].sum() > 0


def test_as_many_modules_are_asked_as_memory_has_room_for_copies_with_places_of_their_own(monkeypatch):
    module = VPRSNN(**MODULE, fast=True).fit(*shown())
    several = VPRSNN(**MODULE, fast=True).restore(copies(module.state(), 3))
    queries, _ = Route.drawn(2, 12, 12, 0).queries(2, 2)
    alone = module.query(queries)
    assert alone.max() > 0
    np.testing.assert_array_equal(several.query(queries), np.tile(alone, 3))
    for free, modules in ((79_999_999, 9), (80_000_000, 10), (1e12, 111)):
        monkeypatch.setattr(vprsnn.psutil, "virtual_memory", lambda free=free: SimpleNamespace(available=free))
        assert affordable(111, 2_000_000) == modules
    monkeypatch.setattr(vprsnn.psutil, "virtual_memory", lambda: SimpleNamespace(available=7e6))
    with pytest.raises(BadInput, match="one module takes 8 MB, and 7 MB are free"):
        affordable(18, 2_000_000)


PARTS = {"input": [0.5, 1.0], "normalising": [0.25, 0.25], "arrivals": [2.0, 3.0]}
PARTS |= {"without learning": [3.0, 5.0], "with learning": [6.0, 12.0]}
FITS = [Fit(seconds, {}, 0, 0, None) for seconds in (30.0, 15.0, 15.0)]
COUNTS = {"presentations": 1500, "neurons": 400, "input_spikes": 8750 * 1500, "excitatory_spikes": 9876}
CELL = ModuleCell("vprsnn", fits=FITS, parts=PARTS, **COUNTS)
ASKED = [
    AskingCell(18, 18, 450, 1, {"vprsnn": [0.1], "vprsnn_fast": [0.05]}),
    AskingCell(60, 111, 1500, 1, {"vprsnn": [0.4, 0.5, 9.0], "vprsnn_fast": [0.2, 0.25, 0.3]}),
    AskingCell(60, 111, 1500, 2, {"vprsnn": [0.25], "vprsnn_fast": [0.125]}),
]

CELLS = {"vprsnn_training": [CELL, Failed({"method": "vprsnn_fast"}, "no room")], "vprsnn_queries": ASKED}
HERE = {**machine.capture("cpu", 1), "cpu_pressure_avg10": None}
ABOUT = {"canary_seconds": {"start": 1.0, "training": 1.25}, "load_average_after": [0.5], "seconds": 60.0}
ABOUT |= {"cpu_pressure_avg10_after": 3.0}


def test_rows_tell_medians_and_shares_of_presentations_and_rates_stand_beside_the_papers():
    # 13.125 million spikes to 400 neurons each: 5,250 million arrivals, in 15 s
    row = ["vprsnn", "15 (3)", "1,500", "10", "13,125,000", "5,250 million", "350 million", "9,876"]
    assert [*CELL.row().values()] == row
    # input 1.5 + normalising 0.5 + presentations 18 = 20 s, of two
    parts = ["vprsnn", "2", "10,000", "7.5 %", "25.0 %", "15.0 %", "50.0 %", "2.5 %"]
    assert [*CELL.parts_row().values()] == parts
    assert [*ASKED[0].row().values()][:3] == ["18", "450", "1"]
    asked = ["60 of 111: memory is short", "1,500", "1", "500", "250", "2", "4", "2x"]
    assert [*ASKED[1].row().values()] == asked
    told = bench.text_of(Report(Settings(sections=[*CELLS]), HERE, dict.fromkeys(SECTIONS, ()) | CELLS, ABOUT))
    numbers = ["vprsnn 15 s", "164 s for each of its 132 modules of 25", "2 Hz on 1 core, 4 Hz on 2 cores"]
    for text in (*numbers, "no room", "unknown, 3 %", "after training 1.25."):  # drifted more than 5 %
        assert text in told
