"""VPRTempo as a method: its query against a slow oracle, its arguments, its seeds and what it refuses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt
import pytest
import torch
import yaml
from checkout import ROOT

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation
from vprbench.errors import BadInput, NotFittedError, TrainingDivergedError
from vprbench.methods.vprtempo.layer import Layer
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.query import asking
from vprbench.methods.vprtempo.rules import (
    PAPER,
    RULES,
    V1,
    QueryRule,
    Rules,
    RuleSet,
)
from vprbench.plugins.rules import Journey

Floats = npt.NDArray[np.float64]

N_PLACES = 20
SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}  # modules of 8, 8 and 4 places
WORLD = Journey.draw(0)
YAML = ROOT / "conf" / "method" / "vprtempo.yaml"


def images(arrays: Sequence[npt.NDArray[np.uint8]]) -> Images:
    return Images.from_arrays(list(arrays))


def fitted(**arguments: Any) -> VPRTempo:
    return VPRTempo(**{**SMALL, **arguments}).fit(images(WORLD.references), WORLD.places)


def scores_of(**arguments: Any) -> npt.NDArray[np.float32]:
    return fitted(**arguments).query(images(WORLD.queries))


# --- seeds and modules ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("query_rule", get_args(QueryRule))
def test_places_come_module_by_module_and_without_the_padding_of_the_last(query_rule: QueryRule) -> None:
    # One pixel, one feature neuron; the weight of place p is (p + 1) / 10, the padded neuron's 0.9.
    rest = (torch.zeros(2, 3), torch.zeros(2, 3))
    features = Layer(torch.ones(2, 1, 1), torch.zeros(2, 1, 1), None, None, torch.zeros(2, 1), torch.zeros(2, 1))
    excitation = torch.tensor([[[0.1], [0.2], [0.3]], [[0.4], [0.5], [0.9]]])
    outputs = Layer(excitation, torch.zeros(2, 3, 1), None, None, *rest)
    query = asking([Network.of(features, outputs, [3, 2])], replace(PAPER, query_rule=query_rule))
    found = query.scores(np.array([[0.5]], np.float32))[0].tolist()
    assert found == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.25])


@pytest.mark.parametrize("rules", get_args(RuleSet))
def test_references_are_mostly_recognised(rules: RuleSet) -> None:
    scores = fitted(rules=rules).query(images(WORLD.references[:N_PLACES]))
    assert np.mean(scores.argmax(1) == np.arange(N_PLACES)) > 0.5


@pytest.mark.parametrize("rules", get_args(RuleSet))
def test_the_seed_decides_about_the_scores(rules: RuleSet) -> None:
    one, again, other = (scores_of(rules=rules, seed=seed) for seed in (1, 1, 0))
    assert np.array_equal(one, again)
    assert not np.allclose(one, other, rtol=0.01)


def test_the_first_module_learns_the_same_whether_or_not_others_follow() -> None:
    first = np.flatnonzero(WORLD.places < 8)
    alone = VPRTempo(**SMALL).fit(images([WORLD.references[i] for i in first]), WORLD.places[first])
    queries = images(WORLD.queries)
    assert fitted().query(queries)[:, :8] == pytest.approx(alone.query(queries), abs=1e-6)


def test_modules_draw_differently() -> None:
    # The same references in both modules: equal draws would give equal scores.
    half = WORLD.references[:8]
    twice = VPRTempo(**SMALL).fit(images([*half, *half]), np.arange(16))
    scores = twice.query(images(WORLD.queries))
    assert not np.allclose(scores[:, :8], scores[:, 8:], rtol=0.01)


# --- arguments --------------------------------------------------------------------------------------------------

CHOICES = [field.name for field in fields(Rules)]


def another_value(name: str) -> Any:
    """Return a value that the paper's rules do not have."""
    said = getattr(PAPER, name)
    if isinstance(said, bool):
        return not said
    if isinstance(said, str):
        return next(option for option in get_args(get_type_hints(Rules)[name]) if option != said)
    return said + 1


@pytest.mark.parametrize("rules", get_args(RuleSet))
def test_arguments_of_none_leave_the_rules_as_they_are(rules: RuleSet) -> None:
    assert VPRTempo(rules=rules).chosen_rules() == RULES[rules]


@pytest.mark.parametrize("name", CHOICES)
def test_an_argument_replaces_the_one_choice_of_its_name(name: str) -> None:
    value = another_value(name)
    assert VPRTempo(rules="paper", **{name: value}).chosen_rules() == replace(PAPER, **{name: value})


def test_the_arguments_of_one_version_turn_the_paper_into_it() -> None:
    choices = {name: getattr(V1, name) for name in CHOICES}
    assert np.array_equal(scores_of(rules="paper", **choices), scores_of(rules="v1"))


@pytest.mark.parametrize(
    "arguments",
    [
        {"preprocessing": "A"},
        {"height": 13},
        {"width": 13},
        {"patch": 5},
        {"max_module": 10},
        {"features_per_pixel": 1.5},
        {"epochs": 3},
        {"stdp_rate": 0.004},
        {"itp_rate": 0.1},
        {"threshold_max": 0.4},
        {"rate_min": 0.3},
        {"rate_max": 0.8},
        {"p_excitatory": 0.2},
        {"p_inhibitory": 0.4},
        # No query here is silent: silent_winner has tests of its own above.
        *({name: another_value(name)} for name in CHOICES if name not in ("silent_winner", "clip")),
        {"clip": 0.1},
    ],
    ids=lambda arguments: next(iter(arguments)),
)
def test_every_argument_changes_the_scores(arguments: dict[str, Any]) -> None:
    # The modules train for 64 steps, so that annealing every 100 would never act.
    usual = {"annealing_interval": 10}
    assert not np.allclose(scores_of(**{**usual, **arguments}), scores_of(**usual), rtol=1e-3)


def test_the_configuration_has_every_argument_and_its_default() -> None:
    configured = yaml.safe_load(YAML.read_text())
    own = {field.name: field.default for field in fields(VPRTempo) if not field.name.startswith("_")}
    assert set(configured) - {"_target_", "tags"} == set(own)
    for name in set(own) - {"seed", "device"}:
        assert configured[name] == own[name], name


def test_the_defaults_are_those_of_table_1() -> None:
    method = VPRTempo()
    table = (method.threshold_max, method.stdp_rate, method.itp_rate, method.rate_min, method.rate_max)
    assert (*table, method.p_excitatory, method.p_inhibitory) == (0.5, 0.005, 0.15, 0.2, 0.9, 0.1, 0.5)
    assert (PAPER.constant_input, V1.constant_input) == (0.1, 0.1)


# --- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ({"max_module": 21}, r"20 places .* method\.max_module=21.* method\.max_module=20"),
        ({"epochs": 0}, r"method\.epochs=0"),
        ({"max_module": 0}, r"method\.max_module=0"),
        ({"features_per_pixel": 0.0}, r"method\.features_per_pixel=0"),
        ({"output_stdp_rate": -0.1}, r"method\.output_stdp_rate=-0\.1"),
        ({"itp_rate": np.nan}, r"method\.itp_rate=nan"),
        ({"rate_min": 0.95}, r"method\.rate_min=0\.95"),
        ({"p_excitatory": 1.5}, r"method\.p_excitatory=1\.5"),
        ({"clip": 0.0}, r"method\.clip=0"),
        ({"annealing_interval": 0}, r"method\.annealing_interval=0"),
        ({"rules": "reference", "equal_output_weights": True}, "equal_output_weights"),
    ],
    ids=str,
)
def test_arguments_under_which_there_is_no_network_are_refused_by_name(arguments: dict[str, Any], wanted: str) -> None:
    with pytest.raises(BadInput, match=wanted):
        fitted(**arguments)


def test_exactly_one_module_of_places_is_accepted() -> None:
    assert scores_of(max_module=20).shape == (len(WORLD.queries), 20)


@pytest.mark.parametrize("rules", get_args(RuleSet))
def test_absurd_learning_rates_raise_a_diverged_training(rules: RuleSet) -> None:
    with pytest.raises(TrainingDivergedError, match="training diverged"):
        fitted(rules=rules, stdp_rate=50.0)


@pytest.mark.parametrize(("size", "n_alike"), [((48, 64), 11), ((48, 64), 20), ((1, 1), 20)])
def test_references_that_show_nothing_are_called_so_and_no_diverged_training(
    size: tuple[int, int], n_alike: int
) -> None:
    empty = [np.zeros((*size, 3), np.uint8)] * n_alike
    with pytest.raises(BadInput, match=f"{n_alike} of 20 images.* same input"):
        VPRTempo(**SMALL).fit(images([*empty, *WORLD.references[n_alike:20]]), np.arange(20))


def test_a_diverged_training_leaves_the_method_unfitted() -> None:
    method = fitted()
    method.stdp_rate = 50.0
    with pytest.raises(TrainingDivergedError):
        method.fit(images(WORLD.references), WORLD.places)
    with pytest.raises(NotFittedError):
        method.query(images(WORLD.queries))


# --- inputs -----------------------------------------------------------------------------------------------------


@pytest.fixture
def torch_warns_every_time() -> Iterator[None]:
    """PyTorch warns of an array that cannot be written to only once in a process."""
    before = torch.is_warn_always_enabled()
    torch.set_warn_always(True)
    yield
    torch.set_warn_always(before)


@pytest.mark.usefixtures("torch_warns_every_time")
def test_fit_changes_neither_images_nor_places_nor_the_global_generator_and_takes_unwritable_places() -> None:
    world, untouched = Journey.draw(0), Journey.draw(0)
    world.places.flags.writeable = False  # as the harness gives them
    before = torch.random.get_rng_state()
    VPRTempo(**SMALL).fit(images(world.references), world.places)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert np.array_equal(np.stack(world.references), np.stack(untouched.references))
    assert np.array_equal(world.places, untouched.places)


@pytest.mark.parametrize("variant", ["A", "B", "C"])
def test_spikes_are_the_levels_over_255_in_variant_c_by_the_8_bit_step(variant: Any) -> None:
    # One dark pixel: in its window all others are alike and only somewhat above the mean, so no level is 255. There
    # the step of C rounds a level of k to the next of 0, M / 255, 2 M / 255 ... M, M the image's largest level.
    image = np.full((12, 12, 3), 150, np.uint8)
    image[3, 3] = 100
    shown = images([*WORLD.queries, image])
    levels = PatchNormalisation(variant, 12, 12, 7)(shown).astype(np.float64)
    largest = levels.max(1, keepdims=True)
    assert 127 < largest[-1] < 255
    expected = np.round(levels * 255 / largest) * largest / 255 / 255 if variant == "C" else levels / 255
    found = VPRTempo(preprocessing=variant, height=12, width=12).encode(shown)
    assert found.dtype == np.float32
    assert found == pytest.approx(expected, abs=1e-6)


# --- another device ---------------------------------------------------------------------------------------------


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device that PyTorch can use")
@pytest.mark.parametrize("rules", get_args(RuleSet))
def test_a_network_trained_on_cuda_ranks_places_as_one_trained_on_the_cpu(rules: RuleSet) -> None:
    # The CPU learns module after module, a GPU all of them at once; what rounding parts is no difference in rank.
    on_cpu, on_cuda = (scores_of(rules=rules, device=device) for device in ("cpu", "cuda"))
    in_order_of_cuda = np.take_along_axis(on_cpu, on_cuda.argsort(1), axis=1)
    assert np.diff(in_order_of_cuda, axis=1).min() > -1e-4


# --- initial output weights -------------------------------------------------------------------------------------


def test_without_learning_output_weights_of_each_sign_have_the_norm_asked_for() -> None:
    # Nothing is learnt at rate 0, so equal weights of both signs cancel and leave no score at all; drawn ones scale.
    still = {"stdp_rate": 0.0, "itp_rate": 0.0, "rules": "paper", "query_rule": "linear"}
    unit, double = (untested(**still, output_norm=norm).state()["outputs_0"] for norm in (1.0, 2.0))
    assert double == pytest.approx(2 * unit, rel=1e-5, abs=2.1e-6)  # the smallest weight is 1e-6
    assert np.abs(unit).sum(1).max() <= 2.0
    assert not untested(**still, output_norm=2.0, equal_output_weights=True).state()["outputs_0"].any()


def untested(**arguments: Any) -> VPRTempo:
    """Train without asking whether the result can be trusted."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vprbench.methods.vprtempo.method.check_winners", lambda *_: None)
        return fitted(**arguments)
