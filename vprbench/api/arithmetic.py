"""Operations of a query: each computation counts its own by a formula, and `counting_operations` adds them up."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal, NamedTuple

Kind = Literal["float64", "float32", "int64", "int32", "int8"]


class Arithmetic(NamedTuple):
    """Multiply-adds, which are two operations each, and single operations: additions, comparisons, divisions, roots."""

    multiply_adds: float = 0.0
    single: float = 0.0
    kind: Kind = "float32"  # of the numbers

    @property
    def operations(self) -> float:
        """The operations of both kinds."""
        return 2 * self.multiply_adds + self.single


_tally: ContextVar[list[Arithmetic] | None] = ContextVar("arithmetic", default=None)


def count_operations(multiply_adds: float = 0.0, single: float = 0.0, kind: Kind = "float32") -> None:
    """Tell the arithmetic of this call, PyTorch's included; costs nothing outside of `counting_operations`."""
    tally = _tally.get()
    if tally is not None:
        tally.append(Arithmetic(multiply_adds, single, kind))


@contextmanager
def counting_operations() -> Iterator[list[Arithmetic]]:
    """Yield a list of what is told inside the block, by this thread."""
    tally = list[Arithmetic]()
    token = _tally.set(tally)
    try:
        yield tally
    finally:
        _tally.reset(token)
