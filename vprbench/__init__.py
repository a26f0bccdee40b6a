"""A benchmark for Visual Place Recognition: which method is better, how fast it is, and how sure that is.

import vprbench
result = vprbench.run("hog", vprbench.dataset("synthetic", places=100))
result.recall(1), result.interval(), result.failures()
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import lazy_loader

__version__ = "0.8.0"

# NumPy's threads sleep 2^16 clocks after a product, not 2^26: meanwhile they would keep the cores from PyTorch's.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "16")

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_ROOMS = ("datasets", "methods")  # packages that have the name of a function

# In a bare checkout `methods/`, `datasets/` and `conf/` stand beside this package instead of inside it;
# a wheel maps them to vprbench.methods, vprbench.datasets and vprbench.conf.
_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file() and (_checkout / "conf").is_dir():
    __path__.append(str(_checkout))


class _Room(ModuleType):
    """A package that shares its name with a function: `vprbench.methods` is both, and is called as the function."""

    def __call__(self) -> object:
        from vprbench.python import known

        return getattr(known, self.__name__.rpartition(".")[2])()


class _Face(ModuleType):
    """This package, whose rooms can be called where a function has their name, whoever imported them."""

    def __setattr__(self, name: str, value: object) -> None:
        if name in _ROOMS and isinstance(value, ModuleType):
            value.__class__ = _Room
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def __getattr__(name: str) -> object:
    return import_module(f"{__name__}.{name}") if name in _ROOMS else _attribute(name)
