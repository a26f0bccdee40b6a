"""The benchmark of large maps draws what it says, measures each index apart, and keeps what it measured."""

import numpy as np
import pytest

from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.speed import maps
from vprbench.speed.maps import share_found, stored
from vprbench.speed.searching import Case, searched
from vprbench.speed.simulated import Simulated

pytestmark = pytest.mark.extended  # a benchmark takes its time


def test_found_is_the_share_of_the_exactly_best_places_and_a_process_that_takes_too_long_or_fails_says_why(tmp_path):
    exactly, found = np.array([[1, 2, 3], [4, 5, 6]]), np.array([[1, 9, 2], [5, 4, -1]])
    assert [share_found(found, exactly, n) for n in (1, 3)] == pytest.approx([1 / 2, 4 / 6])
    simulated = Simulated(tmp_path, 300, 4, seed=0)
    case = Case(simulated.written(), "flat", 0, simulated.queries(3), 0.0)
    with pytest.raises(BadInput, match="flat is unknown"):
        searched(case, 60)
    with pytest.raises(BadInput, match=r"libraries was not done after limit_minutes=0"):
        searched(case, 0)


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
    assert all(1e6 < exact[name] < 1e9 for name in ("libraries_bytes", "answering_bytes"))
    assert min(exact["building_seconds"], exact["query_seconds"], exact["batch_seconds"]) > 0

    def too_slow(*_):
        raise BadInput("too slow")

    monkeypatch.setattr(maps, "searched", too_slow)
    assert main([*asked, "indexes=[binary]", "keep=true"]) == 1
    assert (tmp_path / "there" / "vprbench-map-100x16-seed0").is_dir()
