"""AnyLoc: equal to a slow computation from the tensors of its files, and centres learnt from the references."""

from pathlib import Path

import numpy as np
import pytest
import torch
from backbones_oracle import Draw, imagenet, vit_checkpoint, vit_qkv, vit_tokens
from described_images import distance, encoded, image
from image_folders import answer
from published_networks import PublishedNetwork, unit, with_checks
from torch.nn.functional import normalize

from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput, MissingData, NotFittedError

DIM, LAYER, WORDS = 128, 1, 5
#: Of lengths so different that the most similar direction is often not the nearest centre.
CENTRES = normalize(Draw(5).normal(WORDS, DIM), dim=1) * torch.tensor([0.2, 0.4, 0.6, 0.8, 1.2])[:, None]


def weights(path):
    return Weights(path.name, "none", "nothing", path=str(path))


def written(centres, path):
    torch.save(centres, path)
    return path


def facet(tensors, image):
    """The values of the patches, unit vectors, (n_patches, DIM)."""
    tokens = vit_tokens(tensors, "", imagenet(image), n_blocks=LAYER, final_norm=False)
    return unit(vit_qkv(tensors, "", tokens, LAYER)[2][0].transpose(0, 1).flatten(1).numpy()[1:])


def vlad(values, centres):
    nearest = (values @ unit(centres).T).argmax(1)
    sums = np.stack([(values[nearest == word] - centre).sum(0) for word, centre in enumerate(centres)])
    return normalize(torch.from_numpy(sums), dim=1).numpy().ravel()


NETWORK = PublishedNetwork(
    "anyloc",
    lambda: vit_checkpoint(Draw(4), DIM, depth=3, swiglu=True),
    [image(56, 98), image(42, 70, 1), image(42, 70, 2)],
    WORDS * DIM,
    lambda tensors, image: vlad(facet(tensors, image), CENTRES.double().numpy()),
    arguments={"layer": LAYER, "words": WORDS},
    beside={"centres": lambda path: written(CENTRES, path.with_suffix(".centres"))},
    refused=[
        ("AnyLoc needs 14 pixels a side", {}, (13, 40)),
        ("method.centres", {"centres": None}, (42, 42)),
        *(
            (f"method.{name}={value}", {name: value}, (42, 42))
            for name, value in (("layer", -1), ("layer", 40), ("words", 0), ("longest_side", 13))
        ),
    ],
)
tensors = NETWORK.tensors


def learning(folder, **arguments):
    own = {"vocabulary": "references", "words": 3, "centres": None, **arguments}
    return NETWORK.method(NETWORK.file(folder), **own)


@with_checks(NETWORK)
def test_it_is_the_published_network(check, folder):
    check(folder)


def test_a_centre_without_values_has_zeros(folder):
    values = facet(tensors, image(28, 28))
    centres = torch.tensor(np.stack([values[0] / 2, -values.mean(0)]))  # float64, as k-means may leave it
    code = NETWORK.encode(folder, image(28, 28), centres=weights(written(centres, folder / "two.pt")), words=2)[0]
    assert np.linalg.norm(code[:DIM]) == pytest.approx(1, abs=1e-6)
    assert np.all(code[DIM:] == 0)


def references(n):
    return Images.from_arrays([image(42, 56, 10 + seed) for seed in range(n)])


def test_learnt_centres_are_the_means_of_the_values_that_are_nearest_to_them(folder):
    fitted = learning(folder).fit(references(6), np.arange(6))
    centres = fitted._network.centres.double().numpy()
    values = np.concatenate([facet(tensors, seen) for seen in references(6)])
    nearest = np.linalg.norm(values[:, None] - centres, axis=2).argmin(1)
    assert distance(centres, np.stack([values[nearest == word].mean(0) for word in range(3)])) < 1e-3
    code = fitted.encode(Images.from_arrays([image(56, 56)]))
    assert distance(code, unit(vlad(facet(tensors, image(56, 56)), centres))) < NETWORK.tolerance
    assert not fitted._network.values._forward_hooks  # nothing goes on to collect values
    path = NETWORK.file(folder)
    published = NETWORK.method(path)
    assert (published.keeps_descriptors(), fitted.keeps_descriptors()) == (True, False)
    assert list(published.files()) == [path, path.with_suffix(".centres")]
    assert list(fitted.files()) == [path]


def test_a_fit_of_too_few_values_is_refused_and_forgets_the_one_before(folder):
    with pytest.raises(NotFittedError, match="fit"):
        encoded(learning(folder), image(42, 42))
    fitted = learning(folder, words=5).fit(references(6), np.arange(6))
    with pytest.raises(BadInput, match=r"4 different .* method\.words=5"):
        fitted.fit(Images.from_arrays([image(28, 28)]), np.zeros(1, np.int64))
    with pytest.raises(NotFittedError):
        encoded(fitted, image(42, 42))


def test_centres_that_do_not_fit_are_refused(folder):
    nan = torch.full((WORDS, DIM), torch.nan)
    told = answer(NETWORK.encode, folder, image(42, 42), kind=MissingData, centres=weights(Path("nowhere.pt")))
    assert "method.centres.path=nowhere.pt" in told
    for wrong in (torch.zeros(WORDS + 1, DIM), torch.zeros(WORDS, DIM - 1), nan, torch.zeros(WORDS, DIM).long()):
        path = written(wrong, folder / "wrong.pt")
        told = answer(NETWORK.encode, folder, image(42, 42), centres=weights(path))
        assert (str(path) in told, f"({WORDS}, {DIM})" in told) == (True, True)
