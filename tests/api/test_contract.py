"""The contract: what a descriptor method gets for free, datasets that do not fit, and the face of vprbench.api."""

import re
import subprocess
import sys
import tracemalloc
from dataclasses import dataclass

import numpy as np
import pytest
from checkout import ROOT

from vprbench import api
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.errors import BadInput, NotFittedError


class Colour(DescriptorMethod):
    """The mean colour as a unit vector; counts the images of every call."""

    def __init__(self):
        self.encoded = []

    def encode(self, images):
        self.encoded.append(len(images))
        mean = np.array([image.mean(axis=(0, 1)) for image in images], np.float32).reshape(-1, 3)
        return mean / np.linalg.norm(mean, axis=1, keepdims=True)


RED, GREEN, OLIVE = (200, 0, 0), (0, 9, 0), (30, 40, 0)


def plain(*colours):
    return Images.from_arrays([np.full((2, 2, 3), colour, np.uint8) for colour in colours])


def dataset(**parts):
    given = {"name": "mine", "references": plain(*[RED] * 4), "places": np.arange(4), "queries": plain(RED, RED)}
    return Dataset(**{**given, "positives": (np.array([0]),) * 2, "protocol": {}, **parts})


@pytest.mark.parametrize("index", ["exact", "hnsw"])
def test_a_place_scores_the_inner_product_with_its_best_image_by_an_own_copy_of_places(index):
    method, places = Colour(), np.array([0, 1, 0, 1])
    method.index = index
    method.fit(plain(RED, GREEN, GREEN, OLIVE), places)
    places[:] = 0
    # OLIVE is (0.6, 0.8, 0) as a unit vector
    assert method.query(plain(OLIVE, RED)) == pytest.approx(np.array([[0.8, 1], [1, 0.6]]), abs=1e-6)


def test_references_are_encoded_in_blocks_in_order_and_held_once():
    colours = [(1 + i, 200 - i, 0) for i in range(150)]
    method = Colour().fit(plain(*colours), np.arange(150))
    assert sum(method.encoded) == 150
    assert max(method.encoded) < 150
    assert method.query(plain(*colours[::-1])).argmax(axis=1).tolist() == list(range(150))[::-1]
    references = plain(*((*divmod(i, 256), 7) for i in range(2000)))
    tracemalloc.start()
    Drawn().fit(references, np.arange(2000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.5 * 2000 * 1000 * 4


def test_without_references_there_is_no_map_and_arguments_of_the_search_come_by_name_alone():
    with pytest.raises(NotFittedError, match="fit"):
        Colour().match(np.zeros((1, 3), np.float32))
    with pytest.raises(BadInput, match="0 came"):
        Colour().fit(plain(), np.empty(0, np.int64))
    method = Colour().fit(plain(RED, GREEN), np.arange(2))
    with pytest.raises(BadInput):
        method.fit_descriptors(np.zeros((2, 3), np.float32), np.arange(3))
    with pytest.raises(NotFittedError):
        method.match(np.zeros((1, 3), np.float32))
    method = Colour()
    assert (method.index, method.neighbours) == ("exact", 100)
    method.index = "ivfpq"
    with pytest.raises(BadInput, match=r"ivfpq .*256 .*2 came"):
        method.fit(plain(RED, GREEN), np.arange(2))
    assert method.encoded == []
    assert Drawn.query_arguments == {"index", "neighbours", "rerank", "probes"}
    assert Drawn(5).n_dimensions == 5
    with pytest.raises(TypeError):
        Drawn(5, "hnsw")
    assert len({Colour(), Colour()}) == 2  # equal to itself alone


@dataclass
class Drawn(DescriptorMethod):
    """A random unit vector for each image."""

    n_dimensions: int = 1000

    def encode(self, images):
        vectors = np.array([np.random.default_rng(image[0, 0]).standard_normal(self.n_dimensions) for image in images])
        return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ({"references": plain(), "places": np.array([], np.int64)}, "no reference images"),
        ({"queries": plain(), "positives": ()}, "no query images"),
        ({"places": np.arange(3)}, "4 reference images but 3 place ids"),
        ({"places": np.array([0, 1, 1, 4])}, "[2, 3] are missing"),
        ({"places": np.array([-1, 0, 1, 2])}, "-1 came"),
        ({"positives": (np.array([0]),)}, "2 queries but ground truth for 1"),
        ({"name": "a/b"}, "dataset.name=a/b"),
        ({"place_numbers": np.arange(3)}, "3 numbers for 4 places"),
        ({"positives": (np.array([0]), np.array([1, 4]))}, "of query 1 (image 1) names place 4, but places run from"),
        ({"positives": (np.array([0]), np.array([-2, 1]))}, "names place -2, but places run from 0 to 3"),
    ],
)
def test_parts_of_a_dataset_that_do_not_fit_are_refused_with_their_numbers(parts, wanted):
    with pytest.raises(BadInput, match=re.escape(wanted)):
        dataset(**parts)
    assert dataset(places=np.array([0, 1, 0, 1])).n_places == 2
    assert dataset(positives=(np.array([0, 3]), np.array([], np.int64))).n_places == 4


def test_what_needs_no_torch_does_not_wait_for_it():
    with_torch = {"NeuralDescriptor", "encode_blocks", "in_shares"}
    free = sorted({*api.__all__} - with_torch - {"Interpolation", "Resize"})
    code = f"""
import sys, vprbench.api as api
face = {{'torch', 'matplotlib', 'faiss', 'numba'}} & {{*sys.modules}}
for name in {free}: getattr(api, name)
import numpy as np
api.Search(np.eye(3, dtype=np.float32), np.arange(3)).scores(np.eye(3, dtype=np.float32))
print(face, 'torch' in sys.modules or 'faiss' in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()", "False"]
