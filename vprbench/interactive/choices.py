"""What a program chooses to run: registered methods and datasets by name, with options, or objects of its own."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import PydanticSerializationError, to_jsonable_python

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.interactive import short
from vprbench.plugins import registry
from vprbench.plugins.entries import Group, entries
from vprbench.runs.sources import hash_class
from vprbench.text import near


@dataclass(frozen=True, repr=False)
class NamedMethod:
    """A registered method and options of its own; it is built when it runs."""

    name: str
    options: Mapping[str, Any]

    def build(self, seed: int = 0, device: str = "cpu") -> Method:
        """Return a new method, which has learnt nothing; raises BadInput for options that do not fit."""
        values = {**self.values(), "seed": seed, "device": device}
        return registry.make_method(make_request([f"method={self.name}"], values).method)

    def values(self) -> dict[str, Any]:
        """Return its options by the names that a run has for them."""
        return _values("method", self.options)

    def __repr__(self) -> str:
        return _as_call("method", self.name, self.options)


@dataclass(frozen=True, repr=False)
class NamedDataset:
    """A registered dataset and options of its own; it is built when a method runs on it."""

    name: str
    options: Mapping[str, Any]

    def build(self) -> Dataset:
        """Return the dataset; raises BadInput for options that do not fit, NotThere where its frames are missing."""
        return registry.make_dataset(make_request([f"dataset={self.name}"], self.values()).dataset)

    def values(self) -> dict[str, Any]:
        """Return its options by the names that a run has for them."""
        return _values("dataset", self.options)

    def __repr__(self) -> str:
        return _as_call("dataset", self.name, self.options)


_MOST_NUMBERS = 1 << 16  # of an array that a record holds; of a larger one it holds the hash
AnyMethod = str | NamedMethod | Method | type[Method]
AnyDataset = str | NamedDataset | Dataset


def method(name: str, /, **options: Any) -> NamedMethod:
    """Return a registered method, or one in a file, with options of its own: `method("vprtempo", max_module=50)`.

    Raises BadInput, with the near names, for an unknown method or option.
    """
    return NamedMethod(_require_entry("method", name, options), options)


def dataset(name: str, /, **options: Any) -> NamedDataset:
    """Return a registered dataset, or one in a file, with options of its own: `dataset("synthetic", places=100)`.

    Raises BadInput, with the near names, for an unknown dataset or option.
    """
    return NamedDataset(_require_entry("dataset", name, options), options)


@dataclass(frozen=True)
class DatasetChoice:
    """A dataset that is built, and its parts of a request."""

    dataset: Dataset
    values: Mapping[str, Any]  # options by their dotted names
    overrides: tuple[str, ...]  # the same as on the command line
    described: Mapping[str, Any]  # fields of the request that describe an object

    @property
    def options(self) -> tuple[str, ...]:
        """The option that chooses a registered one."""
        return () if self.described else self.overrides[:1]


def choose_dataset(chosen: AnyDataset) -> DatasetChoice:
    """Build a dataset; raises what its builder raises, BadInput for any other object."""
    chosen = dataset(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedDataset):
        return DatasetChoice(chosen.build(), chosen.values(), _overrides("dataset", chosen), {})
    if not isinstance(chosen, Dataset):
        raise BadInput(
            f"a dataset of type {type(chosen).__name__} came; wanted a name, vprbench.dataset(...) or a Dataset, as "
            "vprbench.dataset_of(...) makes one of images"
        )
    described = {"dataset_name": chosen.name, "dataset": {"name": chosen.name}}
    return DatasetChoice(chosen, {}, (f"dataset={chosen.name}",), described)


@dataclass(frozen=True)
class MethodChoice:
    """A method, as its parts of a request and the function that makes it of the request's arguments."""

    name: str
    values: Mapping[str, Any]  # options by their dotted names; of an object its seed and device
    overrides: tuple[str, ...]  # the options as on the command line
    described: Mapping[str, Any]  # fields of the request that describe an object
    make: Callable[[Mapping[str, Any]], Method] | None = None  # of an object
    unstored_reason: str | None = None  # why its runs cannot be told apart from others, and so are not stored

    @property
    def options(self) -> tuple[str, ...]:
        """The option that chooses a registered one."""
        return () if self.described else self.overrides[:1]


def choose_method(chosen: AnyMethod, seed: int | None, device: str | None) -> MethodChoice:
    """Return the parts of a request; without seed and device those of an object, else 0 and the CPU.

    Raises BadInput for any other object.
    """
    chosen = method(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedMethod):
        values = {**chosen.values(), "seed": seed or 0, "device": device or "cpu"}
        return MethodChoice(chosen.name, values, _overrides("method", chosen), {})
    if not isinstance(chosen, Method) and not (isinstance(chosen, type) and issubclass(chosen, Method)):
        raise BadInput(
            f"a method of type {type(chosen).__name__} came; wanted a name, vprbench.method(...) or an object whose "
            "class subclasses vprbench.api.Method"
        )
    return _describe_object(chosen() if isinstance(chosen, type) else chosen, {"seed": seed, "device": device})


def _describe_object(given: Method, per_run: Mapping[str, Any]) -> MethodChoice:
    """Return the choice of methods of the class and arguments of an object; itself is never fitted."""
    kind = type(given)
    arguments, reason = _arguments(given)
    arguments |= {name: value for name, value in per_run.items() if name in arguments and value is not None}
    recorded: dict[str, Any] = {}
    for name, value in arguments.items():
        try:
            recorded[name] = plain(value)
        except ValueError as error:
            reason = f"its argument {name} cannot be recorded, for a {error}"
    try:
        hash_class(kind)
    except OSError as error:
        reason = str(error)

    def make(wanted: Mapping[str, Any]) -> Method:
        if not arguments:
            return copy.deepcopy(given)
        return kind(
            **{name: wanted[name] if wanted.get(name) != recorded.get(name) else arguments[name] for name in arguments}
        )

    own = {name: one.default for name, one in inspect.signature(kind).parameters.items()}
    changed = {
        name: value
        for name, value in recorded.items()
        if name not in per_run and not _equals_default(value, own.get(name))
    }
    overrides = (f"method={kind.__name__}", *(f"method.{name}={_text(value)}" for name, value in changed.items()))
    config = {"_target_": f"{kind.__module__}.{kind.__qualname__}", **recorded}
    described = {"method_name": kind.__name__, "method": config, "changed": changed, "tuned_on": {}}
    values = {name: recorded[name] for name in per_run if name in recorded}
    return MethodChoice(kind.__name__, values, overrides, described, make, reason)


def _arguments(given: Method) -> tuple[dict[str, Any], str | None]:
    """Return the arguments that an object was made of, and why they cannot be told, if so.

    They are its fields if it is a dataclass, else the attributes that have their names.
    """
    if dataclasses.is_dataclass(given):
        return {field.name: getattr(given, field.name) for field in dataclasses.fields(given) if field.init}, None
    found: dict[str, Any] = {}
    for name in inspect.signature(type(given)).parameters:
        held = next((one for one in (name, f"_{name}") if hasattr(given, one)), None)
        if held is None:
            return {}, f"its argument {name} cannot be told: keep it as an attribute of that name, or use a dataclass"
        found[name] = getattr(given, held)
    return found, None


def plain(value: Any) -> Any:
    """Return a value as plain ones that a record can hold; raises ValueError for an object without plain content."""
    try:
        return to_jsonable_python(value, fallback=_of_array)
    except (PydanticSerializationError, UnicodeDecodeError) as error:
        raise ValueError(f"{type(value).__name__} has no plain content") from error


def _of_array(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype != object:
        if value.size <= _MOST_NUMBERS:
            return value.tolist()
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    raise ValueError(f"{type(value).__name__} has no plain content")


def _equals_default(recorded: Any, default: Any) -> bool:
    try:
        return bool(recorded == plain(default))
    except ValueError:
        return False


def _require_entry(group: Group, text: str, options: Mapping[str, Any]) -> str:
    """Return the name of an entry, which may be in a loose file; raises BadInput."""
    name = registry.resolve_name(group, text)
    known = entries(group)
    if name not in known:
        raise BadInput(f"{group} {name} is unknown: {near(name, known)}")
    for option in options:
        if option not in known[name].options:
            raise BadInput(f"option {option} is unknown to {name}: {near(option, known[name].options)}")
    return name


def _values(group: Group, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options under the names that a configuration has for them, those of a mapping one by one."""
    return {f"{group}.{name}": plain(value) for name, value in _flat(options)}


def _flat(options: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in options.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _overrides(group: Group, chosen: NamedMethod | NamedDataset) -> tuple[str, ...]:
    named = _values(group, chosen.options)
    return (f"{group}={chosen.name}", *(f"{name}={_text(value)}" for name, value in named.items()))


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _as_call(group: Group, name: str, options: Mapping[str, Any]) -> str:
    return short(f"{group}({', '.join([repr(name), *(f'{option}={value!r}' for option, value in options.items())])})")
