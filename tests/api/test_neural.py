"""What all neural descriptors share, tried on a network of two convolutions.

"cpu:0" stands for a GPU here: torch computes on the CPU, and the descriptor takes the way that it takes on a GPU.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import neural
from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.neural import NeuralDescriptor
from vprbench.api.resize import resize_batch, resize_image
from vprbench.api.weight_files import state_dict
from vprbench.api.weights import Weights, load_strictly
from vprbench.errors import BadInput
from vprbench.plugins import conformance

GPU = "cpu:0"


class Network(nn.Module):
    """Two convolutions, then the mean over positions, (n, 6)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 8, 3, stride=2)
        self.second = nn.Conv2d(8, 6, 3)

    def forward(self, images: Tensor) -> Tensor:
        out: Tensor = self.second(functional.relu(self.first(images))).mean((2, 3))
        return out


@dataclass(kw_only=True)
class Tiny(NeuralDescriptor):
    """The least that a plug-in has to write."""

    def load(self, path: Path) -> nn.Module:
        with torch.device("meta"):
            network = Network()
        load_strictly(network, state_dict(path), path)
        return network

    def blank(self) -> nn.Module:
        return Network()


class Fourteen(Tiny):
    multiple: ClassVar[int] = 14


class Large(Tiny):
    smallest_side: ClassVar[int] = 300


class Watched(nn.Module):
    """Gives the means of the channels that it sees, and remembers what came."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(2, 3, 2, 2))
        self.seen: list[Tensor] = []
        self.tf32: list[bool] = []

    def forward(self, images: Tensor) -> Tensor:
        self.seen.append(images)
        self.tf32.append(torch.backends.cudnn.allow_tf32)
        return images.mean((2, 3))


NOWHERE = Weights(file="tiny.safetensors", licence="none", trained_on="nothing", path="nowhere/tiny.safetensors")


def watching(**arguments: Any) -> tuple[NeuralDescriptor, Watched]:
    method, network = Tiny(weights=NOWHERE, **arguments), Watched()
    method.use(network)
    return method, network


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    generator = torch.Generator().manual_seed(1)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    shapes = {name: value.shape for name, value in Network().state_dict().items()}
    save_file({name: torch.randn(shape, generator=generator) * 0.4 for name, shape in shapes.items()}, path)
    return path


@pytest.fixture
def weights(file: Path) -> Weights:
    return Weights(file=file.name, licence="none", trained_on="nothing", path=str(file))


@pytest.fixture
def pinned(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """The shapes of what was pinned: without a GPU torch would refuse."""
    shapes = []

    def pin_memory(self: Tensor) -> Tensor:
        shapes.append(tuple(self.shape))
        return self.clone()

    monkeypatch.setattr(Tensor, "pin_memory", pin_memory)
    return shapes


@pytest.fixture
def no_thread_stays() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


def noise(count: int, size: tuple[int, int] = (20, 26), seed: int = 0) -> list[Image]:
    return list(np.random.default_rng(seed).integers(0, 256, (count, *size, 3), dtype=np.uint8))


def mixed() -> list[Image]:
    """Three sizes, neighbours alike and not."""
    small, wide = noise(5), noise(4, (20, 40), seed=1)
    return [*small[:3], *wide[:2], small[3], *wide[2:], *noise(1, (33, 19)), small[4]]


def slowly(images: list[Image], broken: int | None = None) -> Images:
    """Images that are read by threads, one of which cannot be."""

    def read(i: int) -> Image:
        if i == broken:
            raise BadInput(f"image {i} is torn")
        return images[i]

    return Images(read, [str(i) for i in range(len(images))])


def numbered(count: int, size: tuple[int, int] = (4, 4)) -> list[Image]:
    return [np.full((*size, 3), 10 * (i % 26), np.uint8) for i in range(count)]


def numbers(network: Watched) -> list[list[int]]:
    """The images of each batch by number, as `numbered` painted them."""
    red = [batch[:, 0, 0, 0].float() * 0.229 + 0.485 for batch in network.seen]
    return [(level * 255 / 10).round().int().tolist() for level in red]


def by_hand(file: Path, image: Image) -> npt.NDArray[np.float64]:
    """The descriptor in float64."""
    tensors = {name: value.double() for name, value in state_dict(file).items()}
    scaled = (image / 255 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    x = torch.from_numpy(scaled).permute(2, 0, 1)[None]
    x = functional.conv2d(x, tensors["first.weight"], tensors["first.bias"], stride=2).clamp(min=0)
    x = functional.conv2d(x, tensors["second.weight"], tensors["second.bias"]).mean((2, 3))[0]
    return (x / x.norm()).numpy()


def test_the_network_is_loaded_when_first_needed_and_once_and_changes_neither_equality_nor_repr(
    weights: Weights, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = []
    load = Tiny.load
    monkeypatch.setattr(Tiny, "load", lambda self, path: loaded.append(path) or load(self, path))
    method, fresh = Tiny(weights=weights), Tiny(weights=weights)
    assert loaded == []
    for _ in range(2):
        method.encode(Images.from_arrays(noise(3)))
    assert loaded == list(method.files()) == [file]
    assert (method, repr(method)) == (fresh, repr(fresh))


def test_a_missing_file_is_named_when_files_are_asked_for_and_when_images_are() -> None:
    for ask in (lambda method: method.files(), lambda method: method.encode(Images.from_arrays(noise(1)))):
        with pytest.raises(BadInput, match=r"method\.weights\.path=nowhere/tiny\.safetensors is no file.*Tiny"):
            ask(Tiny(weights=NOWHERE))


def test_a_descriptor_is_what_the_formulas_give_of_unit_length_and_the_same_each_time(
    weights: Weights, file: Path
) -> None:
    images = mixed()
    codes, again = (Tiny(weights=weights).encode(Images.from_arrays(images)) for _ in range(2))
    assert codes.dtype == np.float32
    assert np.array_equal(codes, again)
    assert np.abs(np.linalg.norm(codes.astype(np.float64), axis=1) - 1).max() < 1e-6
    assert np.abs(codes - [by_hand(file, image) for image in images]).max() < 1e-5


def filled(value: float, **arguments: Any) -> NeuralDescriptor:
    """A linear layer of which every parameter has this value, for images of 4 x 4."""
    method = Tiny(weights=NOWHERE, **arguments)
    method.use(nn.Sequential(nn.Flatten(), nn.Linear(48, 5)))
    for parameter in method._network.parameters():
        parameter.fill_(value)
    return method


def test_an_output_of_zeros_is_a_zero_vector() -> None:
    assert np.array_equal(filled(0).encode(Images.from_arrays(numbered(2))), np.zeros((2, 5), np.float32))


@pytest.mark.parametrize(
    ("precision", "value", "advice"), [("float32", 3e38, "weights"), ("float16", 6e4, r"method\.precision=float32")]
)
def test_an_output_that_is_not_finite_is_refused(precision: str, value: float, advice: str, pinned: list) -> None:
    with pytest.raises(BadInput, match=f"^Tiny .* {precision}: .*{advice}"):
        filled(value, precision=precision, device=GPU).encode(Images.from_arrays(numbered(2)))


@pytest.mark.parametrize("arguments", [{}, {"height": 30}, {"height": 8, "width": 9}])
def test_no_images_give_no_rows_of_the_right_length(arguments: dict[str, int], weights: Weights) -> None:
    for kind in (Tiny, Large):
        codes = kind(weights=weights, **(arguments if kind is Tiny else {})).encode(Images.from_arrays([]))
        assert (codes.shape, codes.dtype) == ((0, 6), np.float32)


TWO_SIZES = [image[:3] if i in (2, 3) else image for i, image in enumerate(numbered(7))]


@pytest.mark.parametrize(
    ("arguments", "images", "n_bytes", "batches"),
    [
        ({"batch_size": 3}, numbered(8), None, [[0, 1, 2], [3, 4, 5], [6, 7]]),
        ({"batch_size": 3}, TWO_SIZES, None, [[0, 1], [2, 3], [4, 5, 6]]),
        (
            {"batch_size": 9, "height": 5, "width": 5},
            [image[: 3 + i % 2] for i, image in enumerate(numbered(4))],
            None,
            [[0, 1, 2, 3]],
        ),
        ({}, numbered(5), 4 * 3 * 4 * 4 * 2.5, [[0, 1], [2, 3], [4]]),
        ({}, numbered(2), 10, [[0], [1]]),
    ],
    ids=["as many as asked for", "two sizes", "resized to one size", "as many as bytes allow", "one at least"],
)
def test_images_of_one_size_share_a_batch_in_order_as_many_as_fit(
    arguments: dict[str, int],
    images: list[Image],
    n_bytes: float | None,
    batches: list[list[int]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(neural, "_BATCH_BYTES", n_bytes or neural._BATCH_BYTES)
    method, network = watching(**arguments)
    method.encode(Images.from_arrays(images))
    assert numbers(network) == batches


@pytest.mark.parametrize(("side", "allowed"), [(8, 2), (2, 9)])
def test_the_bytes_allowed_count_before_and_after_tensors_are_resized(
    side: int, allowed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neural, "_BATCH_BYTES", 4 * 3 * max(side, 4) ** 2 * allowed)
    method, network = watching(batch_size=16, height=side, width=side, resize="tensor")
    method.encode(Images.from_arrays(numbered(20)))
    assert {len(batch) for batch in network.seen[:-1]} == {allowed}


def test_pixels_are_what_imagenet_networks_were_trained_on() -> None:
    levels = torch.tensor([[0.0, 128, 255]]).expand(3, 3)[None, ..., None].clone()
    seen = Tiny(weights=NOWHERE).pixels(levels)[0, ..., 0]
    # (level / 255 - mean) / deviation, worked out by hand for 0, 128 and 255 of red, green and blue
    wanted = [[-2.117904, 0.074065, 2.248908], [-2.035714, 0.205182, 2.428571], [-1.804444, 0.426492, 2.640000]]
    assert np.abs(seen.numpy() - wanted).max() < 1e-5


@pytest.mark.parametrize("how", ["pillow", "opencv", "area", "tensor"])
@pytest.mark.parametrize("kind", ["bilinear", "bicubic"])
@pytest.mark.parametrize(
    ("asked", "size"), [((None, None), (20, 26)), ((7, 9), (7, 9)), ((7, None), (7, 26)), ((None, 30), (20, 30))]
)
def test_the_network_sees_images_in_the_size_and_resized_in_the_way_asked_for(
    how: Any, kind: Any, asked: Any, size: tuple[int, int]
) -> None:
    image = noise(1)[0]
    method, network = watching(height=asked[0], width=asked[1], resize=how, interpolation=kind)
    method.encode(Images.from_arrays([image]))
    mean, deviation = (torch.tensor(v)[:, None, None] for v in (neural.IMAGENET_MEAN, neural.IMAGENET_DEVIATION))
    levels = 255 * (network.seen[0] * deviation + mean)
    if how == "tensor":
        wanted = resize_batch(torch.from_numpy(image).permute(2, 0, 1)[None].float(), *size, kind)
    else:
        wanted = torch.from_numpy(resize_image(image, *size, how, kind).copy()).permute(2, 0, 1)[None].float()
    assert levels.shape == (1, 3, *size)
    assert float((levels - wanted).abs().max()) < 1e-3


@pytest.mark.parametrize(
    ("given", "size", "wanted"),
    [
        ({}, (100, 150), (98, 154)),
        ({}, (14, 28), (14, 28)),
        ({}, (5, 3), (14, 14)),
        ({"height": 224}, (100, 150), (224, 154)),
    ],
)
def test_sides_are_those_given_or_the_nearest_multiples(
    given: dict[str, int], size: tuple[int, int], wanted: tuple[int, int]
) -> None:
    assert Fourteen(weights=NOWHERE, **given).target(*size) == wanted


@pytest.mark.parametrize("how", ["pillow", "opencv", "tensor"])
def test_images_are_brought_to_the_nearest_multiple(how: Any, weights: Weights) -> None:
    method = Fourteen(weights=weights, resize=how)
    method.use(network := Watched())
    method.encode(Images.from_arrays(noise(1, (20, 50))))
    assert network.seen[0].shape == (1, 3, 14, 56)


@pytest.mark.parametrize("how", ["pillow", "tensor"])
def test_an_image_too_small_is_refused_by_its_size(how: Any, weights: Weights) -> None:
    method = Large(weights=weights, width=400, resize=how)
    with pytest.raises(BadInput, match=r"26x20.*400x20.*300.*pixels.*method\.height"):
        method.encode(Images.from_arrays(noise(1)))
    assert Large(weights=weights, height=300, width=300).encode(Images.from_arrays(noise(1))).shape == (1, 6)


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (Tiny, {"batch_size": 0}, r"method\.batch_size=0: give at least 1"),
        (Tiny, {"height": 0}, r"method\.height=0: give a multiple of 1"),
        (Tiny, {"width": -4}, r"method\.width=-4"),
        (Fourteen, {"width": 225}, r"method\.width=225: give a multiple of 14"),
        (Tiny, {"precision": "float16"}, r"method\.precision=float16: on the CPU float32 alone.*device=cuda"),
    ],
)
def test_arguments_that_do_not_fit_are_named(kind: Any, arguments: dict, message: str, weights: Weights) -> None:
    for images in (noise(1), []):
        with pytest.raises(BadInput, match=message):
            kind(weights=weights, **arguments).encode(Images.from_arrays(images))


@pytest.mark.parametrize(
    ("kind", "images", "wanted"),
    [
        (Tiny, slowly(noise(9), broken=5), "image 5 is torn"),
        (Large, slowly([*noise(3, (300, 300)), *noise(4)]), "Large needs 300 pixels"),
    ],
    ids=["torn", "too small"],
)
@pytest.mark.parametrize("device", ["cpu", GPU])
def test_an_image_that_cannot_be_described_is_the_callers_error(
    device: str, kind: Any, images: Images, wanted: str, weights: Weights, pinned: list, no_thread_stays: None
) -> None:
    with pytest.raises(BadInput, match=wanted):
        kind(weights=weights, batch_size=2, device=device).encode(images)


@pytest.mark.parametrize("device", ["cpu", GPU])
def test_no_thread_stays_where_the_network_fails_even_while_the_error_is_held(device: str, pinned: list) -> None:
    before = set(threading.enumerate())
    method = Tiny(weights=NOWHERE, batch_size=2, device=device)
    method.use(nn.Sequential(nn.Flatten(), nn.Linear(7, 7)))
    with pytest.raises(RuntimeError) as held:
        method.encode(slowly(numbered(200)))
    assert set(threading.enumerate()) <= before
    assert held.tb is not None


def test_the_way_over_a_gpu_by_pinned_batches_gives_what_the_cpu_gives(
    weights: Weights, pinned: list, no_thread_stays: None
) -> None:
    over_a_gpu = Tiny(weights=weights, batch_size=2, device=GPU).encode(slowly(mixed()))
    assert pinned[:3] == [(2, 20, 26, 3), (1, 20, 26, 3), (2, 20, 40, 3)]
    assert np.abs(over_a_gpu - Tiny(weights=weights).encode(Images.from_arrays(mixed()))).max() < 1e-6


def test_on_a_gpu_the_next_batch_and_no_more_is_made_in_one_thread_meanwhile(pinned: list) -> None:
    made: list[tuple[int, str]] = []
    fifth = threading.Event()

    class Slow(Tiny):
        def _sized(self, image: Image) -> Image:
            made.append((int(image[0, 0, 0]) // 10, threading.current_thread().name))
            if made[-1][0] == 4:
                fifth.set()
            return super()._sized(image)

    class Waiting(nn.Module):
        def forward(self, images: Tensor) -> Tensor:
            if len(counts) == 0:  # batches 1 and 2, and the look at batch 3 that ends batch 2
                assert fifth.wait(30)
            counts.append(len(made))
            return images.mean((2, 3))

    counts: list[int] = []
    method = Slow(weights=NOWHERE, batch_size=2, device=GPU)
    method.use(Waiting())
    method.encode(Images.from_arrays(numbered(9)))
    assert counts[0] == 5
    assert [number for number, _ in made] == list(range(9))
    threads = {name for _, name in made}
    assert len(threads) == 1
    assert threading.current_thread().name not in threads


def test_on_the_cpu_no_thread_takes_the_cores_from_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    names, sized = set(), Tiny._sized
    monkeypatch.setattr(
        Tiny, "_sized", lambda self, image: names.add(threading.current_thread().name) or sized(self, image)
    )
    watching(batch_size=2)[0].encode(Images.from_arrays(numbered(9)))
    assert names == {threading.current_thread().name}


@pytest.mark.parametrize("how", ["pillow", "tensor"])
@pytest.mark.parametrize("precision", ["float32", "float16", "bfloat16"])
def test_network_and_images_have_the_precision_asked_for_and_channels_last(
    precision: Any, how: Any, pinned: list
) -> None:
    method, network = watching(precision=precision, device=GPU, resize=how, height=6, width=8)
    codes = method.encode(Images.from_arrays(noise(2)))
    for tensor in (network.weight, network.seen[0]):
        assert tensor.dtype == getattr(torch, precision)
        assert tensor.is_contiguous(memory_format=torch.channels_last)
    assert codes.dtype == np.float32
    assert np.abs(np.linalg.norm(codes.astype(np.float64), axis=1) - 1).max() < 1e-6


@pytest.mark.parametrize(("precision", "tolerance"), [("float16", 5e-3), ("bfloat16", 4e-2)])
def test_half_precision_gives_nearly_the_same_descriptor(
    precision: Any, tolerance: float, weights: Weights, pinned: list
) -> None:
    half = Tiny(weights=weights, precision=precision, device=GPU).encode(Images.from_arrays(mixed()))
    difference = np.abs(half - Tiny(weights=weights).encode(Images.from_arrays(mixed()))).max()
    assert 1e-6 < difference < tolerance


def test_the_network_evaluates_with_exact_convolutions_left_as_they_were(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    method, network = watching()
    method.encode(Images.from_arrays(numbered(1)))
    assert network.tf32 == [False]
    assert not network.training
    assert not any(parameter.requires_grad for parameter in [*network.parameters(), *network.seen])
    assert torch.backends.cudnn.allow_tf32 is True
    method.use(nn.Linear(7, 7))
    with pytest.raises(RuntimeError):
        method.encode(Images.from_arrays(numbered(1)))
    assert torch.backends.cudnn.allow_tf32 is True


def test_what_does_not_change_a_descriptor_fits_any_map() -> None:
    assert {"batch_size", "device"} <= Tiny.query_arguments
    assert not {"height", "width", "resize", "interpolation", "precision", "weights"} & Tiny.query_arguments


@pytest.mark.parametrize("arguments", [{}, {"height": 32, "width": 40, "resize": "tensor", "batch_size": 4}])
def test_it_keeps_the_rules_of_the_contract(
    arguments: dict[str, Any], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    weights = {"file": file.name, "licence": "none", "trained_on": "nothing", "path": str(file)}
    config = {"_target_": "test_neural.Tiny", "weights": weights, **arguments}
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []
