"""AnyLoc: equal to a slow computation from the tensors of its files, and centres learnt from the references."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import Tensors, imagenet, vit_checkpoint, vit_qkv, vit_tokens
from described_images import distance, encoded, image
from published_networks import PublishedNetwork, saved, with_checks

from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.anyloc import AnyLoc
from vprbench.methods.anyloc import vlad as gathered

TOLERANCE = 1e-5
DIM, DEPTH, LAYER, WORDS = 128, 3, 1, 5


def drawn() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    dino = vit_checkpoint(generator, DIM, DEPTH, swiglu=True)
    return {**dino, "mask_token": torch.randn(1, DIM, generator=generator)}


def drawn_centres() -> torch.Tensor:
    """Of lengths so different that the most similar direction is often not the nearest centre."""
    generator = torch.Generator().manual_seed(5)
    directions = torch.nn.functional.normalize(torch.randn(WORDS, DIM, generator=generator), dim=1)
    return directions * torch.tensor([0.2, 0.4, 0.6, 0.8, 1.2])[:, None]


CENTRES = drawn_centres()


def weights(path: Path) -> Weights:
    return Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))


def written(centres: torch.Tensor, path: Path) -> Path:
    torch.save(centres, path)
    return path


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


def expected(tensors: Tensors, images: Sequence[Image], **how: Any) -> npt.NDArray[np.float64]:
    of_vlad = {name: how.pop(name) for name in ("cosine", "raw") if name in how}
    return np.stack([vlad(facet(tensors, seen, **how), CENTRES.double().numpy(), **of_vlad) for seen in images])


NETWORK = PublishedNetwork(
    "anyloc",
    drawn,
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    WORDS * DIM,
    expected,
    arguments={"layer": LAYER, "words": WORDS},
    beside={"centres": lambda path: written(CENTRES, path.with_suffix(".centres"))},
    tolerance=TOLERANCE,
    batch_tolerance=1e-5,
    alike_in_half=0.9,  # a value between two centres may go to the other
    traps=[{"part": 0}, {"part": 1}, {"layer": LAYER + 1}, {"layer": LAYER - 1}, {"cosine": False}, {"raw": False}],
    missing=["blocks.0.mlp.w12.bias", f"blocks.{LAYER}.attn.qkv.weight", "cls_token", "norm.weight"],
    unexpected=["register_tokens", "blocks.0.mlp.fc1.weight"],
    misshapen={"blocks.1.ls1.gamma": (3,)},
    contract={"layer": LAYER, "words": WORDS, "height": 42, "width": 42, "batch_size": 16},
)
tensors = NETWORK.tensors


def learning(folder: Path, **arguments: Any) -> AnyLoc:
    return NETWORK.method(
        NETWORK.file(folder), **{"vocabulary": "references", "words": 3, "centres": None, **arguments}
    )


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder: Path) -> None:
    check(folder)


def test_with_the_references_vocabulary_it_keeps_the_contract(folder: Path) -> None:
    assert NETWORK.check_contract(folder, vocabulary="references") == set()


def test_a_centre_without_values_has_zeros(folder: Path) -> None:
    values = facet(tensors, image(28, 28))
    aside = -values.mean(0)
    path = written(
        torch.tensor(np.stack([values[0] / 2, aside])), folder / "two.pt"
    )  # float64, as k-means may leave it
    code = encoded(NETWORK.method(NETWORK.file(folder), centres=weights(path), words=2), image(28, 28))[0]
    assert np.linalg.norm(code[:DIM]) == pytest.approx(1, abs=1e-6)
    assert np.all(code[DIM:] == 0)


def test_every_centre_weighs_the_same(folder: Path) -> None:
    code = encoded(NETWORK.method(NETWORK.file(folder)), image(70, 98))[0]
    parts = np.linalg.norm(code.reshape(WORDS, DIM), axis=1)
    assert np.allclose(parts, WORDS**-0.5, atol=1e-6)


def test_blocks_after_the_layer_need_not_be_there_nor_fit_nor_are_kept(folder: Path) -> None:
    last = f"blocks.{DEPTH - 1}."
    short = {name: tensor for name, tensor in tensors.items() if not name.startswith(last)}
    odd = {**tensors, f"{last}norm1.weight": torch.zeros(3), f"{last}more": torch.zeros(1)}
    for changed in (short, odd):
        path = saved(folder / "changed.pth", changed)
        assert np.array_equal(encoded(NETWORK.method(path), *NETWORK.images), NETWORK.codes(folder))
    network = NETWORK.method(path).load(path)
    assert sum(name.endswith("attn.qkv.weight") for name, _ in network.named_parameters()) == LAYER + 1


def test_half_the_precision_keeps_the_centres(folder: Path) -> None:
    coarse = NETWORK.method(NETWORK.file(folder), precision="bfloat16")
    network = coarse.load(NETWORK.file(folder))
    coarse.use(network)
    assert torch.equal(network.centres, CENTRES)


# Centres learnt from the references


def references(n: int) -> Images:
    return Images.from_arrays([image(42, 56, 10 + seed) for seed in range(n)])


def test_learnt_centres_are_the_means_of_the_values_that_are_nearest_to_them(folder: Path) -> None:
    fitted = learning(folder).fit(references(6), np.arange(6))
    centres = fitted._network.centres.double().numpy()
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
    with pytest.raises(BadInput, match=r"4 different .* method\.words=5"):
        learning(folder, words=5).fit(Images.from_arrays([image(28, 28)]), np.zeros(1, np.int64))


def test_a_fit_that_fails_forgets_the_one_before(folder: Path) -> None:
    fitted = learning(folder, words=5).fit(references(6), np.arange(6))
    with pytest.raises(BadInput):
        fitted.fit(Images.from_arrays([image(28, 28)]), np.zeros(1, np.int64))
    with pytest.raises(NotFittedError):
        encoded(fitted, image(42, 42))


def test_learning_leaves_nothing_behind_that_collects_values(folder: Path) -> None:
    network = learning(folder).fit(references(6), np.arange(6))._network
    assert not network.values._forward_hooks


@pytest.mark.parametrize(("vocabulary", "kept"), [("published", True), ("references", False)])
def test_descriptors_are_kept_unless_a_map_shapes_them(folder: Path, vocabulary: Any, kept: bool) -> None:
    assert learning(folder, vocabulary=vocabulary).keeps_descriptors() is kept


# Files and arguments


def refusal(made: AnyLoc) -> str:
    with pytest.raises(BadInput) as error:
        encoded(made, image(42, 42))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_both_files_make_the_descriptor_and_learnt_centres_need_none(folder: Path) -> None:
    path = NETWORK.file(folder)
    assert list(NETWORK.method(path).files()) == [path, path.with_suffix(".centres")]
    assert list(learning(folder).files()) == [path]


@pytest.mark.parametrize(
    "wrong",
    [torch.zeros(WORDS + 1, DIM), torch.zeros(WORDS, DIM - 1), torch.full((WORDS, DIM), torch.nan)],
    ids=["words", "dimensions", "not finite"],
)
def test_centres_that_do_not_fit_are_refused(folder: Path, wrong: torch.Tensor) -> None:
    path = written(wrong, folder / "wrong.pt")
    message = refusal(NETWORK.method(NETWORK.file(folder), centres=weights(path)))
    assert str(path) in message
    assert f"({WORDS}, {DIM})" in message


def test_a_network_in_place_of_centres_is_refused(folder: Path) -> None:
    path = NETWORK.file(folder)
    assert path.name in refusal(NETWORK.method(path, centres=weights(path)))


@pytest.mark.parametrize("other", [{"backbone": "vitl14", "layer": 20}, {"layer": 30}, {"words": 64}], ids=str)
def test_centres_are_published_for_one_network_layer_and_number_alone(folder: Path, other: dict[str, Any]) -> None:
    published = Weights(file="centres.pt", licence="none", trained_on="nothing", url="https://example.org/centres.pt")
    made = AnyLoc(weights=weights(NETWORK.file(folder)), centres=published, **other)
    assert "method.vocabulary=references" in refusal(made)


@pytest.mark.parametrize(
    "wrong", [{"layer": -1}, {"layer": 40}, {"words": 0}, {"longest_side": 13}, {"centres": None}], ids=str
)
def test_arguments_that_make_no_descriptor_are_refused(folder: Path, wrong: dict[str, Any]) -> None:
    ((name, value),) = wrong.items()
    told = refusal(NETWORK.method(NETWORK.file(folder), **wrong))
    assert (f"method.{name}" if value is None else f"method.{name}={value}") in told


def test_a_wrong_path_of_the_centres_is_named_as_theirs(folder: Path) -> None:
    with pytest.raises(BadInput, match=r"method\.centres\.path=nowhere\.pt"):
        NETWORK.method(NETWORK.file(folder), centres=weights(Path("nowhere.pt"))).files()
