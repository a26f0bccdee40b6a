"""The benchmark of large maps draws what it says, measures each index apart, and keeps what it measured."""

import shutil
from collections import namedtuple

import numpy as np
import pytest

from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.paper.figures.maps import MapCost
from vprbench.paper.figures.maps import maps as drawn
from vprbench.speed import maps
from vprbench.speed.maps import keep, share_found, stored, text_of
from vprbench.speed.searching import Case, searched
from vprbench.speed.simulated import AREA, SEEN_AGAIN, WITHIN, Simulated

pytestmark = pytest.mark.extended  # a benchmark takes its time


def row(index="binary", places=10_000, **changed):
    times = {"building_seconds": 2.0, "query_seconds": 0.001, "batch_seconds": 0.0005, "others": 0.0}
    memory = {"bytes_per_place": 8, "libraries_bytes": 30e6, "building_bytes": 40e6, "answering_bytes": 50e6}
    asked = {"dimensions": "64", "places": str(places), "index": index, "rerank": "0" if index == "exact" else "100"}
    about = {"found_at_1": 0.5, "found_at_10": 0.25, "queries": 5, "threads": 1, "machine": "a machine"}
    return {**asked, **times, **memory, **about, **changed}


def test_places_of_an_area_are_alike_and_queries_are_noisy_copies(tmp_path):
    simulated = Simulated(tmp_path, 8 * AREA, 512, seed=1)
    vectors, queries = simulated.written()[:], simulated.queries(8 * AREA)
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(1, abs=1e-5)
    between = (vectors @ vectors.T).reshape(8, AREA, 8, AREA).swapaxes(1, 2)
    own = between[range(8), range(8)][:, ~np.eye(AREA, dtype=bool)]
    assert own.mean() == pytest.approx(WITHIN, abs=0.03)
    assert between[~np.eye(8, dtype=bool)].mean() == pytest.approx(0, abs=0.03)
    assert (queries * vectors).sum(1).mean() == pytest.approx(SEEN_AGAIN, abs=0.01)
    assert not np.array_equal(vectors, Simulated(tmp_path, 8 * AREA, 512, seed=2).written()[:])


def test_descriptors_that_lie_there_stay_missing_ones_are_drawn_as_before_and_need_room(tmp_path, monkeypatch):
    simulated = Simulated(tmp_path, 3000, 4, seed=0)
    vectors = np.array(simulated.written()[:])
    first, second, *_ = sorted(simulated.folder.glob("*.npy"))
    before = first.stat().st_mtime_ns
    second.unlink()
    assert np.array_equal(simulated.written()[:], vectors)
    assert first.stat().st_mtime_ns == before
    simulated.remove()
    assert not simulated.folder.exists()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: namedtuple("Usage", "free")(10))
    with pytest.raises(BadInput, match=r"take 0\.0 GB, 0\.0 GB are free in .*: give folder="):
        Simulated(tmp_path, 3000, 4, seed=0).written()
    assert [*tmp_path.iterdir()] == []


def test_found_is_the_share_of_the_exactly_best_places_and_a_process_that_takes_too_long_or_fails_says_why(tmp_path):
    exactly, found = np.array([[1, 2, 3], [4, 5, 6]]), np.array([[1, 9, 2], [5, 4, -1]])
    assert [share_found(found, exactly, n) for n in (1, 3)] == pytest.approx([1 / 2, 4 / 6])
    simulated = Simulated(tmp_path, 300, 4, seed=0)
    case = Case(simulated.written(), "flat", 0, simulated.queries(3), 0.0)
    with pytest.raises(BadInput, match="flat is unknown"):
        searched(case, 60)
    with pytest.raises(BadInput, match=r"libraries was not done after limit_minutes=0"):
        searched(case, 0)


def test_rows_replace_earlier_ones_and_are_compared_with_exact_search_and_extrapolated(tmp_path):
    path = tmp_path / "maps.csv"
    for each in (row(), row("exact"), row(places=1000), row(query_seconds=0.002), row("hnsw", failed="too slow")):
        keep(path, each)
    kept = [[each[name] for name in ("places", "index", "query_seconds", "failed")] for each in stored(path)]
    of_10_000 = [["binary", 0.002, None], ["exact", 0.001, None], ["hnsw", 0.001, "too slow"]]
    assert kept == [[1000, "binary", 0.001, None], *([10_000, *each] for each in of_10_000)]
    path = tmp_path / "others.csv"
    keep(path, row("all", places=10**9, rerank="0", failed="left out: large"))
    for places, seconds in ((1000, 5.0), (10_000, 0.001), (1_000_000, 0.01)):  # grows as the root
        keep(path, row(places=places, query_seconds=seconds, building_seconds=places / 1e4))
    keep(path, row("exact", places=1_000_000, query_seconds=0.5, libraries_bytes=None, building_bytes=None))
    rows = [line.split("|")[1:-1] for line in text_of(stored(path)).splitlines() if line.startswith("| 64")]
    lines = {(cells[1].strip(), cells[3].strip()): [cell.strip() for cell in cells] for cells in rows}
    measured = ["100", "8", "40 / 50", "100", "50", "2,000 (5)", "50.0 / 25.0", "0.0"]
    assert lines["1,000,000", "binary + rerank 100"][4:] == measured
    assert lines["1,000,000", "exact"][6] == "? / 50"
    assert lines["1,000,000,000", "all"][4:] == ["left out: large"]
    larger = lines["10^9", "binary + rerank 100"][4:]
    assert larger == ["10,000 and 1,000,000", "8", "256", "27.8 (b 1.00)", "0.316 (b 0.50)"]
    assert ("10^8", "exact") not in lines
    keep(path, row(places=1_000_000, others=1.5))
    disturbed = text_of(stored(path))
    assert ("| about 500 " in disturbed, "10^9" in disturbed) == (True, False)


def test_the_figure_draws_each_index_by_the_length_of_its_descriptors():
    costs = [MapCost(name, 64, 10 * n, 1.0 * n, 0.001, 1e6) for name in ("exact", "binary") for n in (1, 2)]
    figure = drawn([*costs, MapCost("exact", 512, 10, 3.0, 0.002, 2e6)]).figure
    building, longer, query = figure.axes[:3]
    assert [line.get_ydata().tolist() for line in building.lines] == [[1, 2], [1, 2]]
    assert [len(line.get_ydata()) for line in longer.lines] == [1, 0]
    assert query.lines[0].get_ydata().tolist() == [1, 1]  # milliseconds


def test_the_command_measures_indexes_beside_exact_search_and_one_that_cannot_be_built_is_the_exit_code(
    tmp_path, capsys, monkeypatch
):
    asked = ["bench-maps", "quick=true", "places=[100]", "threads=1", f"results={tmp_path}", f"folder={tmp_path}/there"]
    assert main([*asked, "indexes=[ivfpq]"]) == 1
    printed = capsys.readouterr().out
    assert "no number means anything" in printed
    assert "needs at least 256 reference images" in printed
    assert (tmp_path / "maps-quick.md").read_text() in printed
    assert (tmp_path / "figures" / "maps-quick.png").exists()
    assert [*(tmp_path / "there").iterdir()] == []
    rows = {each["index"]: each for each in stored(tmp_path / "maps-quick.csv")}
    exact = rows.pop("exact")
    assert (exact["found_at_1"], exact["found_at_10"], exact["rerank"], rows["ivfpq"]["rerank"]) == (1, 1, 0, 20)
    assert 1e6 < exact["libraries_bytes"] < exact["answering_bytes"] < 1e9
    assert min(exact["building_seconds"], exact["query_seconds"], exact["batch_seconds"]) > 0

    def too_slow(*_):
        raise BadInput("too slow")

    monkeypatch.setattr(maps, "searched", too_slow)
    assert main([*asked, "indexes=[binary]", "keep=true"]) == 1
    assert (tmp_path / "there" / "vprbench-map-100x16-seed0").is_dir()
