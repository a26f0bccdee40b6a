"""AnyLoc: equal to a slow computation from the tensors of its files, and centres learnt from the references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_qkv, vit_tokens
from described_images import distance, encoded, image

from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.anyloc import AnyLoc
from vprbench.methods.anyloc import vlad as gathered
from vprbench.plugins import conformance

TOLERANCE = 1e-5
DIM, DEPTH, LAYER, WORDS = 128, 3, 1, 5


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    dino = vit_checkpoint(generator, DIM, DEPTH, swiglu=True)
    return {**dino, "mask_token": torch.randn(1, DIM, generator=generator)}


@pytest.fixture(scope="module")
def centres() -> torch.Tensor:
    """Of lengths so different that the most similar direction is often not the nearest centre."""
    generator = torch.Generator().manual_seed(5)
    directions = torch.nn.functional.normalize(torch.randn(WORDS, DIM, generator=generator), dim=1)
    return directions * torch.tensor([0.2, 0.4, 0.6, 0.8, 1.2])[:, None]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, tensors: Tensors, centres: torch.Tensor) -> Path:
    folder = tmp_path_factory.mktemp("anyloc")
    torch.save(tensors, folder / "network.pth")
    torch.save(centres, folder / "centres.pt")
    return folder


def weights(path: Path) -> Weights:
    return Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))


def method(folder: Path, network: str = "network.pth", centres: str = "centres.pt", **arguments: Any) -> AnyLoc:
    files = {"weights": weights(folder / network), "centres": weights(folder / centres)}
    return AnyLoc(**{**files, "layer": LAYER, "words": WORDS, **arguments})


def learning(folder: Path, **arguments: Any) -> AnyLoc:
    arguments = {"layer": LAYER, "words": 3, **arguments}
    return AnyLoc(weights=weights(folder / "network.pth"), vocabulary="references", **arguments)


def facet(tensors: Tensors, image: npt.NDArray[np.uint8], part: int = 2, layer: int = LAYER) -> npt.NDArray[np.float64]:
    """Queries, keys or values of the patches, unit vectors, (n_patches, DIM)."""
    tokens = vit_tokens(tensors, "", imagenet(image), n_blocks=layer, final_norm=False)
    values = vit_qkv(tensors, "", tokens, layer)[part][0].transpose(0, 1).flatten(1).numpy()[1:]
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def vlad(
    values: npt.NDArray[np.float64], centres: npt.NDArray[np.float64], cosine: bool = True, raw: bool = True
) -> npt.NDArray[np.float64]:
    directions = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    sums = np.zeros_like(centres)
    for value in values:
        near = directions @ value if cosine else -np.linalg.norm(value - centres, axis=1)
        sums[near.argmax()] += value - (centres if raw else directions)[near.argmax()]
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    whole = (sums / np.where(lengths > 0, lengths, 1)).ravel()
    return whole / np.linalg.norm(whole)


# Values


def test_images_of_two_sizes_have_the_descriptors_of_the_slow_computation(
    folder: Path, tensors: Tensors, centres: torch.Tensor
) -> None:
    images = [image(56, 98), image(42, 70, 1), image(42, 70, 2)]
    codes = encoded(method(folder), *images)
    assert codes.shape == (3, WORDS * DIM)
    slow = np.stack([vlad(facet(tensors, seen), centres.double().numpy()) for seen in images])
    assert distance(codes, slow) < TOLERANCE


@pytest.mark.parametrize(
    "how",
    [{"part": 0}, {"part": 1}, {"layer": LAYER + 1}, {"layer": LAYER - 1}, {"cosine": False}, {"raw": False}],
    ids=str,
)
def test_another_way_would_give_other_values(tensors: Tensors, centres: torch.Tensor, how: dict[str, Any]) -> None:
    precise, seen = centres.double().numpy(), image(56, 98)
    of_values = {name: how[name] for name in ("part", "layer") if name in how}
    of_vlad = {name: how[name] for name in ("cosine", "raw") if name in how}
    other = vlad(facet(tensors, seen, **of_values), precise, **of_vlad)
    assert distance(vlad(facet(tensors, seen), precise), other) > 100 * TOLERANCE


def test_a_centre_without_values_has_zeros(folder: Path, tmp_path: Path, tensors: Tensors) -> None:
    values = facet(tensors, image(28, 28))
    aside = -values.mean(0)
    torch.save(torch.tensor(np.stack([values[0] / 2, aside])), tmp_path / "two.pt")  # float64, as k-means may leave it
    two = AnyLoc(weights=weights(folder / "network.pth"), centres=weights(tmp_path / "two.pt"), layer=LAYER, words=2)
    code = encoded(two, image(28, 28))[0]
    assert np.linalg.norm(code[:DIM]) == pytest.approx(1, abs=1e-6)
    assert np.all(code[DIM:] == 0)


def test_every_centre_weighs_the_same(folder: Path) -> None:
    parts = np.linalg.norm(encoded(method(folder), image(70, 98))[0].reshape(WORDS, DIM), axis=1)
    assert np.allclose(parts, WORDS**-0.5, atol=1e-6)


def test_blocks_after_the_layer_need_not_be_there_nor_fit(folder: Path, tensors: Tensors, tmp_path: Path) -> None:
    last = f"blocks.{DEPTH - 1}."
    short = {name: tensor for name, tensor in tensors.items() if not name.startswith(last)}
    odd = {**tensors, f"{last}norm1.weight": torch.zeros(3), f"{last}more": torch.zeros(1)}
    torch.save(short, tmp_path / "short.pth")
    torch.save(odd, tmp_path / "odd.pth")
    codes = [
        encoded(method(folder, network=str(path)), image(42, 42))
        for path in (folder / "network.pth", tmp_path / "short.pth", tmp_path / "odd.pth")
    ]
    assert np.array_equal(codes[0], codes[1])
    assert np.array_equal(codes[0], codes[2])


def test_blocks_after_the_layer_are_not_kept_in_memory(folder: Path) -> None:
    network = method(folder).load(folder / "network.pth")
    assert sum(name.endswith("attn.qkv.weight") for name, _ in network.named_parameters()) == LAYER + 1


def test_half_the_precision_keeps_the_centres_and_nearly_the_descriptor(folder: Path, centres: torch.Tensor) -> None:
    exact = encoded(method(folder), image(56, 98))
    coarse = method(folder, precision="bfloat16")
    network = coarse.load(folder / "network.pth")
    coarse.use(network)
    assert torch.equal(network.centres, centres)
    half = network(imagenet(image(56, 98)).bfloat16()).numpy()
    assert half.dtype == np.float32
    assert (half / np.linalg.norm(half)) @ exact[0] > 0.9  # a value between two centres may go to the other


def test_descriptors_are_unit_vectors_that_neither_batch_nor_repetition_changes(folder: Path) -> None:
    images = [image(42, 56, seed) for seed in range(3)]
    codes = encoded(method(folder), *images)
    assert codes.dtype == np.float32
    assert np.allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    assert np.array_equal(codes, encoded(method(folder), *images))
    assert distance(codes, np.concatenate([encoded(method(folder), one) for one in images])) < 1e-5
    assert distance(codes[0], codes[1]) > 1e-3


# Centres learnt from the references


def references(n: int) -> Images:
    return Images.from_arrays([image(42, 56, 10 + seed) for seed in range(n)])


def test_learnt_centres_are_the_means_of_the_values_that_are_nearest_to_them(folder: Path, tensors: Tensors) -> None:
    fitted = learning(folder).fit(references(6), np.arange(6))
    centres = fitted._network.centres.double().numpy()  # type: ignore[union-attr, operator]
    values = np.concatenate([facet(tensors, seen) for seen in references(6)])
    nearest = np.linalg.norm(values[:, None] - centres, axis=2).argmin(1)
    assert distance(centres, np.stack([values[nearest == word].mean(0) for word in range(3)])) < 1e-3
    code = fitted.encode(Images.from_arrays([image(56, 56)]))
    assert distance(code, vlad(facet(tensors, image(56, 56)), centres)) < TOLERANCE


def test_of_many_values_some_are_drawn_by_the_seed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vprbench.methods.anyloc._SAMPLED_IMAGES", 4)
    monkeypatch.setattr("vprbench.methods.anyloc._SAMPLED_PER_CENTRE", 8)
    codes = [learning(folder, seed=seed).fit(references(8), np.arange(8)).encode(references(8)) for seed in (1, 1, 2)]
    assert np.array_equal(codes[0], codes[1])
    assert not np.allclose(codes[0], codes[2])


def test_a_centre_with_no_value_but_itself_has_zeros(folder: Path) -> None:
    alone = Images.from_arrays([image(28, 28)])
    fitted = learning(folder, words=4).fit(alone, np.zeros(1, np.int64))
    assert np.all(fitted.encode(alone) == 0)


@pytest.mark.parametrize(("apart", "length"), [(1e-7, 0.0), (1e-2, 1.0)])
def test_a_residual_that_is_rounding_is_none(apart: float, length: float) -> None:
    generator = torch.Generator().manual_seed(6)
    values = torch.nn.functional.normalize(torch.randn(4, DIM, generator=generator), dim=1)
    centres = values + apart * torch.nn.functional.normalize(torch.randn(4, DIM, generator=generator), dim=1)
    parts = gathered(values[None], centres).reshape(4, DIM).norm(dim=1)
    assert torch.allclose(parts, torch.full((4,), length), atol=1e-6)


def test_without_references_there_is_no_descriptor_where_they_give_the_centres(folder: Path) -> None:
    with pytest.raises(NotFittedError, match="fit"):
        encoded(learning(folder), image(42, 42))


def test_too_few_values_for_the_words_are_refused(folder: Path) -> None:
    with pytest.raises(BadInput, match=r"4 different values for method\.words=5"):
        learning(folder, words=5).fit(Images.from_arrays([image(28, 28)]), np.zeros(1, np.int64))


def test_a_fit_that_fails_forgets_the_one_before(folder: Path) -> None:
    fitted = learning(folder, words=5).fit(references(6), np.arange(6))
    with pytest.raises(BadInput):
        fitted.fit(Images.from_arrays([image(28, 28)]), np.zeros(1, np.int64))
    with pytest.raises(NotFittedError):
        encoded(fitted, image(42, 42))


def test_learning_leaves_nothing_behind_that_collects_values(folder: Path) -> None:
    network = learning(folder).fit(references(6), np.arange(6))._network
    assert not network.values._forward_hooks  # type: ignore[union-attr, operator]


@pytest.mark.parametrize(("vocabulary", "kept"), [("published", True), ("references", False)])
def test_descriptors_are_kept_unless_a_map_shapes_them(folder: Path, vocabulary: Any, kept: bool) -> None:
    assert method(folder, vocabulary=vocabulary).keeps_descriptors() is kept


# Files and arguments


def refusal(made: AnyLoc) -> str:
    with pytest.raises(BadInput) as error:
        encoded(made, image(42, 42))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_both_files_make_the_descriptor(folder: Path) -> None:
    assert list(method(folder).files()) == [folder / "network.pth", folder / "centres.pt"]


def test_learnt_centres_need_no_file(folder: Path) -> None:
    made = learning(folder)
    assert list(made.files()) == [folder / "network.pth"]


@pytest.mark.parametrize("name", ["blocks.0.mlp.w12.bias", f"blocks.{LAYER}.attn.qkv.weight", "cls_token"])
def test_a_missing_tensor_is_named(folder: Path, tensors: Tensors, tmp_path: Path, name: str) -> None:
    path = tmp_path / "missing.pth"
    torch.save({key: tensor for key, tensor in tensors.items() if key != name}, path)
    message = refusal(method(folder, network=str(path)))
    assert name in message
    assert str(path) in message


@pytest.mark.parametrize("name", ["register_tokens", "blocks.0.mlp.fc1.weight"])
def test_an_unexpected_tensor_is_named(folder: Path, tensors: Tensors, tmp_path: Path, name: str) -> None:
    torch.save({**tensors, name: torch.zeros(3)}, tmp_path / "more.pth")
    assert name in refusal(method(folder, network=str(tmp_path / "more.pth")))


def test_a_tensor_of_another_shape_is_named(folder: Path, tensors: Tensors, tmp_path: Path) -> None:
    torch.save({**tensors, "blocks.1.ls1.gamma": torch.zeros(3)}, tmp_path / "wrong.pth")
    assert "blocks.1.ls1.gamma" in refusal(method(folder, network=str(tmp_path / "wrong.pth")))


def test_a_network_without_the_layer_is_refused(folder: Path) -> None:
    assert "method.layer=3" in refusal(method(folder, layer=DEPTH))


@pytest.mark.parametrize(
    "wrong",
    [torch.zeros(WORDS + 1, DIM), torch.zeros(WORDS, DIM - 1), torch.full((WORDS, DIM), torch.nan)],
    ids=["words", "dimensions", "not finite"],
)
def test_centres_that_do_not_fit_are_refused(folder: Path, tmp_path: Path, wrong: torch.Tensor) -> None:
    torch.save(wrong, tmp_path / "wrong.pt")
    message = refusal(method(folder, centres=str(tmp_path / "wrong.pt")))
    assert str(tmp_path / "wrong.pt") in message
    assert f"({WORDS}, {DIM})" in message


def test_a_network_in_place_of_centres_is_refused(folder: Path) -> None:
    assert "network.pth" in refusal(method(folder, centres="network.pth"))


@pytest.mark.parametrize("other", [{"backbone": "vitl14", "layer": 20}, {"layer": 30}, {"words": 64}], ids=str)
def test_centres_are_published_for_one_network_layer_and_number_alone(folder: Path, other: dict[str, Any]) -> None:
    published = Weights(file="centres.pt", licence="none", trained_on="nothing", url="https://example.org/centres.pt")
    made = AnyLoc(weights=weights(folder / "network.pth"), centres=published, **other)
    assert "method.vocabulary=references" in refusal(made)


@pytest.mark.parametrize("wrong", [{"layer": -1}, {"layer": 40}, {"words": 0}], ids=str)
def test_arguments_that_make_no_descriptor_are_refused(folder: Path, wrong: dict[str, int]) -> None:
    ((name, value),) = wrong.items()
    assert f"method.{name}={value}" in refusal(method(folder, **wrong))


def test_published_centres_have_to_be_given(folder: Path) -> None:
    made = AnyLoc(weights=weights(folder / "network.pth"))
    assert "method.centres" in refusal(made)


# The contract and the yaml


@pytest.mark.parametrize("vocabulary", ["published", "references"])
def test_it_keeps_the_rules_of_the_contract(folder: Path, vocabulary: str) -> None:
    files = {
        name: {"file": file, "licence": "none", "trained_on": "nothing", "path": str(folder / file)}
        for name, file in (("weights", "network.pth"), ("centres", "centres.pt"))
    }
    config = {
        "_target_": "vprbench.methods.anyloc.AnyLoc",
        **files,
        "vocabulary": vocabulary,
        "layer": LAYER,
        "words": WORDS,
        "height": 42,
        "width": 42,
        "batch_size": 16,
    }
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []


def test_a_wrong_path_of_the_centres_is_named_as_theirs() -> None:
    here = str(Path(__file__))
    weights = Weights(file="w.pth", licence="", trained_on="", path=here)
    centres = Weights(file="c.pt", licence="", trained_on="", path="nowhere.pt")
    with pytest.raises(BadInput, match=r"method\.centres\.path=nowhere\.pt is no file"):
        AnyLoc(weights=weights, centres=centres).files()
