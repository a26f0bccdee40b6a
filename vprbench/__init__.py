"""A benchmark for Visual Place Recognition: which method is better, how fast it is, and how sure that is.

import vprbench
result = vprbench.run("hog", vprbench.dataset("synthetic", places=100))
result.recall(1), result.interval(), result.failures()
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

TYPE_CHECKING = False
if TYPE_CHECKING:  # for type checkers alone, which know that name: `import vprbench` costs nothing
    from typing import Any

    from vprbench.interactive.choices import (
        NamedDataset as NamedDataset,
        NamedMethod as NamedMethod,
        dataset as dataset,
        method as method,
    )
    from vprbench.interactive.comparison import Comparison as Comparison, compare as compare
    from vprbench.interactive.images import dataset_of as dataset_of
    from vprbench.interactive.known import datasets as datasets, methods as methods, results as results
    from vprbench.interactive.result import Result as Result
    from vprbench.interactive.running import run as run

__version__ = "0.7.0"

_HOMES = {
    **dict.fromkeys(("NamedDataset", "NamedMethod", "dataset", "method"), "choices"),
    **dict.fromkeys(("Comparison", "compare"), "comparison"),
    "dataset_of": "images",
    **dict.fromkeys(("datasets", "methods", "results"), "known"),
    "Result": "result",
    "run": "running",
}
_ROOMS = ("compare", "datasets", "methods", "run")  # packages that have the name of a function
__all__ = [*_HOMES]

# In a bare checkout `methods/`, `datasets/` and `conf/` stand beside this package instead of inside it;
# a wheel maps them to vprbench.methods, vprbench.datasets and vprbench.conf.
_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file() and (_checkout / "conf").is_dir():
    __path__.append(str(_checkout))


class _Room(ModuleType):
    """A package that shares its name with a function: `vprbench.run` is both, and is called as the function."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        return _home(self.__name__)(*given, **named)

    @property
    def __doc__(self) -> str:  # type: ignore[override]  # of the function, for help()
        return str(_home(self.__name__).__doc__)

    @property
    def __signature__(self) -> Any:  # for an editor or a notebook
        from inspect import signature

        return signature(_home(self.__name__))


class _Face(ModuleType):
    """This package, whose rooms can be called where a function has their name, whoever imported them."""

    def __setattr__(self, name: str, value: object) -> None:
        if name in _ROOMS and isinstance(value, ModuleType):
            value.__class__ = _Room
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def _home(name: str) -> Any:
    name = name.rpartition(".")[2]
    return getattr(import_module(f"vprbench.interactive.{_HOMES[name]}"), name)


def __getattr__(name: str) -> Any:
    """Import the name that a program asks for; raises AttributeError, with the near names, for an unknown one."""
    if name in _ROOMS:
        return import_module(f"vprbench.{name}")
    if name in _HOMES:
        return _home(name)
    from vprbench.text import near

    raise AttributeError(f"vprbench has no {name}: {near(name, __all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
