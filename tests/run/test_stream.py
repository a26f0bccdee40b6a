"""A map that grows while queries come: what is asked at each stop, and what a run keeps and tells of it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import matplotlib.figure
import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey
from little_runs import asked_for
from small_plan import RUN

from vprbench.api.arrays import Places
from vprbench.api.images import Images
from vprbench.cli import main
from vprbench.paper.figures.growth import growing_map
from vprbench.paper.selection import Series
from vprbench.run.store import Store
from vprbench.run.stream import grown

pytestmark = pytest.mark.usefixtures("surroundings")


@dataclass
class Counting(Lookup):
    """A lookup that scores as many places as it was given, and notes what it was given."""

    known: int = 0

    def fit(self, references: Images, places: Places) -> Self:
        self.known = int(places.max()) + 1
        self.asked.append([-1, *places.tolist()])
        return self

    def extend(self, references: Images, places: Places) -> Self:
        self.asked.append([-2, len(references), *places.tolist()])
        self.known += 1
        return self

    def match(self, codes: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        return self.table[codes, : self.known]


def test_each_stop_asks_the_queries_whose_place_is_known() -> None:
    # Places are right for queries 0, 1, (1 or 4), 3 and none; query 0 is lost once place 3 is there.
    dataset = journey(5, 5, [[0], [1], [1, 4], [3], []])
    dataset = replace(dataset, references=dataset.references[np.array([0, 1, 2, 3, 4, 1])], places=np.r_[0:5, 1])
    table = np.array([[5, 0, 0, 9, 0], [0, 5, 0, 0, 0], [0, 3, 5, 0, 9], [0, 0, 0, 5, 0], [1, 1, 1, 1, 1]], np.float32)
    method = Counting(table)
    stops = grown(replace(asked_for(method, dataset), stream=2))
    assert [(stop["places"], stop["hits"], len(stop["seconds"])) for stop in stops] == [
        (2, [1.0, 1.0, 1.0], 0),
        (4, [0.0, 1.0, 0.0, 1.0], 2),
        (5, [0.0, 1.0, 1.0, 1.0], 1),
    ]
    given = [each for each in method.asked if each[0] < 0]
    assert given == [[-1, 0, 1, 1], [-2, 1, 2], [-2, 1, 3], [-2, 1, 4]]
    assert method.known == 0  # the run's own method is another


def asked(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["dataset.places=12", "dataset.first_query_place=0", *RUN, *options]) == 0
    return capsys.readouterr().out


def test_a_growing_map_is_stored_with_its_run_printed_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "stream" not in json.loads(asked(capsys, "output=json"))
    made = json.loads(asked(capsys, "output=json", "stream=5"))
    assert made["from_store"] is False  # the stored run had none
    assert [(stop["places"], stop["queries"]) for stop in made["stream"]] == [(5, 5), (10, 10), (12, 12)]
    assert made["stream"][-1]["recall_at_1"] == made["recall_at_1"]  # SAD learns the same one by one
    assert made["stream"][0]["recall_at_1"] == made["stream"][0]["recall_at_1_of_first"]
    assert json.loads(asked(capsys, "output=json", "force=true"))["from_store"] is False
    again = json.loads(asked(capsys, "output=json", "stream=5"))
    assert (again["from_store"], again["stream"]) == (True, made["stream"])
    assert [stop["places"] for stop in json.loads(asked(capsys, "output=json", "stream=true"))["stream"]] == [
        *range(2, 13, 2)
    ]
    table = asked(capsys, "stream=true").splitlines()
    heads = next(n for n, line in enumerate(table) if line.startswith("places "))
    assert [line.split()[0] for line in table[heads + 1 :][:7]] == ["2", "4", "6", "8", "10", "12", "12"]
    (run,) = Store(tmp_path / "results").runs()
    drawn = growing_map([Series("SAD", False, (run,))])
    assert isinstance(drawn.figure, matplotlib.figure.Figure)
    left, right = drawn.figure.axes
    of_all: Any = left.lines[0].get_xydata()
    assert of_all[-1] == pytest.approx((12, 100 * made["recall_at_1"]))
    assert right.lines[0].get_xdata().tolist() == [4, 6, 8, 10, 12]


@pytest.mark.parametrize("options", [["stream=12"], ["stream=-1"], ["stream=true", "method=pca"]])
def test_what_cannot_grow_is_refused(options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["dataset.places=12", "dataset.first_query_place=0", *RUN, *options]) == 2
