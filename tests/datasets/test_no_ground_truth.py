"""Without a ground truth everything runs and nothing is judged, by every reader and in Python.

The frame of place k is a texture of its own, which query k shows with noise: what is retrieved first is known.
"""

from pathlib import Path

import numpy as np
import pytest
from image_folders import fill, numbered
from quick_runs import quick_runs
from small_plan import install
from textures import textures

import vprbench
from vprbench.cli import main
from vprbench.data.doctor import quick
from vprbench.datasets.folders import folders
from vprbench.datasets.image_list import image_list
from vprbench.datasets.utm_folders import utm_folders
from vprbench.datasets.vpr_bench import vpr_bench
from vprbench.errors import BadInput
from vprbench.report.report import Report

PLACES, QUERIES = 7, 5
NONE = {"ground_truth": "none"}


MADE = {
    "folders": lambda: folders(references=["a", "b"], queries="query", **NONE),
    "image_list": lambda: image_list(references=["a/list.csv", "b/list.csv"], queries="query/list.csv", **NONE),
    "utm_folders": lambda: utm_folders(root=".", database="ref", queries="query", **NONE),
    "vpr_bench": lambda: vpr_bench(root=".", **NONE),
    "Python": lambda: vprbench.dataset_of(["a", "b"], "query", **NONE),
}


@pytest.mark.parametrize("made", MADE)
def test_every_reference_is_a_place_and_no_query_has_a_right_one_whatever_their_names_and_numbers(
    made, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for folder, count in (("a", PLACES), ("b", 2), ("ref", PLACES + 2), ("query", QUERIES)):
        fill(Path(folder), numbered(count))
        Path(folder, "list.csv").write_text("\n".join(["image", *numbered(count)]))
    dataset = MADE[made]()
    assert (dataset.n_places, len(dataset.queries)) == (PLACES + 2, QUERIES)
    assert not any(map(len, dataset.positives))
    assert dataset.protocol["ground_truth"] == "none"
    assert not {"unmatched", "tolerance_places", "radius_metres"} & {*dataset.protocol}
    assert [f.level for f in quick(dataset) if f.check == "ground truth"] == ["note"]


@pytest.fixture
def drives(tmp_path, monkeypatch):
    """Stand beside a map and a drive of fewer queries; returns the options of a run."""
    quick_runs(monkeypatch)
    monkeypatch.chdir(tmp_path)
    textures(Path("map"), PLACES)
    textures(Path("drive"), QUERIES, noise=20)
    own = ["dataset.references=[map]", "dataset.queries=drive", "dataset.ground_truth=none"]
    return ["timing=none", "threads=1", "dataset=folders", *own]


def test_a_comparison_ranks_nothing_and_draws_no_accuracy(drives, capsys, monkeypatch, tmp_path):
    given = []
    install(monkeypatch, tmp_path)
    monkeypatch.setattr(Report, "write", lambda one, *_: given.append(one) or [])
    assert main(["compare", "methods=sad,hog", "metrics=[f1_max]", *drives]) == 0
    shown = capsys.readouterr().out
    assert all(word not in shown for word in ("R@", "AUC", "F1", "wrong", "miss"))
    found, best = given[0], given[0].predictions()
    assert {quantity.kind for quantity in found.quantities} == {"fit", "rate", "memory"}
    assert best["right"].isna().all()
    names = [*found.drawings]
    assert not any(part in name for name in names for part in ("recall", "precision", "similarity", "rate-", "frames"))
    assert main(["compare", "methods=sad", *drives, "corruptions=blur-1"]) == 2


def test_in_python_a_result_and_a_comparison_have_no_accuracy(drives):
    data = vprbench.dataset_of("map", "drive", **NONE)
    found = vprbench.compare(["sad", "hog"], data, metrics=["r100p"], timing="none")
    with pytest.raises(BadInput, match="corruptions=blur-1"):
        vprbench.compare(["no_such_method"], data, corruptions=["blur-1"])  # before anything is built
    result = found.results[0]
    frame = result.to_frame()
    assert (np.isnan(result.recall()), result.interval(), len(result.failures())) == (True, None, 0)
    assert frame["best_place"].tolist() == [*range(QUERIES)]
    assert frame["hit"].isna().all()
    two = result.predictions(2)["score"].to_numpy().reshape(QUERIES, 2)
    np.testing.assert_allclose(frame["margin"], two[:, 0] - two[:, 1], rtol=1e-6)
    assert all("R@" not in text for text in (repr(result), result._repr_html_(), found.to_markdown()))
