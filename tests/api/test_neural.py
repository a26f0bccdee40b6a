"""What all neural descriptors share, tried on a network of two convolutions, and how images are resized for them.

"cpu:0" stands for a GPU here: torch computes on the CPU, and the descriptor takes the way that it takes on a GPU.
"""

import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from vprbench.api import neural
from vprbench.api.images import Images
from vprbench.api.neural import NeuralDescriptor, resize_batch, resize_image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput

GPU = "cpu:0"
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet
NOWHERE = Weights(file="tiny.safetensors", licence="none", trained_on="nothing", path="nowhere/tiny.safetensors")


@dataclass(kw_only=True)
class Tiny(NeuralDescriptor):
    """The least that a plug-in has to write."""

    def load(self, path):
        return Watched(path)

    def blank(self):
        return Watched()


class Watched(nn.Module):
    """Gives means of the channels that it sees, and remembers what came."""

    def __init__(self, path=None):
        super().__init__()
        self.path, self.weight = path, nn.Parameter(torch.ones(2, 3, 2, 2))
        self.seen, self.tf32 = [], []

    def forward(self, images):
        self.seen.append(images)
        self.tf32.append(torch.backends.cudnn.allow_tf32)
        return images.mean((2, 3))


def watching(kind=Tiny, **arguments):
    method, network = kind(weights=NOWHERE, **arguments), Watched()
    method.use(network)
    return method, network


@pytest.fixture
def weights(tmp_path):
    (tmp_path / "tiny.safetensors").touch()
    return replace(NOWHERE, path=str(tmp_path / "tiny.safetensors"))


@pytest.fixture
def pinned(monkeypatch):
    """The shapes of what was pinned: without a GPU torch would refuse."""
    shapes = []

    def pin_memory(self):
        shapes.append(tuple(self.shape))
        return self.clone()

    monkeypatch.setattr(Tensor, "pin_memory", pin_memory)
    return shapes


@pytest.fixture
def no_thread_stays():
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


def noise(count, size=(20, 26), seed=0):
    return list(np.random.default_rng(seed).integers(0, 256, (count, *size, 3), dtype=np.uint8))


def mixed():
    """Three sizes, neighbours alike and not."""
    small, wide = noise(5), noise(4, (20, 40), seed=1)
    return [*small[:3], *wide[:2], small[3], *wide[2:], *noise(1, (33, 19)), small[4]]


def numbered(count, size=(4, 4)):
    return [np.full((*size, 3), 10 * (i % 26), np.uint8) for i in range(count)]


def test_a_descriptor_is_what_the_formulas_give_of_unit_length_from_a_network_that_is_loaded_once(weights, monkeypatch):
    loaded = []
    load = Tiny.load
    monkeypatch.setattr(Tiny, "load", lambda self, path: loaded.append(path) or load(self, path))
    method, fresh = Tiny(weights=weights), Tiny(weights=weights)
    assert loaded == []
    codes, again = (method.encode(Images.from_arrays(mixed())) for _ in range(2))
    assert loaded == list(method.files()) == [Path(weights.path)]
    assert (method, repr(method)) == (fresh, repr(fresh))
    assert codes.dtype == np.float32
    assert np.array_equal(codes, again)
    means = [(image / 255 - MEAN).mean((0, 1)) / DEVIATION for image in mixed()]
    assert np.abs(codes - means / np.linalg.norm(means, axis=1, keepdims=True)).max() < 1e-5
    assert method.keeps_descriptors()


@pytest.mark.parametrize("kind", [Tiny, type("Large", (Tiny,), {"smallest_side": 300})])
def test_no_images_give_no_rows_of_the_right_length_and_a_missing_file_is_named(kind, weights):
    codes = kind(weights=weights).encode(Images.from_arrays([]))
    assert (codes.shape, codes.dtype) == ((0, 3), np.float32)
    for ask in (lambda method: method.files(), lambda method: method.encode(Images.from_arrays(noise(1)))):
        with pytest.raises(BadInput, match=rf"weights\.path=nowhere/tiny\.safetensors is no file.*{kind.__name__}"):
            ask(kind(weights=NOWHERE))


@pytest.mark.parametrize(
    ("precision", "value", "advice"), [("float32", 3e38, "weights"), ("float16", 6e4, r"method\.precision=float32")]
)
def test_an_output_of_zeros_is_a_zero_vector_and_one_that_is_not_finite_is_refused(precision, value, advice, pinned):
    def encoded(parameters):
        """Encode images of 4 x 4 by a linear layer whose parameters all have this value."""
        method = Tiny(weights=NOWHERE, precision=precision, device=GPU)
        method.use(nn.Sequential(nn.Flatten(), nn.Linear(48, 5)))
        for parameter in method._network.parameters():
            parameter.fill_(parameters)
        return method.encode(Images.from_arrays(numbered(2)))

    assert np.array_equal(encoded(0), np.zeros((2, 5), np.float32))
    with pytest.raises(BadInput, match=f"^Tiny .* {precision}: .*{advice}"):
        encoded(value)


LOW = numbered(4, (3, 4))


@pytest.mark.parametrize(
    ("arguments", "images", "n_bytes", "batches"),
    [
        ({"batch_size": 3}, numbered(8), None, [[0, 1, 2], [3, 4, 5], [6, 7]]),
        ({"batch_size": 3}, [*numbered(2), *LOW[2:4], *numbered(7)[4:]], None, [[0, 1], [2, 3], [4, 5, 6]]),
        ({"batch_size": 9, "height": 5, "width": 5}, [*LOW[:1], *numbered(4)[1:]], None, [[0, 1, 2, 3]]),
        ({}, numbered(5), 4 * 3 * 4 * 4 * 2.5, [[0, 1], [2, 3], [4]]),
        ({"height": 8, "width": 8, "resize": "tensor"}, numbered(3), 4 * 3 * 8 * 8 * 2, [[0, 1], [2]]),
        ({"height": 2, "width": 2, "resize": "tensor"}, numbered(3), 4 * 3 * 4 * 4 * 2, [[0, 1], [2]]),
        ({}, numbered(2), 10, [[0], [1]]),
    ],
)
def test_images_of_one_size_share_a_batch_in_order_as_many_as_fit(arguments, images, n_bytes, batches, monkeypatch):
    monkeypatch.setattr(neural, "_BATCH_BYTES", n_bytes or neural._BATCH_BYTES)
    method, network = watching(**arguments)
    method.encode(Images.from_arrays(images))
    red = [batch[:, 0, 0, 0].float() * 0.229 + 0.485 for batch in network.seen]
    assert [(level * 255 / 10).round().int().tolist() for level in red] == batches


@pytest.mark.parametrize("how", ["pillow", "opencv", "area", "tensor"])
@pytest.mark.parametrize("kind", ["bilinear", "bicubic"])
@pytest.mark.parametrize(("asked", "size"), [((None, None), (20, 26)), ((7, None), (7, 26)), ((None, 30), (20, 30))])
def test_the_network_sees_images_in_the_size_and_resized_in_the_way_asked_for(how, kind, asked, size):
    image = noise(1)[0]
    method, network = watching(height=asked[0], width=asked[1], resize=how, interpolation=kind)
    method.encode(Images.from_arrays([image]))
    mean, deviation = (torch.tensor(v)[:, None, None] for v in (MEAN, DEVIATION))
    levels = 255 * (network.seen[0] * deviation + mean)
    if how == "tensor":
        wanted = resize_batch(torch.from_numpy(image).permute(2, 0, 1)[None].float(), *size, kind)
    else:
        wanted = torch.from_numpy(resize_image(image, *size, how, kind).copy()).permute(2, 0, 1)[None].float()
    assert levels.shape == (1, 3, *size)
    assert float((levels - wanted).abs().max()) < 1e-3


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (Tiny, {"batch_size": 0}, r"method\.batch_size=0: give at least 1"),
        (Tiny, {"height": 0}, r"method\.height=0: give a multiple of 1"),
        (type("Fourteen", (Tiny,), {"multiple": 14}), {"width": 225}, r"method\.width=225: give a multiple of 14"),
        (Tiny, {"precision": "float16"}, r"method\.precision=float16: on the CPU float32 alone.*device=cuda"),
    ],
)
def test_arguments_that_do_not_fit_are_named_before_the_file_is_looked_for(kind, arguments, message):
    method = kind(weights=NOWHERE, **arguments)
    for ask in (method.files, *(lambda n=n: method.encode(Images.from_arrays(noise(n))) for n in (0, 1))):
        with pytest.raises(BadInput, match=message):
            ask()


@pytest.mark.parametrize("how", ["pillow", "tensor"])
@pytest.mark.parametrize(
    ("precision", "least", "most"), [("float32", 0, 1e-6), ("float16", 1e-6, 5e-3), ("bfloat16", 1e-6, 4e-2)]
)
def test_pinned_batches_give_nearly_what_the_cpu_gives(how, precision, least, most, weights, pinned, no_thread_stays):
    arguments = {"weights": weights, "batch_size": 2, "resize": how, "height": 10}
    method = Tiny(**arguments, device=GPU, precision=precision)
    codes = method.encode(Images(mixed().__getitem__, [*"0123456789"]))
    height = 10 if how == "pillow" else 20
    assert pinned[:3] == [(2, height, 26, 3), (1, height, 26, 3), (2, height, 40, 3)]
    assert least <= np.abs(codes - Tiny(**arguments).encode(Images.from_arrays(mixed()))).max() < most
    for tensor in (method._network.weight, *method._network.seen):
        assert tensor.dtype == getattr(torch, precision)
        assert tensor.is_contiguous(memory_format=torch.channels_last)
    assert codes.dtype == np.float32
    assert np.abs(np.linalg.norm(codes.astype(np.float64), axis=1) - 1).max() < 1e-6


def test_the_network_evaluates_with_exact_convolutions_left_as_they_were(monkeypatch, pinned, no_thread_stays):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    method, network = watching()
    method.encode(Images.from_arrays(numbered(1)))
    assert network.tf32 == [False]
    assert not network.training
    assert not any(parameter.requires_grad for parameter in [*network.parameters(), *network.seen])
    method.use(nn.Linear(7, 7))
    for method.device in (GPU, "cpu"):
        with pytest.raises(RuntimeError):
            method.encode(Images.from_arrays(numbered(100)))
    assert torch.backends.cudnn.allow_tf32 is True
    assert {"batch_size", "device"} <= Tiny.query_arguments
    assert not {"height", "width", "resize", "interpolation", "precision", "weights"} & Tiny.query_arguments


CHANGES = [((32, 48), (10, 13)), ((9, 14), (20, 31)), ((40, 20), (7, 41)), ((64, 64), (1, 1))]


def filter_of(kind, antialiased, x):
    """The triangle, or Keys' cubic convolution: a = -0.5 where images are antialiased, -0.75 elsewhere."""
    x, a = np.abs(x), -0.5 if antialiased else -0.75
    if kind == "bilinear":
        return np.maximum(1 - x, 0)
    near, far = ((a + 2) * x - (a + 3)) * x**2 + 1, a * (x**3 - 5 * x**2 + 8 * x - 4)
    return np.where(x <= 1, near, np.where(x < 2, far, 0))


def taps(n_in, n_out, kind, antialiased):
    """What each of `n_out` takes from each of `n_in`: pixel centres at half, rows summing to 1.

    An antialiasing filter is as wide as the output's pixels; the other one repeats the outermost input pixels.
    """
    scale = n_in / n_out
    width = max(scale, 1) if antialiased else 1
    repeated = 0 if antialiased else 4
    inputs = np.arange(-repeated, n_in + repeated)
    found = filter_of(kind, antialiased, (inputs + 0.5 - (np.arange(n_out)[:, None] + 0.5) * scale) / width)
    found /= found.sum(1, keepdims=True)
    folded = np.zeros((n_out, n_in))
    for column, place in enumerate(np.clip(inputs, 0, n_in - 1)):
        folded[:, place] += found[:, column]
    return folded


def filtered_exactly(image, height, width, kind, antialiased):
    """Resize (h, w, 3) without rounding anything."""
    down, across = (taps(*sides, kind, antialiased) for sides in zip(image.shape, (height, width), strict=False))
    return np.einsum("yh,hwc,xw->yxc", down, image.astype(np.float64), across)


def random_image(size, low=0, high=256):
    return np.random.default_rng(sum(size)).integers(low, high, (*size, 3), dtype=np.uint8)


def by(how):
    def as_tensor(image, *size, kind):
        batch = torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]
        return resize_batch(batch, *size, kind)[0].permute(1, 2, 0).numpy()

    return as_tensor if how == "tensor" else lambda image, *size, kind: resize_image(image, *size, how, kind)


# Images are rounded twice, for columns, then for rows.
@pytest.mark.parametrize(("before", "after"), CHANGES)
@pytest.mark.parametrize("kind", ["bilinear", "bicubic"])
@pytest.mark.parametrize(
    ("how", "antialiased", "within"), [("tensor", True, 1e-3), ("pillow", True, 1.2), ("opencv", False, 1.2)]
)
def test_antialiasing_filters_are_as_wide_as_the_new_pixels(how, antialiased, within, kind, before, after):
    image = random_image(before, 64, 192)
    found = by(how)(image, *after, kind=kind)
    assert np.abs(found - filtered_exactly(image, *after, kind, antialiased)).max() < within


@pytest.mark.parametrize("size", [(10, 13), (64, 96), (70, 40)])
def test_areas_are_means_that_are_not_rounded_or_bilinear_where_a_side_grows(size):
    image = random_image((40, 52))
    found = resize_image(image, *size, "area", "bicubic")
    assert found.dtype == np.float32
    if size == (10, 13):
        np.testing.assert_allclose(found, image.reshape(10, 4, 13, 4, 3).mean((1, 3)), atol=1e-3)
    else:
        assert np.abs(found - filtered_exactly(image, *size, "bilinear", False)).max() < 1e-2
