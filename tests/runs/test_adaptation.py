"""An argument that does not fit a map is changed and said where nobody set it, and refused where somebody did."""

import pytest
from small_plan import RUN, install

from vprbench.cli import main
from vprbench.jobs import executors, job
from vprbench.jobs.job import JobResult
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.paper import missing_runs
from vprbench.paper.missing_runs import MissingRun
from vprbench.paper.plan import Row
from vprbench.runs.compose import composed
from vprbench.runs.store import Store

SMALL = {"height": 12, "width": 12, "epochs": 1}
DATASET = ["dataset=synthetic", "dataset.places=12", "dataset.first_query_place=2"]
ASKED = ["method=vprtempo", *(f"method.{name}={value}" for name, value in SMALL.items()), *DATASET, *RUN]


@pytest.fixture(scope="module")
def adapted(tmp_path_factory):
    """A folder with the run of a network whose module is larger than the map."""
    folder = tmp_path_factory.mktemp("adapted")
    with pytest.MonkeyPatch.context() as monkeypatch:
        install(monkeypatch, folder)
        assert main(ASKED) == 0
    return folder


def test_an_argument_that_nobody_set_is_adapted_noted_and_recorded_apart_from_what_was_asked(adapted):
    (run,) = Store(adapted / "results", read_only=True).runs()
    assert (run.config["adapted"], run.config["method"]["max_module"]) == ({"max_module": 12}, 12)
    assert run.config["changed"] == SMALL
    (note,) = (note for note in run.notes if note.kind == "adapted")
    assert "max_module=12" in note.text
    adaptations = (VPRTempo().adapted(1100), VPRTempo(max_module=8).adapted(7), SAD().adapted(1))
    assert adaptations == ({}, {"max_module": 7}, {})


@pytest.mark.parametrize(("arguments", "n_processes"), [({}, 0), ({"max_module": 12}, 0), ({"max_module": 6}, 1)])
def test_a_process_is_started_unless_an_adapted_run_of_these_arguments_is_stored(
    adapted, monkeypatch, arguments, n_processes
):
    asked = []
    monkeypatch.setattr(executors, "run_job", lambda *given, **_: asked.append(given) or JobResult(0))
    changed = {**SMALL, **arguments}
    wish = MissingRun(Row("VPRTempo", "vprtempo"), "Route", tuple(DATASET), {"name": "synthetic"}, changed, 0, "cpu")
    store = Store(adapted / "results")
    assert missing_runs.fill([wish], RUN, store, lambda options: composed(list(options))) == [JobResult(0)]
    assert len(asked) == n_processes


def test_what_was_set_by_hand_and_does_not_fit_is_refused_before_anything_is_made(tmp_path, monkeypatch, capsys):
    install(monkeypatch, tmp_path)
    monkeypatch.setattr(job, "current", None)
    for places in (13, 1100):  # 1100 is the default, and yet set
        assert main([*ASKED, f"method.max_module={places}"]) == 2
        assert f"method.max_module={places}" in capsys.readouterr().err
    assert not list((tmp_path / "results").glob("*/*"))
