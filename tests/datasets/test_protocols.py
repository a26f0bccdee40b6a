"""Two ways to split the places of a dataset are never mixed: in columns, captions, growth and searches."""

import figure_runs
import numpy as np
import pytest
import yaml
from assembled import table
from little import a_run
from stored_runs import ROWS, SAD, answers, run

from vprbench.errors import BadInput
from vprbench.paper.growth import samples
from vprbench.paper.page import words
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.selection import ResolvedColumn, groups
from vprbench.plugins import registry
from vprbench.tuning.places import cut, querying, searchable


def config(name):
    return dict(yaml.safe_load(registry.entries("dataset")[name].path.read_text(encoding="utf-8")))


SYNTHETIC, NORDLAND = {**config("synthetic"), "places": 12}, config("nordland")


def record(protocol, places=12, held_out=2):
    """Return what a rendered dataset records of so many places."""
    left = places - held_out
    return {
        **{"protocol": protocol, "references": ["spring", "fall"], "query": "summer", "places": places},
        **({"first_query_place": held_out} if protocol == "vprtempo" else {}),
        **{"query_places": left, "reference_places": places if protocol == "vprtempo" else left},
        **{"held_out_places": held_out, "tolerance_places": 0},
    }


def asked_for(protocol, /, places=12):
    """Return a run of a rendered dataset under a protocol."""
    given = {"protocol": record(protocol, places), "fingerprint": f"{protocol}{places}"}
    return run(dataset={**SYNTHETIC, "protocol": protocol}, **given)


def column(protocol, **dataset):
    planned = PlannedColumn(protocol, f"Railway, {protocol}", ("dataset=synthetic",), None)
    return ResolvedColumn(planned, dataset or {**SYNTHETIC, "protocol": protocol})


def test_runs_of_two_protocols_never_share_a_column_whose_caption_names_its_protocol_and_no_count_twice():
    runs, columns = [asked_for("vprtempo"), asked_for("vprsnn")], [column("vprtempo"), column("vprsnn")]
    assert [group.runs for group in groups(runs, [], columns, ROWS)] == [(mine,) for mine in runs]
    captions = [made.protocol for made in table(runs, rows=[SAD], asked=columns).columns]
    assert captions == [
        f"protocol {name}, references spring+fall, query summer, {size}, tolerance places 0"
        for name, size in (("vprtempo", "first query place 2"), ("vprsnn", "held out places 2"))
    ]


def test_columns_of_other_sizes_are_told_apart_by_what_was_asked_and_not_by_what_follows():
    sizes = [asked_for("vprtempo", places) for places in (12, 20)]
    titles = [made.title for made in table(sizes, rows=[SAD], asked=[column("vprtempo", name="synthetic")]).columns]
    assert sorted(titles) == [
        "Railway, vprtempo, places 12, query places 10",
        "Railway, vprtempo, places 20, query places 18",
    ]


def test_the_report_says_what_a_protocol_means():
    protocols = (record("vprtempo"), record("vprsnn"), {"protocol": "sift"})
    vprtempo, vprsnn, own = (dict(words.protocol([a_run(protocol=protocol)])) for protocol in protocols)
    assert vprtempo["Protocol"].startswith("vprtempo: all places are in the map")
    assert vprsnn["Protocol"].endswith("are in neither the map nor the queries")
    assert "held out places: 2" in vprsnn["Also recorded"]
    assert own["Also recorded"] == "protocol: sift"


def test_maps_of_other_sizes_are_one_growth_under_one_protocol_alone():
    row = Row("VPRTempo", "vprtempo", boundary="match")
    sized = [figure_runs.sized(n, 1.0, 0.001, protocol=record("vprtempo", n, n // 5)) for n in (100, 300)]
    assert samples(row, sized, ()).runs == tuple(sized)
    other = figure_runs.sized(500, 1.0, 0.001, protocol=record("vprsnn", 600, 100), time_utc="2024-01-01T00:00:00Z")
    assert samples(row, [*sized, other], ()).aside == ("Set aside: runs of VPRTempo at 500 places (other dataset).",)


# Searches of settings


def test_nothing_is_searched_under_a_protocol_or_beside_a_column_that_scatters_its_held_out_places():
    with pytest.raises(BadInput, match=r"dataset\.protocol=vprsnn: a search needs places in a row"):
        searchable("nordland", {**NORDLAND, "protocol": "vprsnn"}, 20, [])
    nordland, rendered = (
        PlannedColumn("a column", "A column", (f"dataset={name}", "dataset.protocol=vprsnn"))
        for name in ("nordland", "synthetic")
    )
    with pytest.raises(BadInput, match="reported results query all of its 3300 places"):
        searchable("nordland", NORDLAND, 100, [nordland])
    assert searchable("synthetic", config("synthetic"), 20, [rendered]).searched == range(20)
    whole = registry.make_dataset(SYNTHETIC)
    assert whole.held_out is not None
    assert cut(whole, range(2, 8)).held_out is None


@pytest.mark.parametrize(("protocol", "named"), [("vprtempo", False), ("vprsnn", True)])
def test_a_stored_run_whose_queries_are_scattered_may_query_any_place(protocol, named):
    stored = a_run(
        dataset="nordland",
        config={**a_run().config, "dataset": {**NORDLAND, "protocol": protocol}},
        positives=tuple(np.array([place]) for place in (700, 701)),
        outcome=answers([1, 1]),
    )
    assert querying([stored], searchable("nordland", NORDLAND, 500, [])) == [f"nordland/little-{stored.key}"] * named
