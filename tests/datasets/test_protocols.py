"""Two ways to split the places of a dataset are never mixed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import figure_runs
import numpy as np
import pytest
import yaml
from assembled import table
from little import a_run
from stored_runs import ROWS, SAD, answers, run

from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.paper.growth import samples
from vprbench.paper.page import words
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.selection import ResolvedColumn, groups
from vprbench.plugins import registry
from vprbench.run.record import Run
from vprbench.run.store import Store
from vprbench.tuning.places import cut, querying, searchable


def config(name: str) -> dict[str, Any]:
    return dict(yaml.safe_load(registry.entries("dataset")[name].path.read_text(encoding="utf-8")))


def record(protocol: str, places: int = 12, held_out: int = 2) -> dict[str, Any]:
    """Return what a rendered dataset records of so many places."""
    left = places - held_out
    return {
        "protocol": protocol,
        "references": ["spring", "fall"],
        "query": "summer",
        "places": places,
        "query_places": left,
        **({"first_query_place": held_out} if protocol == "vprtempo" else {}),
        "reference_places": places if protocol == "vprtempo" else left,
        "held_out_places": held_out,
        "tolerance_places": 0,
    }


SYNTHETIC = {**config("synthetic"), "places": 12}


def asked_for(protocol: str, /, **changes: Any) -> Run:
    """Return a run of a rendered dataset under a protocol."""
    dataset = {**SYNTHETIC, "protocol": protocol}
    return run(dataset=dataset, **{"protocol": record(protocol), "fingerprint": protocol, **changes})


def test_the_answer_names_the_protocol(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick = ["timing.minimum_seconds=0", "timing.sample=4", "timing.minimum_queries=4", "threads=1"]
    asked = ["dataset=synthetic", "dataset.places=12", "dataset.protocol=vprsnn", f"results={tmp_path}"]
    assert main(["method=sad", *asked, *quick]) == 0
    (stored,) = Store(tmp_path).runs()
    assert (stored.protocol["protocol"], stored.protocol["held_out_places"]) == ("vprsnn", 2)
    assert "synthetic: 10 queries, 10 places (protocol vprsnn, references" in capsys.readouterr().out


# Columns


def column(protocol: str, *options: str) -> ResolvedColumn:
    planned = PlannedColumn(protocol, f"Railway, {protocol}", ("dataset=synthetic", *options), None)
    return ResolvedColumn(planned, {**SYNTHETIC, "protocol": protocol})


def test_runs_of_two_protocols_never_share_a_column() -> None:
    mine, other = asked_for("vprtempo"), asked_for("vprsnn")
    first, second = groups([mine, other], [], [column("vprtempo"), column("vprsnn")], ROWS)
    assert (first.runs, second.runs) == ((mine,), (other,))


@pytest.mark.parametrize(
    ("protocol", "words"),
    [
        (
            "vprtempo",
            "protocol vprtempo, references spring+fall, query summer, first query place 2, tolerance places 0",
        ),
        ("vprsnn", "protocol vprsnn, references spring+fall, query summer, held out places 2, tolerance places 0"),
    ],
)
def test_the_caption_of_a_column_names_its_protocol_and_no_count_twice(protocol: str, words: str) -> None:
    (made,) = table([asked_for(protocol)], rows=[SAD], asked=[column(protocol)]).columns
    assert made.protocol == words


def test_columns_of_other_sizes_are_told_apart_by_what_was_asked_and_not_by_what_follows() -> None:
    asked = ResolvedColumn(column("vprtempo").planned, {"name": "synthetic"})
    sizes = [asked_for("vprtempo", protocol=record("vprtempo", n), fingerprint=str(n)) for n in (12, 20)]
    titles = [made.title for made in table(sizes, rows=[SAD], asked=[asked]).columns]
    assert sorted(titles) == [
        "Railway, vprtempo, places 12, query places 10",
        "Railway, vprtempo, places 20, query places 18",
    ]


def test_the_report_says_what_a_protocol_means() -> None:
    told = [dict(words.protocol([a_run(protocol=record(protocol))])) for protocol in ("vprtempo", "vprsnn")]
    assert told[0]["Protocol"] == "vprtempo: all places are in the map, those before the first query place too"
    assert told[1]["Protocol"] == (
        "vprsnn: the places held out, drawn from all over the journey, are in neither the map nor the queries"
    )
    assert "held out places: 2" in told[1]["Also recorded"]
    of_its_own = dict(words.protocol([a_run(protocol={"protocol": "sift"})]))
    assert of_its_own["Also recorded"] == "protocol: sift"


def test_maps_of_other_sizes_are_one_growth_under_one_protocol_alone() -> None:
    row = Row("VPRTempo", "vprtempo", boundary="match")
    sized = [figure_runs.sized(n, 1.0, 0.001, protocol=record("vprtempo", n, n // 5)) for n in (100, 300)]
    assert samples(row, sized, ()).runs == tuple(sized)
    other = figure_runs.sized(500, 1.0, 0.001, protocol=record("vprsnn", 600, 100), time_utc="2024-01-01T00:00:00Z")
    assert samples(row, [*sized, other], ()).aside == ("Set aside: runs of VPRTempo at 500 places (other dataset).",)


# Searches of settings


def planned(*options: str) -> PlannedColumn:
    return PlannedColumn("a column", "A column", options)


@pytest.mark.parametrize("name", ["nordland", "synthetic"])
def test_nothing_is_searched_under_a_protocol_that_scatters_its_held_out_places(name: str) -> None:
    with pytest.raises(BadInput, match=r"dataset\.protocol=vprsnn: a search needs places in a row"):
        searchable(name, {**config(name), "protocol": "vprsnn"}, 20, [])


def test_a_column_that_scatters_its_held_out_places_leaves_none_in_a_row_to_search() -> None:
    scattered = planned("dataset=nordland", "dataset.protocol=vprsnn")
    with pytest.raises(BadInput, match="reported results query all of its 3300 places"):
        searchable("nordland", config("nordland"), 100, [scattered])
    rendered = planned("dataset=synthetic", "dataset.protocol=vprsnn")
    assert searchable("synthetic", config("synthetic"), 20, [rendered]).searched == range(20)


@pytest.mark.parametrize(("protocol", "named"), [("vprtempo", False), ("vprsnn", True)])
def test_a_stored_run_whose_queries_are_scattered_may_query_any_place(protocol: str, named: bool) -> None:
    nordland = config("nordland")
    stored = a_run(
        dataset="nordland",
        config={**a_run().config, "dataset": {**nordland, "protocol": protocol}},
        positives=tuple(np.array([place]) for place in (700, 701)),
        outcome=answers([1, 1]),
    )
    allowed = searchable("nordland", nordland, 500, [])
    assert querying([stored], allowed) == [f"nordland/little-{stored.key}"] * named


def test_a_stretch_that_is_searched_has_no_held_out_places() -> None:
    whole = registry.make_dataset(SYNTHETIC)
    assert whole.held_out is not None
    assert cut(whole, range(2, 8)).held_out is None
