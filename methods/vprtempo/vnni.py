"""An 8-bit layer asked with one input, by AVX-512 VNNI: oneDNN wakes all threads for it, and takes longer for that."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic

from vprbench.api import compiled

_LANES = 16  # int32 in a register, each the sum of 4 products
_WIDTH = 4 * _LANES  # levels in a register
_ROWS = 8  # neurons whose sums are in registers
_INT64 = ir.IntType(64)
_VECTOR = ir.VectorType(ir.IntType(32), _LANES)
_FUNCTION = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
#: The sums, uint8 levels, int8 steps -> the sums with their products. The intrinsic's types differ between LLVMs.
_ADD_PRODUCTS = ir.InlineAsm(_FUNCTION, "vpdpbusd $3, $2, $0", "=v,0,v,v")

_FEATURES: str = get_host_cpu_features()  # type: ignore[no-untyped-call]
#: Whether this processor has the instruction, and numba compiles for this processor.
AVAILABLE = "+avx512vnni" in _FEATURES and (config.CPU_NAME, config.CPU_FEATURES) == (None, None)  # type: ignore[attr-defined]

Floats = npt.NDArray[np.float32]


def single_input_map(
    steps: npt.NDArray[np.int8], factor: Floats, bias: Floats
) -> Callable[[npt.NDArray[np.uint8]], Floats]:
    """Return the map of levels (n_in,) to levels @ `steps`.T (n_out, n_in), times `factor`, plus `bias` (n_out,).

    The sums are exact. Only where `AVAILABLE`.
    """
    n_out, n_in = steps.shape
    padded = np.pad(steps, ((0, -n_out % _ROWS), (0, -n_in % _WIDTH)))
    in_reading_order = padded.reshape(-1, _ROWS, padded.shape[1] // _WIDTH, _WIDTH).swapaxes(1, 2).copy()

    def net_input(levels: npt.NDArray[np.uint8]) -> Floats:
        own, net = np.zeros(padded.shape[1], np.uint8), np.empty(n_out, np.float32)
        own[:n_in] = levels
        _write_net_input(own, in_reading_order, factor, bias, net)
        return net

    return net_input


@intrinsic
def _sum_products(typing_context, levels, steps, sums):  # type: ignore[no-untyped-def]
    """Write products of levels (n,) and steps (n / _WIDTH, _ROWS, _WIDTH), summed in lanes, to `sums` (_ROWS, _LANES).

    Spelt out in vectors: from a loop over numbers LLVM makes code that takes three times as long.
    """
    del typing_context

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        arrays = zip(signature.args, arguments, strict=True)
        ours, theirs, out = (context.make_array(kind)(context, builder, value) for kind, value in arrays)
        level, step, total = (builder.bitcast(each.data, _VECTOR.as_pointer()) for each in (ours, theirs, out))
        length = builder.udiv(builder.extract_value(ours.shape, 0), _INT64(_WIDTH))
        zeros = _VECTOR([0] * _LANES)
        added = [cgutils.alloca_once_value(builder, zeros) for _ in range(_ROWS)]  # type: ignore[no-untyped-call]
        with cgutils.for_range(builder, length) as place:
            own = builder.load(builder.gep(level, [place.index]), align=1)
            for row, so_far in enumerate(added):
                at = builder.add(builder.mul(place.index, _INT64(_ROWS)), _INT64(row))
                weights = builder.load(builder.gep(step, [at]), align=1)
                builder.store(builder.call(_ADD_PRODUCTS, [builder.load(so_far), own, weights]), so_far)
        for row, so_far in enumerate(added):
            builder.store(builder.load(so_far), builder.gep(total, [_INT64(row)]), align=4)
        return context.get_dummy_value()  # what numba takes for None

    return types.void(levels, steps, sums), generate


@compiled()  # with two roundings, as oneDNN has
def _write_net_input(levels, steps, factor, bias, net):  # type: ignore[no-untyped-def]
    """Write the net input and the bias of neurons, (n_out,); levels and steps are padded by zeros."""
    sums = np.empty((_ROWS, _LANES), np.int32)
    for block in range(len(steps)):
        _sum_products(levels, steps[block], sums)  # type: ignore[call-arg]
        for row in range(min(_ROWS, len(net) - block * _ROWS)):
            neuron = block * _ROWS + row
            net[neuron] = np.float32(sums[row].sum()) * factor[neuron] + bias[neuron]


if AVAILABLE:  # compiled now, or read from the cache: no query waits for it
    binding.initialize_native_asmparser()
    _one = np.zeros(1, np.float32)
    single_input_map(np.zeros((1, 1), np.int8), _one, _one)(np.zeros(1, np.uint8))
