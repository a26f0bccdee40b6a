"""What a method may choose its settings by, and what a run says of that."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from little import Lookup, Prototypes, journey, numbers_in, pictures, slow_pictures
from little_runs import asked_for, execute, kinds, run_of, table
from stopped_clock import Clock

from vprbench import progress
from vprbench.api.dataset import HeldOut
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.plugins import networks
from vprbench.runs.notes import Note

pytestmark = pytest.mark.usefixtures("surroundings")


def held_out(**changes):
    """Three places in two traverses, each queried once, the last one first."""
    given = {"references": pictures([50, 51, 52, 60, 61, 62]), "places": np.array([0, 1, 2] * 2), "in_map": False}
    return HeldOut(**{**given, "queries": pictures([72, 71, 70]), "right": np.array([2, 1, 0]), **changes})


def with_held_out(**changes):
    return replace(journey(6, 4), held_out=held_out(**changes))


@dataclass
class Choosing(Lookup):
    """Notes the calls that it gets; fits for 1 s and calibrates for 2 s, after a look at all images."""

    given: list[HeldOut] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    calibrates: bool = True
    clock: Clock = field(default_factory=Clock)

    def fit(self, references, places):
        self.calls.append("fit")
        list(references)
        self.clock.spend(1)
        return self

    def calibrate(self, held_out):
        self.calls.append("calibrate")
        self.given.append(held_out)
        assert [*held_out.references, *held_out.queries]
        self.clock.spend(2)
        return self

    def encode(self, images):
        self.calls.append("encode")
        return super().encode(images)


def test_other_held_out_places_have_another_fingerprint_and_key():
    for changes in (
        {"references": pictures([50, 51, 53, 60, 61, 62])},
        {"places": np.array([0, 2, 1, 0, 1, 2])},
        {"queries": pictures([72, 71, 73])},
        {"right": np.array([2, 0, 1])},
    ):
        assert held_out().fingerprint() == held_out().fingerprint() != held_out(**changes).fingerprint()
        datasets = [replace(journey(6, 4), held_out=held) for held in (None, held_out(), held_out(**changes))]
        for method in (Choosing(table(6, 4)), Lookup(table(6, 4))):
            assert len({asked_for(method, dataset).key() for dataset in datasets}) == 3


def test_held_out_parts_that_do_not_fit_one_another_are_refused():
    for changes, named in (
        ({"places": np.array([0, 1])}, "6 reference images but 2 place ids"),
        ({"places": np.array([0, 1, 3, 0, 1, 3])}, "from 0 to 3"),
        ({"right": np.array([0])}, "3 queries but 1 right places"),
        *(({"right": np.array([0, 1, wrong])}, "from 0 to 2") for wrong in (3, -1)),
    ):
        with pytest.raises(BadInput, match=named):
            held_out(**changes)


def test_a_method_is_calibrated_once_between_fit_and_first_query_on_images_without_their_names():
    method, stages = Choosing(table(6, 4)), []
    named = {
        part: Images.from_arrays(list(images), [f"place-{i}" for i in range(len(images))])
        for part, images in (("references", held_out().references), ("queries", held_out().queries))
    }
    with progress.send_reports_to(lambda stage, _: stages.append(stage)):
        run = run_of(method, with_held_out(**named))
    assert list(dict.fromkeys(stages)) == ["fit", "fit, reading images", "calibrate", "query", "timing"]
    assert method.calls[:3] == ["fit", "calibrate", "encode"]
    assert Note("calibrated", "calibrated on 3 held-out queries of 3 places") in run.notes
    (seen,) = method.given
    assert (numbers_in(seen.references), numbers_in(seen.queries)) == ([50, 51, 52, 60, 61, 62], [72, 71, 70])
    assert (seen.places.tolist(), seen.right.tolist(), seen.in_map) == ([0, 1, 2, 0, 1, 2], [2, 1, 0], False)
    assert seen.references.names == tuple(f"image {i}" for i in range(6))
    assert seen.queries.names == ("image 0", "image 1", "image 2")
    for part in (seen.places, seen.right):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 1
    for method, dataset in (  # without places, without a choice, with settings that were given
        (Choosing(table(6, 4)), journey(6, 4)),
        (Lookup(table(6, 4)), with_held_out()),
        (Choosing(table(6, 4), calibrates=False), with_held_out()),
    ):
        assert "calibrated" not in kinds(run_of(method, dataset))
        assert getattr(method, "given", []) == []


def test_calibrating_is_part_of_the_fit_and_its_waiting_for_images_of_no_computing(clock):
    slow = {"references": slow_pictures(6, 10, clock.spend), "queries": slow_pictures(3, 100, clock.spend)}
    dataset = replace(journey(6, 4), references=slow_pictures(4, 10, clock.spend))
    views = held_out(references=dataset.references[:2], places=np.arange(2), right=np.array([0, 1, 0]), in_map=True)
    for given, waited in (
        (with_held_out(**slow), 6 * 10 + 3 * 100),
        (replace(dataset, held_out=views), 4 * 10 + 2 * 10),  # which counts once
    ):
        run = run_of(Choosing(table(6, 4), clock=clock), given)
        assert (run.fit_seconds, run.fit_compute_seconds) == pytest.approx((waited + 3, 3))


@dataclass
class Sharpened(Prototypes):
    """Chooses its contrast by the number of held-out places, and stores it."""

    def calibrate(self, held_out):
        self.contrast = float(held_out.n_places)
        return self

    def state(self):
        return {**super().state(), "contrast": np.array(self.contrast)}

    def restore(self, state):
        self.contrast = float(state.pop("contrast"))
        return super().restore(state)


def test_a_stored_network_holds_what_was_chosen_and_nothing_is_chosen_anew(tmp_path):
    def run(method, dataset, **files):
        return execute(asked_for(method, dataset, files=networks.Files(**files)))

    path, plain = tmp_path / "network.safetensors", tmp_path / "plain.safetensors"
    trained = run(Sharpened(), with_held_out(), save=path)
    for dataset in (with_held_out(), journey(6, 4)):
        method = Sharpened()
        loaded = run(method, dataset, load=path)
        assert method.contrast == 3.0
        assert np.array_equal(loaded.top_scores, trained.top_scores)
        assert "calibrated" not in kinds(loaded)
    other = with_held_out(queries=pictures([72, 71, 73]))
    with pytest.raises(BadInput, match="other held-out places"):
        run(Sharpened(), other, load=path)
    run(Prototypes(), with_held_out(), save=plain)  # chooses nothing, so any places will do
    assert run(Prototypes(), other, load=plain).load_seconds is not None
