"""A trained VPRTempo network as arrays: stored, restored, published by the authors, refused, and how fast it learns."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest
import torch

from vprbench.api.images import Images
from vprbench.cli import main
from vprbench.datasets.synthetic import synthetic
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import RuleSet
from vprbench.plugins import networks
from vprbench.plugins.rules import Journey
from vprbench.run.store import Store

Arrays = dict[str, npt.NDArray[np.float32]]

SIDE = 12  # pixels
WORLD = Journey.draw(0)
QUERIES = Images.from_arrays(WORLD.queries)
RULES = pytest.mark.parametrize("rules", get_args(RuleSet))


def method(**arguments: Any) -> VPRTempo:
    return VPRTempo(**{"max_module": 8, "height": SIDE, "width": SIDE, **arguments})


def fitted(**arguments: Any) -> VPRTempo:
    return method(**arguments).fit(Images.from_arrays(WORLD.references), WORLD.places)


# --- what state gives, restore takes ----------------------------------------------------------------------------


@RULES
@pytest.mark.parametrize("max_module", [8, 10, 20], ids=["8, 8 and 4", "10 and 10", "one module"])
def test_a_restored_network_scores_to_the_bit_as_the_trained_one(rules: RuleSet, max_module: int) -> None:
    trained = fitted(rules=rules, max_module=max_module)
    restored = method(rules=rules, max_module=max_module).restore(trained.state())
    assert np.array_equal(restored.query(QUERIES), trained.query(QUERIES))
    x = trained.encode(QUERIES)[1:2]
    assert np.array_equal(restored.match(x), trained.match(x))
    assert {name: array.tobytes() for name, array in restored.state().items()} == {
        name: array.tobytes() for name, array in trained.state().items()
    }


def test_the_arrays_are_the_layers_of_each_module_without_padding_contiguous_and_float32() -> None:
    n_pixels, n_features, state = SIDE * SIDE, 2 * SIDE * SIDE, fitted().state()
    assert {name: array.shape for name, array in state.items()} == {
        "features": (3, n_features, n_pixels),
        "constant": (3, n_features),
        "feature_thresholds": (3, n_features),
        "outputs_0": (8, n_features),
        "outputs_1": (8, n_features),
        "outputs_2": (4, n_features),
        "output_thresholds_0": (8,),
        "output_thresholds_1": (8,),
        "output_thresholds_2": (4,),
    }
    for array in state.values():
        assert array.dtype == np.float32
        assert array.flags.c_contiguous


def test_arrays_may_be_unwritable_and_later_changes_of_them_are_not_followed() -> None:
    state = {name: array.copy() for name, array in fitted().state().items()}
    for array in state.values():
        array.flags.writeable = False
    restored = method().restore(state)
    for array in state.values():
        array.flags.writeable = True
        array[:] = 7
    assert np.array_equal(restored.query(QUERIES), fitted().query(QUERIES))


def test_more_than_ten_modules_keep_their_order() -> None:
    trained = fitted(max_module=1)
    assert len(trained.state()) == 3 + 2 * 20
    assert np.array_equal(method(max_module=1).restore(trained.state()).query(QUERIES), trained.query(QUERIES))


def test_restoring_and_training_forget_the_network_before() -> None:
    wanted = fitted(seed=1)
    assert np.array_equal(fitted().restore(wanted.state()).query(QUERIES), wanted.query(QUERIES))
    restored = method(seed=1).restore(fitted().state())
    restored.fit(Images.from_arrays(WORLD.references), WORLD.places)
    assert np.array_equal(restored.query(QUERIES), wanted.query(QUERIES))


@pytest.mark.parametrize("ask", [lambda m: m.query(QUERIES), lambda m: m.state()], ids=["query", "state"])
def test_before_fit_and_restore_there_is_nothing_to_ask(ask: Callable[[VPRTempo], object]) -> None:
    with pytest.raises(NotFittedError, match="fit"):
        ask(method())


# --- arrays that are no network ---------------------------------------------------------------------------------


def little() -> Arrays:
    """Return the arrays of a network of two modules of 3 and 2 places, 4 features and 144 pixels."""
    draw = np.random.default_rng(0)
    shapes = {
        "features": (2, 4, SIDE * SIDE),
        "constant": (2, 4),
        "feature_thresholds": (2, 4),
        "outputs_0": (3, 4),
        "outputs_1": (2, 4),
        "output_thresholds_0": (3,),
        "output_thresholds_1": (2,),
    }
    return {name: draw.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def refusal(state: Mapping[str, npt.NDArray[Any]], asked: VPRTempo | None = None) -> str:
    """Return the line that refuses the arrays, and see that the method, which had a network, answers nothing."""
    asked = asked or method().restore(little())
    with pytest.raises(BadInput) as error:
        asked.restore(state)
    for ask in (lambda: asked.query(QUERIES), asked.state):
        with pytest.raises(NotFittedError):
            ask()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_little_network_of_these_tests_is_accepted() -> None:
    assert method().restore(little()).query(QUERIES).shape == (len(WORLD.queries), 5)


@pytest.mark.parametrize("name", list(little()))
def test_a_missing_array_is_named(name: str) -> None:
    state = little()
    del state[name]
    assert name in refusal(state).replace(",", " ").split()


@pytest.mark.parametrize("name", ["means", "outputs", "outputs_2", "output_thresholds_2"])
def test_an_array_too_many_is_named_or_the_one_that_it_lacks(name: str) -> None:
    line = refusal({**little(), name: np.zeros((3, 4), np.float32)})
    assert ("_2" if "_2" in name else name) in line


def test_a_trained_method_that_could_not_be_restored_answers_nothing() -> None:
    refusal({**little(), "constant": np.zeros((2, 5), np.float32)}, fitted())
    refusal({})


Spoil = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]
SPOILT: dict[str, Spoil] = {
    "one axis more": lambda a: a[None],
    "one axis less": lambda a: a[0],
    "a number": lambda a: a.ravel()[0],
    "four axes": lambda a: a.reshape(-1, 1, 1, 1),
    "nothing": lambda a: a[:0],
    "one column too many": lambda a: np.concatenate([a, a[..., :1]], axis=-1),
    "not finite": lambda a: np.full_like(a, np.nan),
    "infinite": lambda a: np.full_like(a, np.inf),
}


@pytest.mark.parametrize("name", little())
@pytest.mark.parametrize("how", SPOILT)
def test_an_array_of_another_shape_or_without_finite_values_is_refused(name: str, how: str) -> None:
    state = little()
    state[name] = np.asarray(SPOILT[how](state[name]))
    line = refusal(state)
    if how == "one column too many":
        same = f"{name} has the shape {state[name].shape}; wanted {little()[name].shape}"
        assert ("145 inputs" if name == "features" else same) in line
    elif "finite" in how:
        assert name in line
    else:
        assert "has the shape" in line


@pytest.mark.parametrize("name", ["features", "constant", "feature_thresholds", "outputs_0", "outputs_1"])
def test_an_array_with_one_row_too_many_is_refused(name: str) -> None:
    state = little()
    state[name] = np.concatenate([state[name], state[name][:1]])
    assert name.removeprefix("outputs") in refusal(state)  # an output layer is held against its thresholds


@pytest.mark.parametrize("without", ["places", "features"])
def test_a_network_of_nothing_is_refused(without: str) -> None:
    state = little()
    for name in state:
        if without == "places" and name.startswith("output"):
            state[name] = state[name][:0]
        if without == "features" and not name.startswith("output_"):
            state[name] = state[name][:, :0]
    refusal(state)


@pytest.mark.parametrize(("height", "width"), [(12, 11), (28, 28), (1, 143)])
@pytest.mark.parametrize("published", [False, True])
def test_another_number_of_pixels_is_refused_with_both(height: int, width: int, published: bool) -> None:
    state = flat(checkpoint()) if published else little()
    line = refusal(state, method(rules="reference", height=height, width=width))
    assert "144 inputs" in line
    assert f"method.height={height} x method.width={width}" in line


# --- the published layout ---------------------------------------------------------------------------------------

N_FEATURES = 10
PUBLISHED = ("feature_layer.w.weight", "feature_layer.thr", "output_layer.w.weight", "output_layer.thr")


def checkpoint(sizes: tuple[int, ...] = (8, 4), n_features: int = N_FEATURES) -> dict[str, dict[str, torch.Tensor]]:
    """Return what the authors' code saves (64154e5): a state dictionary for each module, thresholds as (1, n)."""
    draw = np.random.default_rng(5)

    def layer(n_post: int, n_pre: int) -> torch.Tensor:
        return torch.from_numpy(draw.normal(0, n_pre**-0.5, (n_post, n_pre)).astype(np.float32))

    return {
        f"model_{module}": {
            "feature_layer.thr": torch.zeros(1, n_features),
            "feature_layer.w.weight": layer(n_features, SIDE * SIDE),
            "output_layer.thr": torch.zeros(1, size),
            "output_layer.w.weight": layer(size, n_features),
        }
        for module, size in enumerate(sizes)
    }


def flat(content: Mapping[str, Mapping[str, torch.Tensor]]) -> Arrays:
    return {f"{module}.{name}": part.numpy() for module, layers in content.items() for name, part in layers.items()}


def products(content: Mapping[str, Mapping[str, torch.Tensor]], x: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Return W_o W_f x, (n_queries, n_places), places module by module."""
    scores = []
    for module in range(len(content)):
        w_f, w_o = (
            content[f"model_{module}"][f"{layer}_layer.w.weight"].numpy().astype(np.float64)
            for layer in ("feature", "output")
        )
        scores.append(w_o @ (w_f @ x.T.astype(np.float64)))
    return np.concatenate(scores).T


@pytest.mark.parametrize("sizes", [(8, 4), (5,), (1, 1), tuple(range(1, 13))], ids=str)
def test_a_published_network_scores_as_the_product_of_its_matrices(sizes: tuple[int, ...]) -> None:
    content = checkpoint(sizes)
    restored = method(rules="reference").restore(flat(dict(reversed(content.items()))))  # in any order
    x = restored.encode(QUERIES)
    assert restored.match(x) == pytest.approx(products(content, x), abs=2e-6)
    assert restored.match(x[:1]) == pytest.approx(products(content, x[:1]), abs=2e-6)


def test_published_thresholds_act_where_the_query_is_spiking() -> None:
    content = checkpoint((1,), 1)
    content["model_0"]["feature_layer.w.weight"][:] = 1.0
    content["model_0"]["feature_layer.thr"][:] = SIDE * SIDE - 0.75  # all pixels at 1 leave 0.75
    content["model_0"]["output_layer.w.weight"][:] = 1.0
    content["model_0"]["output_layer.thr"][:] = 0.25
    restored = method(rules="reference", query_rule="spiking").restore(flat(content))
    assert restored.match(np.ones((1, SIDE * SIDE), np.float32)) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("module", [0, 1])
def test_a_key_that_a_published_network_lacks_is_named(module: int, name: str) -> None:
    state = flat(checkpoint())
    del state[f"model_{module}.{name}"]
    assert f"lacks model_{module}.{name}:" in refusal(state)


@pytest.mark.parametrize("name", ["model_1.feature_layer.exc", "optimizer", "model_x.feature_layer.thr", "model_²"])
def test_a_key_that_a_published_network_should_not_have_is_named(name: str) -> None:
    assert f"has an unexpected {name}:" in refusal({**flat(checkpoint()), name: np.zeros((1, 4), np.float32)})


def test_a_gap_in_the_numbers_of_published_modules_is_named() -> None:
    content = checkpoint()
    content["model_2"] = content.pop("model_1")
    assert "lacks model_1." in refusal(flat(content))


def test_published_modules_of_different_feature_layers_are_refused() -> None:
    content = {**checkpoint((8,)), "model_1": checkpoint((8, 4), N_FEATURES + 1)["model_1"]}
    assert "feature layers" in refusal(flat(content))
    content = checkpoint()
    content["model_1"]["feature_layer.thr"] = torch.zeros(1, N_FEATURES + 1)
    assert "feature_layer.thr" in refusal(flat(content))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("feature_layer.w.weight", (N_FEATURES,)),
        ("feature_layer.thr", (1, N_FEATURES + 1)),
        ("output_layer.w.weight", (4, N_FEATURES - 1)),
        ("output_layer.w.weight", (4,)),
        ("output_layer.thr", (1, 5)),
    ],
)
def test_published_layers_that_do_not_fit_each_other_are_refused(name: str, shape: tuple[int, ...]) -> None:
    content = checkpoint((4,))
    content["model_0"][name] = torch.zeros(shape)
    assert str(shape[-1]) in refusal(flat(content))


# --- the published file -----------------------------------------------------------------------------------------

N_PLACES = 12
ASKED = [
    "method=vprtempo",
    "method.rules=reference",
    f"method.height={SIDE}",
    f"method.width={SIDE}",
    "method.max_module=8",
    f"dataset.places={N_PLACES}",
    "dataset.first_query_place=0",
    "timing.minimum_seconds=0",
    "timing.sample=4",
    "timing.minimum_queries=4",
    "timing.batch_sizes=[1,4]",
    "threads=1",
    "load=x.pth",
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_published_file_is_loaded_into_the_method(tmp_path: Path) -> None:
    content = checkpoint()
    torch.save(content, tmp_path / "x.pth")
    loaded = method(rules="reference")
    origin = networks.Origin("vprtempo", {}, "world", N_PLACES, "f" * 64)
    (note,) = networks.load(tmp_path / "x.pth", loaded, origin)
    assert "published network" in note
    x = loaded.encode(QUERIES)
    assert loaded.match(x) == pytest.approx(products(content, x), abs=2e-6)


def test_a_run_with_a_published_file_scores_as_its_matrices(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = checkpoint()
    torch.save(content, folder / "x.pth")
    assert main([*ASKED, "output=json"]) == 0, capsys.readouterr().err
    printed = json.loads(capsys.readouterr().out)
    queries = synthetic(places=N_PLACES, first_query_place=0).queries
    expected = products(content, method().encode(queries))
    (run,) = Store(Path("results")).runs()
    assert run.scores is not None
    assert np.asarray(run.scores) == pytest.approx(expected, abs=2e-6)
    best = expected.argmax(1) == np.arange(N_PLACES)
    assert printed["recall_at_1"] == pytest.approx(np.mean(best))
    assert "loaded" in [note["kind"] for note in printed["notes"]]


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        ({"model_0": {**checkpoint()["model_0"], "extra": torch.zeros(1)}}, "x.pth: the checkpoint has an unexpected"),
        (checkpoint((8, 3)), "11"),
    ],
    ids=["an array too many", "a place too few"],
)
def test_a_run_with_a_published_file_that_does_not_fit_ends_in_one_line(
    content: Any, wanted: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.save(content, folder / "x.pth")
    assert main(ASKED) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("vprbench: ")
    assert wanted in line


# --- how fast the output layer learns ---------------------------------------------------------------------------

FIRST_8 = np.flatnonzero(WORLD.places < 8)  # so few that an untrained output layer is not taken for a diverged one


def trained(**arguments: Any) -> Mapping[str, npt.NDArray[np.float32]]:
    references = Images.from_arrays([WORLD.references[i] for i in FIRST_8])
    return method(**{"max_module": 5, **arguments}).fit(references, WORLD.places[FIRST_8]).state()


def differing(one: Mapping[str, npt.NDArray[Any]], other: Mapping[str, npt.NDArray[Any]]) -> set[str]:
    """Return the names of arrays that differ, without the number of their module."""
    return {name.rstrip("_0123456789") for name, array in one.items() if not np.array_equal(array, other[name])}


@RULES
def test_the_output_layer_alone_learns_at_a_rate_of_its_own_by_default_at_stdp_rate(rules: RuleSet) -> None:
    slow = trained(rules=rules, stdp_rate=0.003)
    assert not differing(slow, trained(rules=rules, stdp_rate=0.003, output_stdp_rate=0.003))
    learnt = {"outputs", "output_thresholds"} if rules == "v1" else {"outputs"}
    assert differing(slow, trained(rules=rules, stdp_rate=0.003, output_stdp_rate=0.002)) == learnt


@RULES
@pytest.mark.parametrize("engine", ["fused", "readable"])
def test_at_a_rate_of_0_neither_the_epochs_nor_what_is_seen_change_the_output_layer(
    rules: RuleSet, engine: str
) -> None:
    still = {"rules": rules, "engine": engine, "output_stdp_rate": 0.0}
    changed = differing(trained(**still), trained(**still, epochs=7, stdp_rate=0.001, preprocessing="A"))
    assert "features" in changed
    assert not changed & {"outputs", "output_thresholds"}


@pytest.mark.parametrize("rules", ["paper", "v1"])
def test_at_a_rate_of_0_output_weights_keep_their_initial_norm(rules: RuleSet) -> None:
    # Excitation and inhibition start with an L1 norm of 1 for each neuron, so that the signed weights add up to 0.
    state = trained(rules=rules, output_stdp_rate=0.0)
    learnt = trained(rules=rules)
    for module in range(2):
        assert np.abs(state[f"outputs_{module}"].sum(1, dtype=np.float64)).max() < 1e-5
        assert np.abs(learnt[f"outputs_{module}"].sum(1, dtype=np.float64)).max() > 1e-3
