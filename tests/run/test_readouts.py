"""Readouts: what the cosines of codes and layers find, on their own formula, stored with a run and printed below it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey
from little_runs import asked_for, kinds, run_of
from small_plan import RUN

from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.errors import NotFittedError
from vprbench.methods.pca import PCA
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.run import runner
from vprbench.run.note import Note
from vprbench.run.readout_rows import readout_numbers, readout_text
from vprbench.run.record import Run, content_key
from vprbench.run.store import Store

SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}

pytestmark = pytest.mark.usefixtures("surroundings")

TURNED = np.array([[1, 0], [0, 1], [-1, 0], [0.6, 0.8]], np.float32)  # what each picture looks like to the layer


@dataclass
class Layered(Lookup):
    """A lookup with codes of two numbers, and one layer that knows four directions and doubles the length."""

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        return np.array([[1, number] for number in super().encode(images)], np.float32)

    def match(self, codes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return self.table[codes[:, 1].astype(int)]

    def layers(self, codes: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[Any]]:
        return {"turned": 2 * TURNED[codes[:, 1].astype(int)], "silent": np.zeros((len(codes), 5))}


def read_run(method: Method, dataset: Any, **changes: Any) -> Run:
    return runner.run(replace(asked_for(method, dataset), readouts=True, **changes), "key")


def test_codes_layers_and_answer_are_judged_by_the_same_right_places() -> None:
    # By codes and by the turned layer each picture finds itself, which is right for the first and the last alone.
    dataset = journey(4, 4, [[0], [3], [0], [3]])
    method = Layered(np.array([[0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 1, 0]], np.float32))
    found = readout_numbers(read_run(method, dataset))
    assert found is not None
    assert [(each["name"], each["neurons"], each["recall_at_1"]) for each in found] == [
        ("codes", 2, 0.5),
        ("turned", 2, 0.5),
        ("silent", 5, 0.25),  # four places tie for every query
        ("answer", 4, 0.5),
    ]
    # Wilson's interval of two hits in four.
    assert (found[0]["recall_at_1_low"], found[0]["recall_at_1_high"]) == pytest.approx((0.150, 0.850), abs=0.001)


def test_a_place_is_worth_its_most_similar_image_and_a_layer_its_direction() -> None:
    class Longer(Layered):
        def layers(self, codes: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[Any]]:
            numbers = codes[:, 1].astype(int)
            return {"turned": TURNED[numbers] * (1 + numbers[:, None])}  # the last is the longest

    dataset = replace(journey(3, 4, [[0], [1], [0]]), places=np.array([0, 1, 0, 1]))
    run = read_run(Longer(np.zeros((3, 2), np.float32)), dataset)
    assert run.readouts is not None
    assert run.readouts[1] == {"name": "turned", "neurons": 2, "hits": [1.0, 1.0, 1.0]}


def test_readouts_are_stored_and_runs_of_earlier_versions_have_none(tmp_path: Path) -> None:
    dataset, store = journey(4, 4), Store(tmp_path)
    method = Layered(np.eye(4, dtype=np.float32))
    read, plain = read_run(method, dataset), replace(run_of(method, dataset), key="other")
    for run in (read, plain):
        store.save(run)
    earlier = store.folder("journey", "little", "other") / "run.json"
    summary = json.loads(earlier.read_text())
    del summary["readouts"], summary["content_key"]  # as versions before wrote it
    earlier.write_text(json.dumps({**summary, "content_key": content_key(summary)}))
    assert {run.key: run.readouts for run in store.runs()} == {"key": read.readouts, "other": None}


def test_a_method_without_layers_says_so_and_one_whose_layers_fail_keeps_its_run() -> None:
    class Failing(Layered):
        def layers(self, codes: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[Any]]:
            raise KeyError("gone")

    dataset, table = journey(4, 4), np.eye(4, dtype=np.float32)
    plain = read_run(Lookup(table), dataset)
    assert plain.readouts == []
    assert readout_text(plain) == "readouts: none, little learns no layer that it shows"
    failed = read_run(Failing(table), dataset)
    assert failed.readouts is None
    assert Note("readouts", "no layer was read (KeyError: 'gone')") in failed.notes
    assert "readouts" not in kinds(plain)


# The methods


def fitted(method: Method) -> tuple[Any, npt.NDArray[Any]]:
    world = Journey.draw(0)
    method.fit(Images.from_arrays(world.references), world.places)
    return method, method.encode(Images.from_arrays(world.queries))


def test_the_feature_layer_of_vprtempo_is_what_its_query_passes() -> None:
    spiking, codes = fitted(VPRTempo(**SMALL))
    feature = next(layer for layer in spiking.spikes(codes) if layer.name == "feature")
    assert {name: values.tolist() for name, values in spiking.layers(codes).items()} == {
        "feature": feature.values.tolist()
    }
    linear, codes = fitted(VPRTempo(**SMALL, query_rule="linear"))
    sums = np.einsum("np,mfp->nmf", codes, linear.state()["features"]).reshape(len(codes), -1)
    assert linear.layers(codes)["feature"] == pytest.approx(sums, abs=1e-4)
    with pytest.raises(NotFittedError):
        VPRTempo(**SMALL).layers(codes)


def test_an_ensemble_shows_the_features_of_all_its_networks_side_by_side() -> None:
    both, codes = fitted(VPRTempoEnsemble(**SMALL, members=2, seed=3))
    each = [fitted(VPRTempo(**SMALL, seed=seed))[0].layers(codes)["feature"] for seed in (3, 4)]
    assert both.layers(codes)["feature"] == pytest.approx(np.hstack(each), abs=1e-5)


def test_the_cosine_of_the_components_of_pca_is_its_answer() -> None:
    method, codes = fitted(PCA(components=5))
    references = method.layers(method.encode(Images.from_arrays(Journey.draw(0).references)))["components"]
    similarity = method.layers(codes)["components"] @ references.T
    best = np.maximum(similarity[:, :20], similarity[:, 20:])  # of both traverses
    assert method.match(codes) == pytest.approx(best, abs=1e-5)


# On the command line


def asked(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["method=pca", "dataset.places=12", "dataset.first_query_place=0", *RUN, *options]) == 0
    return capsys.readouterr().out


def test_readouts_are_a_table_below_the_row_and_a_list_in_json_and_stay_with_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert json.loads(asked(capsys, "output=json"))["readouts"] is None
    made = json.loads(asked(capsys, "output=json", "readouts=true", "save=map.safetensors"))
    assert made["from_store"] is False  # the stored run had none
    assert [each["name"] for each in made["readouts"]] == ["codes", "components", "answer"]
    assert made["readouts"][2]["recall_at_1"] == made["recall_at_1"]
    assert made["readouts"][2]["recall_at_1_low"] == made["recall_at_1_low"]
    loaded = json.loads(asked(capsys, "output=json", "readouts=true", "load=map.safetensors"))
    assert loaded["readouts"] == made["readouts"]
    assert json.loads(asked(capsys, "output=json", "force=true"))["readouts"] == made["readouts"]
    table = asked(capsys, "readouts=true")
    names = [line.split("  ")[0] for line in table.splitlines()]
    assert names[names.index("readout") :][:4] == ["readout", "codes, cosine", "components, cosine", "answer"]
    assert "readout" not in asked(capsys)
