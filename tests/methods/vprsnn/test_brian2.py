"""A module of VPRSNN spikes and learns step for step as it does in Brian2, the simulator of its authors."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import ROOT
from vprsnn_modules import train_of

from vprbench.methods.vprsnn import training
from vprbench.methods.vprsnn.arguments import Arguments
from vprbench.methods.vprsnn.arrays import Scratch, State, Synapses, Train, unpadded
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.module import Module, show
from vprbench.methods.vprsnn.physics import Physics, physics_of, traces_of
from vprbench.methods.vprsnn.synapses import normalise
from vprbench.methods.vprsnn.training_sets import Lesson

pytestmark = [
    pytest.mark.extended,
    pytest.mark.skipif(
        importlib.util.find_spec("brian2") is None and not os.environ.get("VPRBENCH_INSIST_ON_BRIAN2"),
        reason="Brian2 is missing: pip install brian2",
    ),
]

SHOWN, LENGTH, SILENCE = 3500, 5000, 5000  # steps of input, of a presentation with its rest, of the silence before all
LONGEST_DELAY = 100  # steps
REFRACTORY = 20  # steps in which no neuron, excitatory or inhibitory, fires twice
N_INPUTS, N_NEURONS = 48, 12
WEIGHT_SUM = 22.7  # the largest weights begin close to their limit, 1
TOLERANCE = 1e-9
GROUPS = ("excitatory", "inhibitory")


@dataclass(frozen=True)
class Given:
    """A module and its input, the same for both simulators."""

    weights: np.ndarray  # (n_inputs, n_neurons)
    delays: np.ndarray  # (n_inputs, n_neurons) steps
    theta: np.ndarray  # (n_neurons,) mV, when the first silence begins
    trains: list[Train]  # one a presentation
    weight_sum: float  # 0: nothing is learnt


def given(seed: int, rates: list[int], weight_sum: float) -> Given:
    """Draw a module, and input of so many Hz in each presentation."""
    generator = np.random.default_rng(seed)
    shape = (N_INPUTS, N_NEURONS)
    weights = generator.uniform(0.01, 1, shape)
    trains = []
    for rate in rates:
        spikes = generator.random((SHOWN, N_INPUTS)) < rate * generator.uniform(0, 2, N_INPUTS) * 1e-4
        trains.append(train_of(*np.nonzero(spikes), N_INPUTS))
    return Given(
        weights=weights * WEIGHT_SUM / weights.sum(axis=0),
        delays=generator.integers(0, LONGEST_DELAY + 1, shape),
        theta=generator.uniform(18, 22, N_NEURONS),
        trains=trains,
        weight_sum=weight_sum,
    )


def by_brian2(given: Given, folder: Path) -> dict[str, np.ndarray]:
    """Run Brian2 in a process of its own, whose home is an empty folder."""
    np.savez(
        folder / "given.npz",
        weights=given.weights,
        delays=given.delays,
        theta=given.theta,
        steps=np.concatenate([SILENCE + n * LENGTH + train.step for n, train in enumerate(given.trains)]),
        sources=np.concatenate([train.source for train in given.trains]),
        presentations=len(given.trains),
        weight_sum=given.weight_sum,
    )
    script = ROOT / "tests" / "oracles" / "vprsnn_in_brian2.py"
    run = subprocess.run(
        [sys.executable, script, folder / "given.npz", folder / "found.npz"],
        cwd=folder,
        env={**os.environ, "HOME": str(folder), "TMPDIR": str(folder), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return dict(np.load(folder / "found.npz"))


class Compiled:
    """The compiled simulation of what is given, from the end of the first silence on."""

    def __init__(self, given: Given) -> None:
        self.physics, self.traces = physics_of(Arguments()), traces_of(Arguments())
        self.given, self.learning, self.now = given, given.weight_sum > 0, 0
        self.synapses = Synapses.of(given.weights, given.delays.astype(np.int16))
        self.state = State.at_rest(self.physics, given.theta, len(given.weights))
        self.state.v[:], self.state.v_i[:] = -105, -100
        self.show(self.physics._replace(shown=SILENCE, rest=0), cut(given.trains[0], 0), self.synapses, self.state)
        self.now = SILENCE

    def show(self, physics: Physics, train: Train, synapses: Synapses, state: State) -> None:
        """Show an image under other durations; `synapses` and `state` change."""
        n_inputs, n_neurons = self.given.weights.shape
        scratch = Scratch.of(physics, n_neurons, n_inputs, LONGEST_DELAY, self.learning)
        show(Module(physics, self.traces, synapses, state, self.now, scratch, self.learning), train)

    def run(self) -> dict[str, Any]:
        """Return the spikes of both groups, (n_spikes, 2), the counts of each presentation, and the final state."""
        n_neurons = self.given.weights.shape[1]
        spikes: dict[str, list[tuple[int, int]]] = {name: [] for name in GROUPS}
        counts = []
        for heard in self.given.trains:
            if self.learning:
                normalise(self.synapses.weights, self.given.weight_sum)
            for name, times in self.spikes(heard).items():
                spikes[name] += sorted(times)
            self.state = self.until(heard, LENGTH, self.synapses)
            self.now += LENGTH
            counts.append(self.state.counts[:n_neurons])
        found = {name: np.array(times, np.int64).reshape(-1, 2) for name, times in spikes.items()}
        return found | {
            "counts": np.array(counts),
            "weights": unpadded(self.synapses.weights, n_neurons),
            "theta": self.state.theta[:n_neurons],
            "v": self.state.v[:n_neurons],
        }

    def spikes(self, train: Train) -> dict[str, set[tuple[int, int]]]:
        """Return steps and neurons of a presentation's spikes; nothing changes.

        The state tells of each neuron's last spike alone. So the presentation is stopped early, again and again, each
        time a little later: so little that no neuron fires twice in between.
        """
        found: dict[str, set[tuple[int, int]]] = {name: set() for name in GROUPS}
        for until in range(REFRACTORY, LENGTH + 1, REFRACTORY):
            early = self.until(train, until, self.synapses._replace(weights=self.synapses.weights.copy()))
            for name, fired in zip(GROUPS, (early.fired, early.fired_i), strict=True):
                found[name] |= {(step, neuron) for neuron, step in enumerate(fired.tolist()) if step >= self.now}
        return found

    def until(self, train: Train, end: int, synapses: Synapses) -> State:
        """Return the state `end` steps into a presentation; `synapses` change."""
        physics = self.physics._replace(shown=min(end, SHOWN), rest=max(0, end - SHOWN))
        state = State(*(array.copy() for array in self.state))
        self.show(physics, cut(train, physics.shown), synapses, state)
        return state


def cut(train: Train, end: int) -> Train:
    """Return the input before step `end`."""
    heard = train.step < end
    return train_of(train.step[heard], train.source[heard], len(train.first) - 1)


def counted(found: dict[str, np.ndarray], presentations: int) -> np.ndarray:
    """Return Brian2's spikes (presentations, n_neurons) from the end of each input to the end of the next."""
    step, neuron = found["excitatory"].T
    counts = np.zeros((presentations + 1, len(found["theta"])), int)
    np.add.at(counts, ((step - SILENCE - SHOWN) // LENGTH + 1, neuron), 1)
    return counts[:-1]


def assert_same(ours: Any, theirs: np.ndarray) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE)


# Hz of each presentation; some neurons that learn are silent for so long that they are not scaled
@pytest.mark.parametrize(
    ("rates", "weight_sum"), [([120, 20, 10, 240, 60], WEIGHT_SUM), ([120, 200, 60], 0)], ids=["learns", "answers"]
)
def test_a_module_spikes_step_for_step_as_in_brian2_and_has_its_weights_and_thresholds(
    tmp_path: Path, rates: list[int], weight_sum: float
) -> None:
    both = given(0, rates, weight_sum)
    theirs, ours = by_brian2(both, tmp_path), Compiled(both).run()
    for group in GROUPS:
        in_order = theirs[group][np.lexsort(theirs[group].T[::-1])]
        np.testing.assert_array_equal(ours[group], in_order, err_msg=group)
    np.testing.assert_array_equal(ours["counts"], counted(theirs, len(rates)))
    for name in ("weights", "theta", "v"):
        assert_same(ours[name], theirs[name])
    for name in () if weight_sum else ("weights", "theta"):  # nothing is learnt
        np.testing.assert_array_equal(ours[name], getattr(both, name))


def test_the_training_of_a_module_leaves_what_brian2_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trains: list[Train] = []

    def watched(module: Module, train: Train) -> None:
        trains.append(train)
        show(module, train)

    monkeypatch.setattr(training, "show", watched)
    model = Model(height=6, width=8, n_excitatory=N_NEURONS, levels_per_hz=0.8, weight_sum=WEIGHT_SUM, epochs=2)
    levels = np.random.default_rng(2).integers(0, 200, (2, N_INPUTS)).astype(np.uint8)
    lesson = Lesson(0, levels, labels=np.arange(2), places=np.arange(2))
    trained = training.train(model, lesson, lambda share: None)

    weights = model.weights(0)
    weights *= WEIGHT_SUM / weights.sum(axis=0)
    theta = np.full(N_NEURONS, model.theta_start_mv)
    theirs = by_brian2(Given(weights, model.delays(0), theta, trains, WEIGHT_SUM), tmp_path)
    assert_same(unpadded(trained["weights"], N_NEURONS), theirs["weights"])
    assert_same(trained["theta"], theirs["theta"])
    counts = counted(theirs, 4)
    np.testing.assert_array_equal(trained["sums"].T, counts[:2] + counts[2:])
