"""An interrupted training of VPRSNN goes on with its own modules, and ends in the same network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest
import torch
from little_vprsnn import SMALL, WORLD, fitted, held_out, images, one_thread, references, same  # noqa: F401 - a fixture

from vprbench.api import checkpoints
from vprbench.methods.vprsnn import training
from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.training import train
from vprbench.methods.vprsnn.training_sets import Lesson

pytestmark = pytest.mark.usefixtures("one_thread")


class Interrupted(Exception):
    """Somebody ended the training."""


# --- interruptions ----------------------------------------------------------------------------------------------


@pytest.fixture
def trainings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of partial trainings."""
    monkeypatch.setenv("VPRBENCH_PARTIAL", str(tmp_path))
    return tmp_path


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The `numbers` of modules in the order they are trained; at the one called `fatal` the training is interrupted."""
    seen = SimpleNamespace(numbers=[], fatal=None)

    def watched(model: Model, shown: Lesson, *others: Any) -> training.Arrays:
        if len(seen.numbers) == seen.fatal:
            raise Interrupted
        seen.numbers.append(shown.number)
        return train(model, shown, *others)

    monkeypatch.setattr(training, "train", watched)
    return seen


def interrupt(trained: SimpleNamespace, after: int, work: Callable[[], Any]) -> None:
    """Do the work, interrupted once so many modules are trained, and forget that they were."""
    trained.fatal = after
    with pytest.raises(Interrupted):
        work()
    assert len(trained.numbers) == after
    trained.numbers, trained.fatal = [], None


def test_an_interrupted_training_trains_only_what_is_missing_also_in_other_threads(trainings, trained):
    expected = fitted(20, epochs=2)
    assert trained.numbers == [0, 1, 2, 3]
    assert not list(trainings.iterdir())
    trained.numbers = []
    interrupt(trained, 2, lambda: fitted(20, epochs=2))
    assert list(trainings.iterdir())
    torch.set_num_threads(2)
    found = fitted(20, epochs=2)
    assert sorted(trained.numbers) == [2, 3]
    assert same(found.state(), expected.state())
    assert not list(trainings.iterdir())


@pytest.mark.parametrize(
    ("change", "trained_anew"),
    [
        ({"seed": 1}, [0, 1]),
        ({"theta_plus_mv": 0.06}, [0, 1]),
        ({"assignment": "weighted"}, [1]),  # which asks otherwise, but learns the same
    ],
    ids=str,
)
@pytest.mark.usefixtures("trainings")
def test_a_training_goes_on_with_modules_of_the_same_training_alone(trained, change, trained_anew):
    interrupt(trained, 1, lambda: fitted(10))
    fitted(10, **change)
    assert trained.numbers == trained_anew


@pytest.mark.parametrize("changed", ["images", "places"])
@pytest.mark.usefixtures("trainings")
def test_a_training_does_not_go_on_with_modules_of_other_images_or_places(trained, changed):
    interrupt(trained, 1, lambda: fitted(10))
    shown, places = references(10)
    if changed == "images":
        shown = images([image // 2 if row == 15 else image for row, image in enumerate(shown)])
    VPRSNN(**SMALL).fit(shown, places[::-1].copy() if changed == "places" else places)
    assert trained.numbers == [0, 1]


def test_a_training_that_is_interrupted_when_all_modules_are_trained_trains_none_again(trainings, trained, monkeypatch):
    expected = fitted(10, hyperactive_threshold=9).state()
    with monkeypatch.context() as patch:
        patch.setattr(training, "reactions", interrupted)
        with pytest.raises(Interrupted):
            fitted(10, hyperactive_threshold=9)
    trained.numbers = []
    assert same(fitted(10, hyperactive_threshold=9).state(), expected)
    assert trained.numbers == []


def test_an_ensemble_goes_on_with_the_members_that_it_had_trained(trainings: Path, trained: SimpleNamespace) -> None:
    def fit() -> VPRSNN:
        return VPRSNNEnsemble(**SMALL, seeds=[0, 10]).fit(*references(10))

    expected = fit().state()
    trained.numbers = []
    interrupt(trained, 3, fit)
    assert same(fit().state(), expected)
    assert trained.numbers == [1]


def test_an_interrupted_calibration_trains_only_what_is_missing(trainings: Path, trained: SimpleNamespace) -> None:
    expected = fitted().calibrate(held_out()).state()
    found = fitted()
    trained.numbers = []
    interrupt(trained, 1, lambda: found.calibrate(held_out()))
    found.calibrate(held_out())
    assert len(trained.numbers) == 1
    assert same(found.state(), expected)
    assert not list(trainings.iterdir())


def test_a_calibration_does_not_go_on_with_reactions_of_another_network(trainings, monkeypatch):
    # The second traverse shows other images, from which other neurons learn; the first, for which reactions are
    # counted, is the same.
    def fit(second: int) -> VPRSNN:
        rows = [*range(5), *range(second, second + 5)]
        only_one = {"hyperactive_candidates": [1]}  # certainly chosen, so that reactions of the map are counted
        return VPRSNN(**SMALL, **only_one).fit(images([WORLD.references[row] for row in rows]), np.tile(range(5), 2))

    expected = fit(20).calibrate(held_out()).state()

    def calibrated_but_interrupted(fitted: VPRSNN) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(checkpoints.Partial, "remove", interrupted)
            with pytest.raises(Interrupted):
                fitted.calibrate(held_out())

    calibrated_but_interrupted(fit(10))
    assert same(fit(20).calibrate(held_out()).state(), expected)


def interrupted(*_: Any) -> NoReturn:
    raise Interrupted
