"""Datasets whose options are the fields of a frozen dataclass, called as functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, Protocol, get_type_hints

from vprbench.api import Dataset

Options = ParamSpec("Options")


class Recipe(Protocol):
    """The options of a dataset."""

    def build(self) -> Dataset:
        """Return the dataset of these options."""


def function_of(kind: Callable[Options, Recipe]) -> Callable[Options, Dataset]:
    """Return the function that builds a dataset, whose parameters and docstring are those of the dataclass `kind`."""

    @wraps(kind, updated=())
    def build(*options: Options.args, **named: Options.kwargs) -> Dataset:
        return kind(*options, **named).build()

    build.__annotations__ = get_type_hints(kind)
    return build
