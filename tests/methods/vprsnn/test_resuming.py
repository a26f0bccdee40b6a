"""An interrupted training of VPRSNN goes on with its own modules, and ends in the same network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
import torch
from little_vprsnn import SMALL, WORLD, fitted, held_out, images, one_thread, references, same  # noqa: F401 - a fixture

from vprbench.methods.vprsnn import training
from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.training import train
from vprbench.methods.vprsnn.training_sets import Lesson

pytestmark = pytest.mark.usefixtures("one_thread")


class Interrupted(Exception):
    """Somebody ended the training."""


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


@pytest.mark.parametrize("change", [{"seed": 1}, {"theta_plus_mv": 0.06}, {"assignment": "weighted"}, "image", "place"])
@pytest.mark.usefixtures("trainings")
def test_a_training_goes_on_with_modules_of_the_same_training_alone(trained, change):
    interrupt(trained, 1, lambda: fitted(10))
    shown, places = references(10)
    if change == "image":
        shown = images([image // 2 if row == 15 else image for row, image in enumerate(shown)])
    elif change == "place":
        places = places[::-1].copy()
    VPRSNN(**{**SMALL, **(change if isinstance(change, dict) else {})}).fit(shown, places)
    # A weighted assignment asks otherwise, but learns the same.
    assert trained.numbers == ([1] if change == {"assignment": "weighted"} else [0, 1])


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


def interrupted(*_: Any) -> NoReturn:
    raise Interrupted
