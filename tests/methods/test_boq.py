"""BoQ: against attention written out by hand in float64, straight from the tensors of a checkpoint."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from backbones_oracle import layer_norm, resnet, resnet_checkpoint, vit_checkpoint, vit_tokens
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.boq import BoQ, BoQResNet50
from vprbench.plugins import conformance

DIM, QUERIES, ROWS = 128, 7, 5  # two heads; published are 384 or 512, 64 and 32
CLASSES = {"dinov2": BoQ, "resnet50": BoQResNet50}
SIZES = {"dinov2": (42, 56), "resnet50": (48, 80)}
KINDS = list(CLASSES)

Tensors = dict[str, Tensor]


def aggregator(generator: torch.Generator, n_channels: int) -> Tensors:
    """Random values under the published names, so large that every part matters."""

    def normal(*shape: int, scale: float = 1.0, mean: float = 0.0) -> Tensor:
        return mean + scale * torch.randn(shape, generator=generator)

    def linear(name: str, n_in: int, n_out: int) -> Tensors:
        return {f"{name}.weight": normal(n_out, n_in, scale=n_in**-0.5), f"{name}.bias": normal(n_out, scale=0.3)}

    def norm(name: str) -> Tensors:
        return {f"{name}.weight": normal(DIM, scale=0.3, mean=1), f"{name}.bias": normal(DIM, scale=0.3)}

    def attention(name: str) -> Tensors:
        inner = {f"{name}.in_proj_weight": normal(3 * DIM, DIM, scale=1.5 * DIM**-0.5)}
        return inner | {f"{name}.in_proj_bias": normal(3 * DIM, scale=0.3)} | linear(f"{name}.out_proj", DIM, DIM)

    tensors = {"proj_c.weight": normal(DIM, n_channels, 3, 3, scale=(9 * n_channels) ** -0.5)}
    tensors |= {"proj_c.bias": normal(DIM, scale=0.3)} | norm("norm_input") | linear("fc", 2 * QUERIES, ROWS)
    for number in (0, 1):
        block = {"queries": normal(1, QUERIES, DIM)}
        block |= attention("self_attn") | attention("cross_attn") | norm("norm_q") | norm("norm_out")
        block |= attention("encoder.self_attn") | norm("encoder.norm1") | norm("encoder.norm2")
        block |= linear("encoder.linear1", DIM, 4 * DIM) | linear("encoder.linear2", 4 * DIM, DIM)
        tensors |= {f"boqs.{number}.{name}": value for name, value in block.items()}
    return {f"aggregator.{name}": value for name, value in tensors.items()}


def checkpoint(kind: str) -> Tensors:
    generator = torch.Generator().manual_seed(5)
    if kind == "resnet50":
        backbone, n_channels = resnet_checkpoint(generator, kind, "backbone.net.", n_stages=3), 1024
    else:
        n_channels = 64
        backbone = {f"backbone.dino.{name}": value for name, value in vit_checkpoint(generator, n_channels).items()}
        backbone["backbone.dino.mask_token"] = torch.randn(1, n_channels, generator=generator)
    return backbone | aggregator(generator, n_channels)


@pytest.fixture(scope="module")
def checkpoints() -> dict[str, Tensors]:
    return {kind: checkpoint(kind) for kind in KINDS}


@pytest.fixture(scope="module")
def files(checkpoints: dict[str, Tensors], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    paths = {kind: tmp_path_factory.mktemp("weights") / f"{kind}.pth" for kind in KINDS}
    for kind, path in paths.items():
        torch.save(checkpoints[kind], path)
    return paths


@pytest.fixture(scope="module")
def described(files: dict[str, Path]) -> dict[str, npt.NDArray[np.float32]]:
    """What the code under test says of `images`."""
    return {kind: method(kind, files[kind]).encode(Images.from_arrays(images())) for kind in KINDS}


def method(kind: str, path: Path, **arguments: Any) -> BoQ:
    height, width = SIZES[kind]
    weights = Weights(file=path.name, licence="none", trained_on="nothing", path=str(path))
    return CLASSES[kind](weights=weights, **{"height": height, "width": width, **arguments})


def images() -> list[Image]:
    generator = np.random.default_rng(3)
    return [generator.integers(0, 256, (*size, 3), dtype=np.uint8) for size in [(64, 96), (64, 96), (93, 53)]]


def seen(image: Image, size: tuple[int, int], antialias: bool = True, mode: str = "bicubic") -> Tensor:
    levels = torch.from_numpy(image / 255.0).permute(2, 0, 1)[None]
    resized = functional.interpolate(levels, size, mode=mode, antialias=antialias)
    mean, deviation = (torch.tensor(v).double() for v in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
    return (resized - mean[:, None, None]) / deviation[:, None, None]


def attention(t: Tensors, at: str, asking: Tensor, asked: Tensor) -> Tensor:
    """One image, (n_asking, DIM) of (n_asked, DIM): softmax(Q K' / sqrt(64)) V in each head of 64 dimensions."""
    weights, biases = t[f"{at}.in_proj_weight"].chunk(3), t[f"{at}.in_proj_bias"].chunk(3)
    q, k, v = (x @ w.T + b for x, w, b in zip((asking, asked, asked), weights, biases, strict=True))
    heads = []
    for start in range(0, DIM, 64):
        of_head = slice(start, start + 64)
        shares = torch.softmax(q[:, of_head] @ k[:, of_head].T / math.sqrt(64), dim=1)
        heads.append(shares @ v[:, of_head])
    return torch.cat(heads, 1) @ t[f"{at}.out_proj.weight"].T + t[f"{at}.out_proj.bias"]


def norm(t: Tensors, at: str, x: Tensor) -> Tensor:
    return layer_norm(x, t[f"{at}.weight"], t[f"{at}.bias"], eps=1e-5)


def local_features(tensors: Tensors, kind: str, image: Image, size: tuple[int, int], trap: str = "") -> Tensor:
    """What the backbone makes of an image, (1, n_channels, rows, columns)."""
    mode = "bilinear" if trap == "bilinear" else "bicubic"
    x = seen(image, size, antialias=trap != "not antialiased", mode=mode)
    if kind == "resnet50":
        return resnet(tensors, "backbone.net.", x, kind, n_stages=3)
    tokens = vit_tokens(tensors, "backbone.dino.", x, final_norm=trap == "with DINOv2's final norm")
    return tokens[:, 1:].transpose(1, 2).unflatten(2, (size[0] // 14, size[1] // 14))


def gathered(t: Tensors, features: Tensor, trap: str = "") -> npt.NDArray[np.float64]:
    """The descriptor of one image's features, before the last normalisation; `trap` names one deliberate mistake."""
    x = functional.conv2d(features, t["proj_c.weight"], t["proj_c.bias"], padding=1).flatten(2)[0].T
    if trap != "without the norm of the input":
        x = norm(t, "norm_input", x)
    outs = []
    for number in (0, 1):
        at, before = f"boqs.{number}", x
        if trap == "norms before":
            inner = norm(t, f"{at}.encoder.norm1", x)
            x = x + attention(t, f"{at}.encoder.self_attn", inner, inner)
            inner = norm(t, f"{at}.encoder.norm2", x)
        else:
            x = norm(t, f"{at}.encoder.norm1", x + attention(t, f"{at}.encoder.self_attn", x, x))
            inner = x
        inner = inner @ t[f"{at}.encoder.linear1.weight"].T + t[f"{at}.encoder.linear1.bias"]
        inner = functional.gelu(inner) if trap == "GELU" else inner.clamp(min=0)
        x = x + inner @ t[f"{at}.encoder.linear2.weight"].T + t[f"{at}.encoder.linear2.bias"]
        if trap != "norms before":
            x = norm(t, f"{at}.encoder.norm2", x)
        queries = t[f"{at}.queries"][0]
        mixed = attention(t, f"{at}.self_attn", queries, queries)
        asking = norm(t, f"{at}.norm_q", mixed if trap == "queries not added" else queries + mixed)
        out = attention(t, f"{at}.cross_attn", asking, before if trap == "features not refined" else x)
        outs.append(norm(t, f"{at}.norm_out", asking + out if trap == "queries added twice" else out))
    if trap == "blocks the other way round":
        outs.reverse()
    rows = torch.cat(outs).T @ t["fc.weight"].T + t["fc.bias"][None]  # (DIM, ROWS)
    return (rows.T if trap == "rows first" else rows).flatten().numpy()


def by_hand(
    tensors: Tensors, kind: str, image: Image, size: tuple[int, int], trap: str = ""
) -> npt.NDArray[np.float64]:
    t = {name.removeprefix("aggregator."): v.double() for name, v in tensors.items() if name.startswith("agg")}
    code = gathered(t, local_features(tensors, kind, image, size, trap), trap)
    return code / np.linalg.norm(code)


@pytest.mark.parametrize("kind", KINDS)
def test_a_descriptor_is_what_the_formulas_give(kind: str, checkpoints: dict, described: dict) -> None:
    for code, image in zip(described[kind], images(), strict=True):
        assert np.abs(code - by_hand(checkpoints[kind], kind, image, SIZES[kind])).max() < 1e-5


@pytest.mark.parametrize(
    "trap",
    [
        "with DINOv2's final norm",
        "bilinear",
        "not antialiased",
        "without the norm of the input",
        "norms before",
        "GELU",
        "queries not added",
        "queries added twice",
        "features not refined",
        "blocks the other way round",
        "rows first",
    ],
)
def test_a_known_mistake_gives_another_descriptor(trap: str, checkpoints: dict, described: dict) -> None:
    mistaken = by_hand(checkpoints["dinov2"], "dinov2", images()[0], SIZES["dinov2"], trap)
    assert np.abs(described["dinov2"][0] - mistaken).max() > 3e-3


def test_images_keep_their_own_size_where_none_is_given(files: dict, checkpoints: dict) -> None:
    image = images()[2]
    for kind, size in {"dinov2": (98, 56), "resnet50": (93, 53)}.items():
        code = method(kind, files[kind], height=None, width=None).encode(Images.from_arrays([image]))[0]
        assert np.abs(code - by_hand(checkpoints[kind], kind, image, size)).max() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_descriptors_are_float32_unit_vectors(kind: str, described: dict) -> None:
    assert described[kind].shape == (3, DIM * ROWS)
    assert described[kind].dtype == np.float32
    assert np.abs(np.linalg.norm(described[kind].astype(np.float64), axis=1) - 1).max() < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_gives_what_its_images_give_one_by_one_and_always_the_same(
    kind: str, files: dict, described: dict
) -> None:
    boq = method(kind, files[kind], batch_size=1)
    alone = boq.encode(Images.from_arrays(images()))
    assert np.abs(alone - described[kind]).max() < 1e-5
    assert np.array_equal(boq.encode(Images.from_arrays(images())), alone)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("precision", "alike"), [(torch.float16, 0.9999), (torch.bfloat16, 0.998)])
def test_half_precision_gives_nearly_the_same_descriptor(
    precision: torch.dtype, alike: float, kind: str, files: dict, described: dict
) -> None:
    network = method(kind, files[kind]).load(files[kind]).to(precision)
    with torch.inference_mode():
        code = network(seen(images()[0], SIZES[kind]).to(precision))[0].double().numpy()
    assert code @ described[kind][0] / np.linalg.norm(code) > alike


def test_tensors_are_called_what_torch_calls_those_of_its_layers(checkpoints: dict) -> None:
    """The published network is made of torch's own layers."""
    layers = {
        "encoder": nn.TransformerEncoderLayer(DIM, DIM // 64, 4 * DIM, batch_first=True),
        "self_attn": nn.MultiheadAttention(DIM, DIM // 64),
        "cross_attn": nn.MultiheadAttention(DIM, DIM // 64),
    }
    for name, layer in layers.items():
        prefix = f"aggregator.boqs.0.{name}."
        found = {k.removeprefix(prefix): v.shape for k, v in checkpoints["dinov2"].items() if k.startswith(prefix)}
        assert found == {k: v.shape for k, v in layer.state_dict().items()}


def test_torchs_own_encoder_gives_what_is_written_out_here(checkpoints: dict) -> None:
    layer = nn.TransformerEncoderLayer(DIM, DIM // 64, 4 * DIM, dropout=0, batch_first=True, dtype=torch.float64)
    prefix = "aggregator.boqs.0.encoder."
    t = {k.removeprefix(prefix): v.double() for k, v in checkpoints["dinov2"].items() if k.startswith(prefix)}
    layer.load_state_dict(t)
    x = torch.randn(9, DIM, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    inner = norm(t, "norm1", x + attention(t, "self_attn", x, x))
    hidden = (inner @ t["linear1.weight"].T + t["linear1.bias"]).clamp(min=0)
    wanted = norm(t, "norm2", inner + hidden @ t["linear2.weight"].T + t["linear2.bias"])
    with torch.no_grad():
        assert torch.allclose(layer.train()(x[None])[0], wanted, atol=1e-12)


Change = Callable[[Tensors], Mapping[str, Any]]


def changed(tmp_path: Path, tensors: Tensors, change: Change) -> Path:
    path = tmp_path / "changed.pth"
    torch.save(change(dict(tensors)), path)
    return path


def renamed(tensors: Tensors) -> Tensors:
    """The names of the other public wrapper."""
    others = {
        "net.0.": "frozen_layers.0.0.",
        "net.1.": "frozen_layers.0.1.",
        "net.4.": "frozen_layers.1.",
        "net.5.": "frozen_layers.2.",
        "net.6.": "unfrozen_layers.0.",
    }
    return {
        re.sub(r"(?<=^backbone\.)net\.\d\.", lambda found: others[found[0]], name): value
        for name, value in tensors.items()
    }


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("resnet50", renamed),
        ("resnet50", lambda tensors: {k: v for k, v in tensors.items() if not k.endswith("num_batches_tracked")}),
        ("resnet50", lambda tensors: {"epoch": 3, "state_dict": tensors}),
        ("dinov2", lambda tensors: {k: v for k, v in tensors.items() if not k.startswith("backbone.dino.norm.")}),
        ("dinov2", lambda tensors: {k: v for k, v in tensors.items() if k != "backbone.dino.mask_token"}),
        ("dinov2", lambda tensors: {k: v.double() for k, v in tensors.items()}),
    ],
    ids=["other wrapper", "no counters", "nested", "no final norm", "no mask token", "float64"],
)
def test_another_form_of_the_same_file_gives_the_same_descriptor(
    kind: str, change: Change, checkpoints: dict, described: dict, tmp_path: Path
) -> None:
    path = changed(tmp_path, checkpoints[kind], change)
    assert np.allclose(method(kind, path).encode(Images.from_arrays(images())), described[kind], atol=1e-6)


def test_names_of_the_other_wrapper_are_not_those_of_this_one(checkpoints: dict) -> None:
    names = set(renamed(checkpoints["resnet50"]))
    assert {"backbone.frozen_layers.0.0.weight", "backbone.unfrozen_layers.0.5.bn3.bias"} <= names
    assert not any(name.startswith("backbone.net.") for name in names)


def without(name: str) -> Change:
    return lambda tensors: {key: value for key, value in tensors.items() if key != name}


def with_(**more: Any) -> Change:
    return lambda tensors: {**tensors, **{name.replace("__", "."): value for name, value in more.items()}}


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        *(
            (kind, without(name), f"missing .*{re.escape(name)}|holds no {re.escape(name)} ")
            for kind, name in [
                ("resnet50", "backbone.net.6.5.bn3.running_var"),
                ("resnet50", "backbone.net.0.weight"),
                ("dinov2", "backbone.dino.blocks.1.ls2.gamma"),
                ("dinov2", "backbone.dino.norm.bias"),
                ("dinov2", "aggregator.proj_c.weight"),
                ("dinov2", "aggregator.boqs.0.queries"),
                ("dinov2", "aggregator.boqs.1.queries"),
                ("dinov2", "aggregator.boqs.1.norm_q.weight"),
                ("dinov2", "aggregator.boqs.0.cross_attn.in_proj_bias"),
                ("dinov2", "aggregator.fc.bias"),
            ]
        ),
        ("dinov2", without("backbone.dino.pos_embed"), r"backbone\.dino\.\*: .*holds no pos_embed"),
        ("dinov2", with_(aggregator__fc__scale=torch.ones(1)), r"unexpected \(aggregator\.fc\.scale\)"),
        ("dinov2", with_(backbone__dino__head__weight=torch.ones(1)), r"unexpected \(backbone\.dino\.head\.weight\)"),
        ("resnet50", with_(backbone__net__7__0__bn1__bias=torch.ones(1)), r"unexpected \(backbone\.net\.7\.0\.bn1\.bi"),
        ("resnet50", with_(backbone__unfrozen_layers__1__w=torch.ones(1)), r"unexpected \(backbone\.unfrozen_lay"),
        ("resnet50", with_(backbone__frozen_layers__0__0__weight=torch.ones(1)), r"backbone\.net\.0\.weight twice"),
        ("dinov2", with_(aggregator__fc__bias=torch.ones(9)), r"aggregator\.fc\.bias real \(9,\), wanted real \(5,\)"),
        ("dinov2", with_(aggregator__fc__weight=torch.ones(9)), r"fc\.weight has the shape \(9,\); wanted 2 axes"),
        ("dinov2", with_(aggregator__fc__weight=torch.ones(5, 13)), r"aggregator\.fc\.weight real \(5, 13\), wanted"),
        ("dinov2", with_(aggregator__proj_c__weight=torch.ones(96, 64, 3, 3)), r"makes 96 dimensions; wanted a mult"),
        ("dinov2", with_(aggregator__boqs__2__norm_q__weight=torch.ones(DIM)), r"missing .*boqs\.2\.queries"),
    ],
)
def test_a_file_that_differs_is_refused_by_the_name_of_the_tensor(
    kind: str, change: Change, message: str, checkpoints: dict, tmp_path: Path
) -> None:
    path = changed(tmp_path, checkpoints[kind], change)
    with pytest.raises(BadInput, match=message) as caught:
        method(kind, path).encode(Images.from_arrays(images()))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_the_file_of_the_other_backbone_is_refused_in_one_line(kind: str, files: dict) -> None:
    other = next(other for other in KINDS if other != kind)
    with pytest.raises(BadInput, match=re.escape(str(files[other]))) as caught:
        method(kind, files[other]).encode(Images.from_arrays(images()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_the_file_of_another_method_is_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "other.pth"
    torch.save({"backbone.0.weight": torch.ones(64, 3, 7, 7), "aggregation.1.p": torch.ones(1)}, path)
    with pytest.raises(BadInput, match=r"other\.pth holds no aggregator\.proj_c\.weight \(it holds backbone\.0\.wei"):
        method(kind, path).encode(Images.from_arrays(images()))


def test_a_side_that_dinov2_cannot_cut_into_patches_is_refused(files: dict) -> None:
    with pytest.raises(BadInput, match=r"method\.height=40: give a multiple of 14"):
        method("dinov2", files["dinov2"], height=40).encode(Images.from_arrays(images()))


@pytest.mark.parametrize(("kind", "n_dimensions"), [("dinov2", 12288), ("resnet50", 16384)])
def test_a_blank_network_has_the_published_sizes(kind: str, n_dimensions: int) -> None:
    boq = method(kind, Path("none.pth"))
    published = {field.name: field.default for field in fields(boq)}
    with torch.device("meta"):
        network = boq.blank()
        assert network(torch.empty(2, 3, published["height"], published["width"])).shape == (2, n_dimensions)
    shapes = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    dim = n_dimensions // 32
    assert shapes["aggregator.boqs.1.queries"] == (1, 64, dim)
    assert shapes["aggregator.boqs.0.encoder.linear1.weight"] == (4 * dim, dim)
    assert shapes["aggregator.fc.weight"] == (32, 128)
    assert shapes["aggregator.proj_c.weight"] == (dim, {"dinov2": 768, "resnet50": 1024}[kind], 3, 3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_blank_network_has_the_names_of_the_published_file(kind: str, checkpoints: dict) -> None:
    with torch.device("meta"):
        names = set(method(kind, Path("none.pth")).blank().state_dict())
    more = {name for name in names if re.match(r"backbone\.dino\.blocks\.([2-9]|1\d)\.", name)}
    optional = {f"backbone.dino.{name}" for name in ("norm.weight", "norm.bias", "mask_token")}
    assert names - more == set(checkpoints[kind]) - optional


@pytest.mark.parametrize("kind", KINDS)
def test_it_keeps_the_rules_of_the_contract(kind: str, files: dict) -> None:
    name = CLASSES[kind].__name__
    weights = {"file": "x.pth", "licence": "none", "trained_on": "nothing", "path": str(files[kind])}
    side = {"dinov2": 28, "resnet50": 32}[kind]
    config = {"_target_": f"vprbench.methods.boq.{name}", "weights": weights, "height": side, "width": side}
    assert [str(result) for result in conformance.check(config) if result.state == "broken"] == []
