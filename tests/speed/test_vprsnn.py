"""The benchmark of VPRSNN: its parts are those of the training itself, its queries go to as many modules as it says."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from stopped_clock import Clock

from vprbench import progress
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.methods.vprsnn import arrays, benchmark, model, training
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol
from vprbench.speed import bench, measure, vprsnn
from vprbench.speed.measure import Fit
from vprbench.speed.report import Failed, Report
from vprbench.speed.route import Route
from vprbench.speed.settings import QUICK, SECTIONS, Bench, Settings
from vprbench.speed.vprsnn import AskingCell, ModuleCell, affordable, asking_cell, copies, module_cell

MODULE = {"height": 6, "width": 6, "patch": 3, "places_per_module": 2, "n_excitatory": 12, "epochs": 4, "seed": 3}
WATCHED = {"spike_train": model, "normalise": training, "show": training}


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    clock.replaces_those_of([vprsnn, measure], monkeypatch)
    return clock


def watched():
    return benchmark.watched(vprsnn.Stopwatch(Protocol()).lap)


def shown():
    return Route.drawn(2, 12, 12, 0).references(2, 2)


@pytest.mark.parametrize("fast", [False, True])
def test_a_training_that_is_watched_learns_what_any_other_does(fast):
    with watched() as watch:
        seen = VPRSNN(**MODULE, fast=fast).fit(*shown()).state()
    own = VPRSNN(**MODULE, fast=fast).fit(*shown()).state()
    assert watch.presentations == 4 * 4
    assert seen.keys() == own.keys()
    for name in own:
        np.testing.assert_array_equal(seen[name], own[name])


def test_spikes_are_those_of_all_presentations():
    references, places = shown()
    network = VPRSNN(**MODULE, recorded_presentations=16)
    with watched() as watch:
        network.fit(references, places)
    levels = network.encode(references).astype(float)
    expected = 4 * (levels / 4 * 0.35).sum()  # epochs, levels a Hz, seconds of a presentation
    assert watch.input_spikes == pytest.approx(expected, abs=5 * expected**0.5)
    assert watch.excitatory_spikes == network.state()["sums"].sum() > 0


class Loops:
    """In place of the compiled loops: spend known seconds, and note what is shown to which potential."""

    def __init__(self, clock, patch):
        self.clock = clock
        self.shown = []  # learning or not, and the potential by then
        for name, home in WATCHED.items():
            patch.setattr(home, name, getattr(self, name))
        patch.setattr(benchmark, "sum_arrivals", self.sum_arrivals)

    def spike_train(self, levels):
        self.clock.spend(1)
        return SimpleNamespace(step=[0, 4, 9])

    def normalise(self, weights):
        self.clock.spend(2)

    def sum_arrivals(self, synapses, train, drive):
        assert (synapses, drive) == ("synapses", "drive")
        self.clock.spend(4)

    def show(self, module, train):
        state = module.state
        self.shown.append((module.learning, state.v[0]))
        state.v[:] += 1
        state.counts[:] = 2
        self.clock.spend(16 + module.number if module.learning else 8)


@dataclass
class Trained(Method):
    """Calls what a training calls, so many presentations; answers in known seconds."""

    clock: Clock
    loops: Loops
    presentations: int = 15
    query_seconds: float = 1.0
    modules: int = 1

    def fit(self, references, places):
        progress.report("training", 0.0)
        state = arrays.State.at_rest(SimpleNamespace(e_rest=0.0, i_rest=0.0), np.zeros(8), 5)
        scratch = SimpleNamespace(drive="drive")
        for number in range(self.presentations):
            train = model.spike_train("levels")
            training.normalise("weights")
            module = SimpleNamespace(synapses="synapses", state=state, scratch=scratch, learning=True, number=number)
            training.show(module, train)
        progress.report("training", 1.0)
        return self

    def state(self):
        return {"weights": np.zeros((1, 2, 3)), "places": np.array([[0, 1]])}

    def restore(self, state):
        self.modules = len(state["weights"])
        return self

    def encode(self, images):
        return images

    def match(self, codes):
        self.clock.spend(self.query_seconds * self.modules)


def test_parts_are_timed_on_every_seventh_presentation_each_alone_and_leave_no_trace(clock, monkeypatch):
    loops = Loops(clock, monkeypatch)
    with watched() as watch:
        Trained(clock, loops).fit(None, None)
    assert watch.laps == {
        "input": [1.0] * 3,
        "normalising": [2.0] * 3,
        "arrivals": [4.0] * 3,
        "without learning": [8.0] * 3,
        "with learning": [16.0, 16.0 + 7, 16.0 + 14],
    }
    assert (watch.presentations, watch.input_spikes, watch.excitatory_spikes) == (15, 15 * 3, 15 * 8 * 2)
    assert [potential for learning, potential in loops.shown if learning] == [*range(15)]
    assert [potential for learning, potential in loops.shown if not learning] == [0, 7, 14]
    assert [learning for learning, _ in loops.shown[7:10]] == [True, False, True]


def test_a_training_has_its_own_functions_back_whatever_happened():
    own = [getattr(home, name) for name, home in WATCHED.items()]

    def interrupted():
        with watched():
            assert training.show != own[-1]
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [getattr(home, name) for name, home in WATCHED.items()] == own


@pytest.fixture
def cores(monkeypatch):
    """The numbers of cores that were asked for, one after the other."""
    pinned = []
    monkeypatch.setattr(vprsnn.machine, "pin_threads", pinned.append)
    return pinned


def test_a_module_is_trained_in_rounds_on_one_core_and_once_more_for_its_parts(clock, cores, monkeypatch):
    loops = Loops(clock, monkeypatch)
    made = []

    def make(name, device, **arguments):
        made.append((name, device, arguments["places_per_module"], cores[-1:]))
        return Trained(clock, loops, presentations=2)

    settings = Settings(**{**QUICK, "threads": 5, "vprsnn_rounds": 3})
    run = Bench(settings, make, Route.drawn(2, 8, 8, 0))
    cell = module_cell(run, "vprsnn_fast")
    assert made == [("vprsnn_fast", "cpu", 2, [1])] * 5  # one that compiles, three rounds, one for the parts
    assert cores == [1, 5]
    each = (1 + 2 + 16) + (1 + 2 + 17)
    assert [fit.seconds for fit in cell.fits] == [each] * 3
    assert (cell.presentations, cell.input_spikes, cell.excitatory_spikes) == (2, 6, 32)
    assert cell.parts["with learning"] == [16.0]
    assert list(run.modules) == ["vprsnn_fast"]


def test_both_methods_are_asked_in_turn_on_the_cores_that_are_named(clock, cores, monkeypatch):
    loops = Loops(clock, monkeypatch)
    seconds = {"vprsnn": 0.5, "vprsnn_fast": 0.25}
    given = {}

    def make(name, device, **arguments):
        assert device == "cpu"
        return Trained(clock, loops, query_seconds=seconds[name])

    monkeypatch.setattr(vprsnn, "affordable", lambda wanted, module_bytes: given.update({wanted: module_bytes}) or 4)
    settings = Settings(**{**QUICK, "threads": 5, "minimum_seconds": 14.5})
    cell = asking_cell(Bench(settings, make, Route.drawn(20, 8, 8, 0)), 9, 2)
    assert given == {9: 2 * 3 * 8}
    assert (cell.modules, cell.wanted, cell.places, cell.threads) == (4, 9, 8, 2)
    assert cell.seconds == {"vprsnn": [2.0] * 5, "vprsnn_fast": [1.0] * 5}  # five turns of three seconds
    assert cores == [2, 5]


def test_the_modules_that_are_asked_are_copies_with_places_of_their_own():
    module = VPRSNN(**MODULE, fast=True).fit(*shown())
    several = VPRSNN(**MODULE, fast=True).restore(copies(module.state(), 3))
    queries, _ = Route.drawn(2, 12, 12, 0).queries(2, 2)
    alone = module.query(queries)
    assert alone.max() > 0
    np.testing.assert_array_equal(several.query(queries), np.tile(alone, 3))


@pytest.mark.parametrize(("free", "modules"), [(79_999_999, 9), (80_000_000, 10), (1e12, 111)])
def test_no_more_modules_are_asked_than_memory_has_room_for(free, modules, monkeypatch):
    monkeypatch.setattr(vprsnn.psutil, "virtual_memory", lambda: SimpleNamespace(available=free))
    assert affordable(111, 2_000_000) == modules
    monkeypatch.setattr(vprsnn.psutil, "virtual_memory", lambda: SimpleNamespace(available=7e6))
    with pytest.raises(BadInput, match="one module takes 8 MB, and 7 MB are free"):
        affordable(18, 2_000_000)


def fits(*seconds):
    return [Fit(each, {}, 0, 0, None) for each in seconds]


CELL = ModuleCell(
    "vprsnn",
    presentations=1500,
    neurons=400,
    fits=fits(30.0, 15.0, 15.0),
    input_spikes=13_125_000,  # 8750 a presentation
    excitatory_spikes=9876,
    parts={
        "input": [0.5, 1.0],
        "normalising": [0.25, 0.25],
        "arrivals": [2.0, 3.0],
        "without learning": [3.0, 5.0],
        "with learning": [6.0, 12.0],
    },
)


ASKED = [
    AskingCell(18, 18, 450, 1, {"vprsnn": [0.1], "vprsnn_fast": [0.05]}),
    AskingCell(60, 111, 1500, 1, {"vprsnn": [0.4, 0.5, 9.0], "vprsnn_fast": [0.2, 0.25, 0.3]}),
    AskingCell(60, 111, 1500, 2, {"vprsnn": [0.25], "vprsnn_fast": [0.125]}),
]


def test_a_training_is_told_by_its_median_and_what_happens_in_a_second():
    # 13.125 million spikes to 400 neurons each: 5,250 million arrivals, in 15 s
    row = [*CELL.row().values()]
    assert row == ["vprsnn", "15 (3)", "1,500", "10", "13,125,000", "5,250 million", "350 million", "9,876"]


def test_shares_are_of_whole_presentations_and_add_up():
    # input 1.5 + normalising 0.5 + presentations 18 = 20 s, of two
    row = [*CELL.parts_row().values()]
    assert row == ["vprsnn", "2", "10,000", "7.5 %", "25.0 %", "15.0 %", "50.0 %", "2.5 %"]


def test_queries_are_told_by_medians_and_the_modules_that_memory_left():
    assert [*ASKED[0].row().values()][:3] == ["18", "450", "1"]
    row = [*ASKED[1].row().values()]
    assert row == ["60 of 111: memory is short", "1,500", "1", "500", "250", "2", "4", "2x"]


def test_the_papers_numbers_stand_beside_those_of_a_module_and_of_the_most_modules():
    settings = Settings(sections=["vprsnn_training", "vprsnn_queries"])
    cells = {name: [] for name in SECTIONS}
    failed = Failed({"method": "vprsnn_fast"}, "no room")
    here = {**machine.capture("cpu", 1), "cpu_pressure_avg10": None}
    cells |= {"vprsnn_training": [CELL, failed], "vprsnn_queries": ASKED}
    about = {"canary_seconds": {"start": 1.0, "training": 1.25}, "load_average_after": [0.5], "seconds": 60.0}
    told = bench.text_of(Report(settings, here, cells, {**about, "cpu_pressure_avg10_after": 3.0}))
    assert "25 places, on one core: vprsnn 15 s. The paper prints 360 min for 3,300 places" in told
    assert "164 s for each of its 132 modules of 25." in told  # 21,600 s / 132
    assert "60 modules, 1,500 places: 2 Hz on 1 core, 4 Hz on 2 cores. The paper prints 2 Hz" in told
    assert "no room" in told
    assert "CPU pressure before and after: unknown, 3 %" in told
    assert "after training 1.25." in told  # a drift of more than 5 %
