"""Backbones computed slowly, in float64, straight from the tensors of a checkpoint by their published names."""

import math

import numpy as np
import torch
from torch.nn import functional


class Draw:
    """Random values of the parts of networks, under their names, so large that every part matters."""

    def __init__(self, seed=0):
        self.generator = torch.Generator().manual_seed(seed)

    def normal(self, *shape, scale=1.0, mean=0.0):
        return mean + scale * torch.randn(shape, generator=self.generator)

    def linear(self, name, n_in, n_out):
        weight = self.normal(n_out, n_in, scale=n_in**-0.5)
        return {f"{name}.weight": weight, f"{name}.bias": self.normal(n_out, scale=0.3)}

    def attention(self, name, dim):
        return {
            f"{name}.in_proj_weight": self.normal(3 * dim, dim, scale=2 * dim**-0.5),
            f"{name}.in_proj_bias": self.normal(3 * dim, scale=0.3),
            **self.linear(f"{name}.out_proj", dim, dim),
        }

    def norm(self, name, dim):
        return {f"{name}.weight": self.normal(dim, scale=0.25, mean=1), f"{name}.bias": self.normal(dim, scale=0.25)}


def under(tensors, prefix):
    """The tensors under a prefix, in float64."""
    return {name.removeprefix(prefix): value.double() for name, value in tensors.items() if name.startswith(prefix)}


def prefixed(prefix, tensors):
    return {f"{prefix}{name}": tensor for name, tensor in tensors.items()}


def gem(x, p, axes=(2, 3)):
    """The generalised mean of Radenovic et al. 2019 over some axes."""
    return x.clamp(min=1e-6).pow(float(p)).mean(axes).pow(1 / float(p))


def linear(t, name, x):
    return functional.linear(x, t[f"{name}.weight"].flatten(1), t[f"{name}.bias"])


def imagenet(*images):
    """What networks see of images (height, width, 3) of one size, (n, 3, height, width): ImageNet's normalisation."""
    levels = torch.from_numpy(np.stack(images)).double().permute(0, 3, 1, 2) / 255
    mean, deviation = (torch.tensor(v).double()[:, None, None] for v in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
    return (levels - mean) / deviation


def vit_tokens(tensors, prefix, x, n_blocks=None, final_norm=True, beside_mlp=lambda block, tokens: 0.0):
    """Tokens of DINOv2, CLS first, (n, 1 + rows * columns, dim), after `n_blocks` blocks (None: all of the file).

    What `beside_mlp` makes of a block's tensors and of its MLP's input is added to the MLP's output.
    """
    t = under(tensors, prefix)
    patches = functional.conv2d(x.double(), t["patch_embed.proj.weight"], t["patch_embed.proj.bias"], stride=14)
    n, dim, rows, columns = patches.shape
    tokens = torch.cat([t["cls_token"].expand(n, 1, dim), patches.flatten(2).transpose(1, 2)], dim=1)
    tokens = tokens + _positions(t["pos_embed"], rows, columns)
    depth = 1 + max(int(name.split(".")[1]) for name in t if name.startswith("blocks."))
    for number in range(depth if n_blocks is None else n_blocks):
        b = under(t, f"blocks.{number}.")
        q, k, v = vit_qkv(tensors, prefix, tokens, number)
        mixed = functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
        tokens = tokens + b["ls1.gamma"] * linear(b, "attn.proj", mixed)
        inner = layer_norm(tokens, b["norm2.weight"], b["norm2.bias"])
        tokens = tokens + b["ls2.gamma"] * (_mlp(b, inner) + beside_mlp(b, inner))
    return layer_norm(tokens, t["norm.weight"], t["norm.bias"]) if final_norm else tokens


def vit_qkv(tensors, prefix, tokens, block):
    """Queries, keys and values of a block for the tokens that enter it, each (n, heads, n_tokens, 64)."""
    t = under(tensors, f"{prefix}blocks.{block}.")
    inner = layer_norm(tokens, t["norm1.weight"], t["norm1.bias"])
    qkv = linear(t, "attn.qkv", inner).chunk(3, dim=2)
    return tuple(part.unflatten(2, (-1, 64)).transpose(1, 2) for part in qkv)


def layer_norm(x, weight, bias, eps=1e-6):
    return functional.layer_norm(x, x.shape[-1:], weight.double(), bias.double(), eps)


def attention(t, at, asking, asked, heads):
    """What (n_asking, dim) take from (n_asked, dim), by the names of `torch.nn.MultiheadAttention`."""
    weights, biases = t[f"{at}.in_proj_weight"].chunk(3), t[f"{at}.in_proj_bias"].chunk(3)
    parts = zip((asking, asked, asked), weights, biases, strict=True)
    q, k, v = (functional.linear(*part).unflatten(1, (heads, -1)).transpose(0, 1) for part in parts)
    return linear(t, f"{at}.out_proj", functional.scaled_dot_product_attention(q, k, v).transpose(0, 1).flatten(1))


def _mlp(b, x):
    if "mlp.w12.weight" in b:
        gate, value = linear(b, "mlp.w12", x).chunk(2, dim=2)
        return linear(b, "mlp.w3", functional.silu(gate) * value)
    return linear(b, "mlp.fc2", functional.gelu(linear(b, "mlp.fc1", x)))


def _positions(pos_embed, rows, columns):
    """Position embeddings of another grid: bicubic, scale (rows + 0.1) / side, as DINOv2 does it; own grid: as is."""
    side = math.isqrt(pos_embed.shape[1] - 1)
    if rows == columns == side:
        return pos_embed
    grid = pos_embed[:, 1:].transpose(1, 2).unflatten(2, (side, side))
    scale = ((rows + 0.1) / side, (columns + 0.1) / side)
    grid = functional.interpolate(grid, scale_factor=scale, mode="bicubic", antialias=False)
    return torch.cat([pos_embed[:, :1], grid.flatten(2).transpose(1, 2)], dim=1)


def vit_checkpoint(draw, dim=128, depth=2, side=5, swiglu=False):
    """Random values under DINOv2's names, with a mask token, which has no use."""
    tensors = {
        "cls_token": draw.normal(1, 1, dim),
        "pos_embed": draw.normal(1, side * side + 1, dim),
        "mask_token": draw.normal(1, dim),
        "patch_embed.proj.weight": draw.normal(dim, 3, 14, 14, scale=588**-0.5),
        "patch_embed.proj.bias": draw.normal(dim, scale=0.3),
        **draw.norm("norm", dim),
    }
    hidden = dim * 8 // 3 // 8 * 8 if swiglu else 4 * dim
    first, last = ("mlp.w12", "mlp.w3") if swiglu else ("mlp.fc1", "mlp.fc2")
    for number in range(depth):
        block = draw.norm("norm1", dim) | draw.norm("norm2", dim)
        block |= draw.linear("attn.qkv", dim, 3 * dim) | draw.linear("attn.proj", dim, dim)
        block |= draw.linear(first, dim, hidden * (2 if swiglu else 1)) | draw.linear(last, hidden, dim)
        block |= {f"{name}.gamma": draw.normal(dim, scale=0.2, mean=0.7) for name in ("ls1", "ls2")}
        tensors |= prefixed(f"blocks.{number}.", block)
    return tensors


def salad(tensors, prefix, tokens):
    """SALAD's descriptor of one image's tokens (1 + n_patches, dim), CLS first: of the token, then l * clusters + k."""
    t = under(tensors, prefix)

    def network(name, second, x):
        return linear(t, f"{name}.{second}", linear(t, f"{name}.0", x).clamp(min=0))

    token = network("token_features", 2, tokens[0])
    features = network("cluster_features", 3, tokens[1:]).T  # (l, n)
    scores = network("score", 3, tokens[1:]).T  # (k, n)
    clusters, n = scores.shape
    kernel = torch.exp(torch.cat([scores, t["dust_bin"].expand(1, n)]))
    patch = 1 / (n + clusters)
    rows = torch.tensor([patch] * clusters + [patch * (n - clusters)]).double()
    v = torch.ones(n).double()
    for _ in range(3):
        u = rows / (kernel @ v)
        v = patch / (u @ kernel)
    assigned = (u[:, None] * kernel * v / patch)[:clusters]
    gathered = functional.normalize(features @ assigned.T, dim=0)  # (l, k)
    return functional.normalize(torch.cat([functional.normalize(token, dim=0), gathered.flatten()]), dim=0)


def salad_checkpoint(draw, clusters, cluster_dim, token_dim, dim=128, hidden=32):
    """Random values under the names of SALAD's aggregator; scores so far apart that Sinkhorn is not done after 3."""
    tensors = {"dust_bin": torch.tensor(1.5)}
    for name, n_out in {"token_features": token_dim, "cluster_features": cluster_dim, "score": clusters}.items():
        second, sides = (2, ()) if name == "token_features" else (3, (1, 1))
        gain = 3 if name == "score" else 1
        for number, n_to, n_from, scale in (
            (0, hidden, dim, (2 / dim) ** 0.5),
            (second, n_out, hidden, gain / hidden**0.5),
        ):
            tensors[f"{name}.{number}.weight"] = draw.normal(n_to, n_from, *sides, scale=scale)
            tensors[f"{name}.{number}.bias"] = draw.normal(n_to, scale=0.3)
    return tensors


#: By the number of the layer: channels.
VGG16_CONVOLUTIONS = {0: 64, 2: 64, 5: 128, 7: 128} | dict.fromkeys((10, 12, 14), 256)
VGG16_CONVOLUTIONS |= dict.fromkeys((17, 19, 21, 24, 26, 28), 512)
VGG16_POOLS = (4, 9, 16, 23, 30)


def vgg16(tensors, prefix, x, last=30):
    """VGG16's features up to layer `last` with it: 28 is conv5_3 before its ReLU, 30 the last pool."""
    t, x = under(tensors, prefix), x.double()
    for number in range(last + 1):
        if number in VGG16_CONVOLUTIONS:
            x = functional.conv2d(x, t[f"{number}.weight"], t[f"{number}.bias"], padding=1)
        else:
            x = functional.max_pool2d(x, 2) if number in VGG16_POOLS else x.clamp(min=0)
    return x


def residuals(features, assignment, centroids):
    """NetVLAD's residuals of features (channels, h, w) to centroids, by their shares, (h * w, clusters, channels)."""
    local = functional.normalize(features.flatten(1), dim=0).T
    shares = torch.softmax(local @ assignment.double().flatten(1).T, dim=1)
    return shares[:, :, None] * (local[:, None] - centroids.double())


def vlad(sums, projection=None, bias=None, fastest="channel"):
    """The unit vector of sums of residuals (clusters, channels), whitened if there is a projection."""
    columns = functional.normalize(sums, dim=1)
    vector = functional.normalize((columns.T if fastest == "cluster" else columns).flatten(), dim=0)
    if projection is None:
        return vector
    return functional.normalize(projection.double().flatten(1) @ vector + bias.double(), dim=0)


def vgg16_checkpoint(draw, prefix=""):
    """Random values under VGG16's names, under which activations stay near 1."""
    tensors, n_in = {}, 3
    for number, n_out in VGG16_CONVOLUTIONS.items():
        tensors[f"{number}.weight"] = draw.normal(n_out, n_in, 3, 3, scale=math.sqrt(2 / (9 * n_in)))
        tensors[f"{number}.bias"] = draw.normal(n_out, scale=0.2)
        n_in = n_out
    return prefixed(prefix, tensors)


def netvlad_checkpoint(draw, clusters, components=None):
    """Random values of VGG16 and NetVLAD under the names of QVPR/Patch-NetVLAD; no whitening without `components`."""
    tensors = vgg16_checkpoint(draw, "encoder.")
    tensors["pool.centroids"] = draw.normal(clusters, 512, scale=512**-0.5)
    tensors["pool.conv.weight"] = draw.normal(clusters, 512, 1, 1, scale=4)
    if components is not None:
        tensors["WPCA.0.weight"] = draw.normal(components, clusters * 512, 1, 1).double()
        tensors["WPCA.0.bias"] = draw.normal(components, scale=0.5).double()
    return tensors


RESNETS = {  # blocks of each stage, groups, channels of a group in the first stage
    "resnet18": ((2, 2, 2, 2), 1, 64),
    "resnet50": ((3, 4, 6, 3), 1, 64),
    "resnet101": ((3, 4, 23, 3), 1, 64),
    "resnet152": ((3, 8, 36, 3), 1, 64),
    "resnext101_32x8d": ((3, 4, 23, 3), 32, 8),
}


def resnet(tensors, prefix, x):
    """A ResNet's last stage of the file; layers are named 0, 1, 4 to 7, or conv1, bn1, layer1 to 4."""
    t = under(tensors, prefix)
    stem, norm, *stages = _resnet_names("0.weight" in t)
    x = functional.conv2d(x.double(), t[f"{stem}.weight"], stride=2, padding=3)
    x = functional.max_pool2d(_batch_norm(t, norm, x).clamp(min=0), 3, stride=2, padding=1)
    blocks = {tuple(name.split(".")[:2]) for name in t if name.split(".")[0] in stages}
    for stage, block in sorted(blocks, key=lambda at: (at[0], int(at[1]))):
        x = _resnet_block(t, f"{stage}.{block}", x, stride=2 if stage != stages[0] and block == "0" else 1)
    return x


def resnet_checkpoint(draw, kind, prefix="", n_stages=4, numbered=True):
    """Random values under a ResNet's names, batch norms that do something, activations near 1."""
    blocks, groups, width = RESNETS[kind]
    basic = kind == "resnet18"
    stem, norm, *stages = _resnet_names(numbered)
    tensors = _convolution(draw, stem, norm, 3, 64, 7)
    n_in = 64
    for stage in range(n_stages):
        inner = groups * width * 2**stage
        n_out = inner if basic else 256 * 2**stage
        for block in range(blocks[stage]):
            at = f"{stages[stage]}.{block}"
            sides = [(n_in, inner, 1, 1), (inner, inner, 3, groups), (inner, n_out, 1, 1)]
            sides = [(n_in, inner, 3, 1), (inner, n_out, 3, 1)] if basic else sides
            for number, size in enumerate(sides, 1):
                scale = 0.4 if number == len(sides) else 1.0
                tensors |= _convolution(draw, f"{at}.conv{number}", f"{at}.bn{number}", *size, scale)
            if block == 0 and (stage or n_in != n_out):
                tensors |= _convolution(draw, f"{at}.downsample.0", f"{at}.downsample.1", n_in, n_out, 1, scale=0.7)
            n_in = n_out
    return prefixed(prefix, tensors)


def _resnet_names(numbered):
    return ("0", "1", "4", "5", "6", "7") if numbered else ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")


def _resnet_block(t, at, x, stride):
    """Two 3x3 convolutions, the first with the stride; or 1x1, 3x3 with the stride, 1x1; and the shortcut."""
    way, last = x, 3 if f"{at}.conv3.weight" in t else 2
    for number in range(1, last + 1):
        weight = t[f"{at}.conv{number}.weight"]
        step, side = stride if number == last - 1 else 1, weight.shape[-1]
        way = functional.conv2d(way, weight, None, step, side // 2, groups=way.shape[1] // weight.shape[1])
        way = _batch_norm(t, f"{at}.bn{number}", way)
        way = way if number == last else way.clamp(min=0)
    if f"{at}.downsample.0.weight" in t:
        x = _batch_norm(t, f"{at}.downsample.1", functional.conv2d(x, t[f"{at}.downsample.0.weight"], stride=stride))
    return (way + x).clamp(min=0)


def _batch_norm(t, at, x):
    return functional.batch_norm(x, *(t[f"{at}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")))


def _convolution(draw, at, norm, n_in, n_out, side, groups=1, scale=1.0):
    """A convolution that doubles what it gets, and the batch norm behind it, which halves it again."""
    shape = (n_out, n_in // groups, side, side)
    return {
        f"{at}.weight": draw.normal(*shape, scale=2 / math.sqrt(n_in // groups * side**2)),
        f"{norm}.weight": scale * draw.normal(n_out, scale=0.2, mean=1),
        f"{norm}.bias": draw.normal(n_out, scale=0.2),
        f"{norm}.running_mean": draw.normal(n_out, scale=0.5),
        f"{norm}.running_var": 2 + torch.rand(n_out, generator=draw.generator),
        f"{norm}.num_batches_tracked": torch.tensor(7),
    }
