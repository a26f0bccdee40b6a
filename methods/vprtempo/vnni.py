"""A layer in 8 bits by AVX-512 VNNI, in the thread that asks: oneDNN wakes all threads, which then spin for a while."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic

from vprbench.api import compiled

_LANES = 16  # neurons of a register, each with 4 bytes
_REGISTERS = 4  # of neurons, whose sums stay in registers
_NEURONS = _REGISTERS * _LANES
_TOGETHER = 4  # queries that share a read of the steps
_INT32, _INT64 = ir.IntType(32), ir.IntType(64)
_VECTOR = ir.VectorType(_INT32, _LANES)
_FUNCTION = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
#: The sums, uint8 levels, int8 steps -> the sums with their products. The intrinsic's types differ between LLVMs.
_ADD_PRODUCTS = ir.InlineAsm(_FUNCTION, "vpdpbusd $3, $2, $0", "=v,0,v,v")

_FEATURES: str = get_host_cpu_features()  # type: ignore[no-untyped-call]
#: Whether this processor has the instruction, and numba compiles for this processor.
AVAILABLE = "+avx512vnni" in _FEATURES and (config.CPU_NAME, config.CPU_FEATURES) == (None, None)  # type: ignore[attr-defined]

Floats = npt.NDArray[np.float32]
Levels = npt.NDArray[np.uint8]  # (n_queries, n_in)


def make_affine_map(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats) -> Callable[[Levels, Floats], None]:
    """Return a function that writes levels (n, n_in) @ `steps`.T, times `factor`, plus `bias` (n_out,).

    It writes to an array (n, n_out). `steps` are (n_out, n_in), and the sums are exact. Only where `AVAILABLE`.
    """
    n_out, n_in = steps.shape
    padded = np.pad(steps, ((0, -n_out % _NEURONS), (0, -n_in % 4)))
    in_reading_order = padded.reshape(-1, _NEURONS, padded.shape[1] // 4, 4).swapaxes(1, 2).copy()

    def write(levels: Levels, net: Floats) -> None:
        own = np.ascontiguousarray(np.pad(levels, ((0, 0), (0, -n_in % 4))) if n_in % 4 else levels)
        _write_net_input(own, in_reading_order, factor, bias, net)

    return write


def _make_sum_products(n_queries: int) -> Any:
    """Return a function for numba's code that sums the products of so many queries."""

    @intrinsic
    def sum_products(typing_context, levels, steps, sums):  # type: ignore[no-untyped-def]
        """Write levels (n_queries, n) @ steps (n / 4, _NEURONS, 4), summed over n, to `sums` (n_queries, _NEURONS).

        Spelt out in vectors: from a loop over numbers LLVM makes code that takes three times as long.
        """
        del typing_context

        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            arrays = zip(signature.args, arguments, strict=True)
            ours, theirs, out = (context.make_array(kind)(context, builder, value) for kind, value in arrays)
            fours = builder.bitcast(ours.data, _INT32.as_pointer())
            step, total = (builder.bitcast(each.data, _VECTOR.as_pointer()) for each in (theirs, out))
            length = builder.extract_value(theirs.shape, 0)
            added = [[_make_variable(builder) for _ in range(_REGISTERS)] for _ in range(n_queries)]
            with cgutils.for_range(builder, length) as place:
                start = builder.mul(place.index, _INT64(_REGISTERS))
                weights = [
                    builder.load(builder.gep(step, [builder.add(start, _INT64(k))]), align=1) for k in range(_REGISTERS)
                ]
                for query, sums_of_query in enumerate(added):
                    at = builder.add(builder.mul(_INT64(query), length), place.index)
                    four = _broadcast(builder, builder.load(builder.gep(fours, [at]), align=1))
                    for so_far, own in zip(sums_of_query, weights, strict=True):
                        builder.store(builder.call(_ADD_PRODUCTS, [builder.load(so_far), four, own]), so_far)
            for number, so_far in enumerate(chain(*added)):
                builder.store(builder.load(so_far), builder.gep(total, [_INT64(number)]), align=4)
            return context.get_dummy_value()  # what numba takes for None

        return types.void(levels, steps, sums), generate

    return sum_products


def _make_variable(builder: ir.IRBuilder) -> ir.Value:
    """Make room for a vector of zeros; LLVM turns it into a register."""
    return cgutils.alloca_once_value(builder, _VECTOR([0] * _LANES))  # type: ignore[no-untyped-call]


def _broadcast(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    nothing = _VECTOR(ir.Undefined)
    one = builder.insert_element(nothing, number, _INT64(0))
    return builder.shuffle_vector(one, nothing, _VECTOR([0] * _LANES))


_sum_products_of_one, _sum_products_of_several = _make_sum_products(1), _make_sum_products(_TOGETHER)


@compiled()  # with two roundings, as oneDNN has
def _write_net_input(levels, steps, factor, bias, net):  # type: ignore[no-untyped-def]
    """Write the net input and the bias of neurons, (n_queries, n_out); levels and steps are padded by zeros."""
    sums = np.empty((_TOGETHER, _NEURONS), np.int32)
    for block in range(len(steps)):
        first = block * _NEURONS
        query = 0
        while query < len(levels):
            several = query + _TOGETHER <= len(levels)
            if several:
                _sum_products_of_several(levels[query : query + _TOGETHER], steps[block], sums)
            else:
                _sum_products_of_one(levels[query : query + 1], steps[block], sums)
            for number in range(_TOGETHER if several else 1):
                own, written = sums[number], net[query + number]
                for neuron in range(first, min(first + _NEURONS, len(bias))):
                    written[neuron] = np.float32(own[neuron - first]) * factor[neuron] + bias[neuron]
            query += _TOGETHER if several else 1


if AVAILABLE:  # compiled now, or read from the cache: no query waits for it
    binding.initialize_native_asmparser()
    _one = np.ones(1, np.float32)
    for _net in np.zeros((1, 1), np.float32), np.zeros((1, 2), np.float32)[:, :1]:
        make_affine_map(np.zeros((1, 4), np.int8), _one, _one)(np.zeros((1, 4), np.uint8), _net)
