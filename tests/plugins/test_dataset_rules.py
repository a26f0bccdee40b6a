"""Every dataset that needs no files keeps the rules, and each rule alone catches what breaks it."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from vprbench.api.dataset import Dataset, HeldOut
from vprbench.api.images import Images
from vprbench.plugins.conformance import check_dataset
from vprbench.plugins.dataset_rules import DATASET_RULES

N = 6


def picture(number, height=12):
    return np.random.default_rng(number).integers(0, 256, (height, 16, 3), dtype=np.uint8)


def frames(read=picture, word="frame", n=N):
    return Images(read, [f"{word} {i}" for i in range(n)], stamp=lambda i: b"%d" % i, content=lambda i: b"%d" % i)


def right(**changed):
    """Keeps every rule; `changed` parts replace its own without the checks of the constructor."""
    truth = tuple(np.array([place]) for place in range(N))
    protocol = {"protocol": "little", "references": ["day"], "query": "night"}
    dataset = Dataset("right", frames(), np.arange(N), frames(word="query"), truth, protocol)
    for name, value in changed.items():
        object.__setattr__(dataset, name, value)
    return dataset


COUNT = itertools.count()


def drifting(number):
    return picture(number) ^ np.uint8(next(COUNT) % 256)


def held_out():
    own = right()
    return replace(own, held_out=HeldOut(own.references, own.places, own.queries, own.places, in_map=True))


def protocol(**values):
    return lambda: right(protocol=values)


def truth(*places):
    given = [*places, *([i] for i in range(len(places), N))]
    return lambda: right(positives=tuple(np.array(right, dtype=None if right else np.int64) for right in given))


WRONG: dict[str, list[Callable[..., Dataset]]] = {
    "it is the same when it is made again": [
        lambda: right(notes=(f"note {next(COUNT)}",)),
    ],
    "right places are whole numbers, ascending, each once": [truth([0.0]), truth([1, 0])],
    "images are uint8 (height, width, 3)": [
        lambda: right(queries=frames(lambda i: picture(i).astype(np.float32))),
        lambda: right(queries=frames(lambda i: picture(i)[:, :, :2])),
    ],
    "an image is the same however it is read": [
        lambda: right(queries=frames(drifting)),
    ],
    "the protocol holds plain values": [
        protocol(references=("day",), query="night"),
        protocol(references="day", query=float("nan")),
    ],
    "held-out queries are none of the queries": [held_out],
}


def broken(make):
    globals()["made"] = make
    results = check_dataset({"_target_": f"{__name__}.made"})
    return {result.rule: result.reason for result in results if result.state == "broken"}


@pytest.mark.parametrize(("rule", "make"), [(rule, make) for rule in WRONG for make in WRONG[rule]])
def test_the_rule_alone_catches_what_breaks_it(rule, make):
    found = broken(make)
    assert [*found] == [rule]
    assert found[rule]


def test_a_right_dataset_keeps_every_rule_and_each_rule_has_a_wrong_one():
    assert broken(right) == {}
    assert list(WRONG) == list(DATASET_RULES)
