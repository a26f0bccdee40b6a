"""The method and the dataset of a run: registered ones by name, with options, or objects of a program."""

from __future__ import annotations

import copy
import hashlib
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from pydantic_core import PydanticSerializationError, to_jsonable_python

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.plugins import loose, registry
from vprbench.plugins.entries import Group
from vprbench.report.plan import flatten_arguments
from vprbench.runs.identity import hash_class
from vprbench.runs.request import RunRequest
from vprbench.text import shorten

_MOST_NUMBERS = 1 << 16  # of an array that a record holds; of a larger one it holds the hash
_LONGEST = 60  # letters of an argument in the name of a row


@dataclass(frozen=True)
class Choice:
    """The parts of a request that a method or a dataset of a program decides."""

    overrides: tuple[str, ...]  # name and options as on the command line
    described: Mapping[str, Any] = field(default_factory=dict)  # fields of the request, for what is not registered
    values: Mapping[str, Any] = field(default_factory=dict)  # options by the names that a request has for them
    make: Callable[[Mapping[str, Any]], Method] | None = None  # a method of the same class and arguments
    unstored_reason: str | None = None  # why it cannot be told from others, so that its runs are not stored


@dataclass(frozen=True, repr=False)
class _Named:
    """A registered method or dataset with options of its own; raises BadInput, with near names, for unknown ones."""

    group: ClassVar[Group]
    name: str
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Register a loose file, and check name and options."""
        object.__setattr__(self, "name", loose.resolve_name(self.group, self.name))
        self.resolve()

    def resolve(self, **per_run: Any) -> RunRequest:
        """Return a request with this method or dataset; raises BadInput for options that do not fit."""
        choice = self.choose()
        return make_request(choice.overrides[:1], {**choice.values, **per_run})

    def choose(self) -> Choice:
        """Return the parts of a request that it decides."""
        values = flatten_arguments(as_plain(self.options), f"{self.group}.")
        given = (f"{name}={_write_option(value)}" for name, value in values.items())
        return Choice((f"{self.group}={self.name}", *given), values=values)

    def __repr__(self) -> str:
        given = ", ".join([repr(self.name), *(f"{name}={value!r}" for name, value in self.options.items())])
        return shorten(f"{self.group}({given})")


class NamedMethod(_Named):
    """A registered method and options of its own; it is built when it runs."""

    group = "method"

    def build(self, seed: int = 0, device: str = "cpu") -> Method:
        """Return a new method, which is not fitted; raises BadInput for options that do not fit."""
        return registry.make_method(self.resolve(seed=seed, device=device).method)


class NamedDataset(_Named):
    """A registered dataset and options of its own; it is built when a method runs on it."""

    group = "dataset"

    def build(self) -> Dataset:
        """Return the dataset; raises BadInput for options that do not fit, MissingData where its frames are missing."""
        return registry.make_dataset(self.resolve().dataset)


AnyMethod = str | NamedMethod | Method | type[Method]
AnyDataset = str | NamedDataset | Dataset


def method(name: str, /, **options: Any) -> NamedMethod:
    """Return a registered method, or one in a file, with options of its own: `method("vprtempo", max_module=50)`.

    Raises BadInput, with the near names, for an unknown method or option.
    """
    return NamedMethod(name, options)


def dataset(name: str, /, **options: Any) -> NamedDataset:
    """Return a registered dataset, or one in a file, with options of its own: `dataset("synthetic", places=100)`.

    Raises BadInput, with the near names, for an unknown dataset or option.
    """
    return NamedDataset(name, options)


def choose_dataset(chosen: AnyDataset) -> tuple[Choice, Dataset]:
    """Build a dataset; raises what its builder raises, BadInput for any other object."""
    chosen = dataset(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedDataset):
        return chosen.choose(), chosen.build()
    if isinstance(chosen, Dataset):
        described = {"dataset_name": chosen.name, "dataset": {"name": chosen.name}}
        return Choice((f"dataset={chosen.name}",), described), chosen
    raise BadInput(
        f"a dataset of type {type(chosen).__name__} came; wanted a name, vprbench.dataset(...) or a Dataset, as "
        "vprbench.dataset_of(...) makes one of images"
    )


def choose_method(chosen: AnyMethod, per_run: Mapping[str, Any]) -> Choice:
    """Return the parts of a request; an object keeps a seed and a device that `per_run` does not have.

    Raises BadInput for any other object.
    """
    chosen = method(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedMethod):
        return chosen.choose()
    if isinstance(chosen, type) and issubclass(chosen, Method):
        chosen = chosen()
    if isinstance(chosen, Method):
        return _describe_object(chosen, {name: per_run.get(name) for name in ("seed", "device")})
    raise BadInput(
        f"a method of type {type(chosen).__name__} came; wanted a name, vprbench.method(...) or an object whose "
        "class subclasses vprbench.api.Method"
    )


def _describe_object(given: Method, per_run: Mapping[str, Any]) -> Choice:
    """Return the choice of methods of the class and arguments of an object, which is never fitted itself."""
    kind = type(given)
    arguments, reason = _read_arguments(given)
    arguments |= {name: value for name, value in per_run.items() if name in arguments and value is not None}
    recorded: dict[str, Any] = {}
    for name, value in arguments.items():
        try:
            recorded[name] = as_plain(value)
        except ValueError as error:
            reason = f"its argument {name} cannot be recorded, for a {error}"
    try:
        hash_class(kind)
    except OSError as error:
        reason = str(error)
    defaults = {name: one.default for name, one in inspect.signature(kind).parameters.items()}
    changed = {
        name: value
        for name, value in recorded.items()
        if name not in per_run and not _equals_default(value, defaults.get(name))
    }
    config = {"_target_": f"{kind.__module__}.{kind.__qualname__}", **recorded}
    return Choice(
        (f"method={kind.__name__}", *(f"method.{name}={_abbreviate(value)}" for name, value in changed.items())),
        {"method_name": kind.__name__, "method": config, "changed": changed, "tuned_on": {}},
        {name: recorded[name] for name in per_run if name in recorded},
        lambda _: kind(**arguments) if arguments else copy.deepcopy(given),
        reason,
    )


def _read_arguments(given: Method) -> tuple[dict[str, Any], str | None]:
    """Return the attributes of an object that have the names of its arguments, and the reason if one is missing."""
    found: dict[str, Any] = {}
    for name in inspect.signature(type(given)).parameters:
        kept = next((one for one in (name, f"_{name}") if hasattr(given, one)), None)
        if kept is None:
            return {}, f"its argument {name} is not known: keep it as an attribute of that name, or use a dataclass"
        found[name] = getattr(given, kept)
    return found, None


def as_plain(value: Any) -> Any:
    """Return a value as plain ones that a record can hold; raises ValueError for an object without plain content."""
    try:
        return to_jsonable_python(value, fallback=_array_as_plain)
    except (PydanticSerializationError, UnicodeDecodeError) as error:
        raise ValueError(f"{type(value).__name__} has no plain content") from error


def _array_as_plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray) or value.dtype == object:
        raise ValueError(f"{type(value).__name__} has no plain content")
    if value.size <= _MOST_NUMBERS:
        return value.tolist()
    return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"


def _equals_default(recorded: Any, default: Any) -> bool:
    try:
        return bool(recorded == as_plain(default))
    except ValueError:
        return False


def _write_option(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _abbreviate(value: Any) -> str:
    """Return an argument of an object as text; of a long one, such as an array, the first digits of its hash."""
    text = _write_option(value)
    return text if len(text) <= _LONGEST else f"#{hashlib.sha256(text.encode()).hexdigest()[:8]}"
