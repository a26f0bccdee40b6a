"""The method and the dataset of a run: registered ones by name, with options, or objects of a program."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
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
from vprbench.runs.identity import hash_class
from vprbench.text import shorten

_MOST_NUMBERS = 1 << 16  # of an array that a record holds; of a larger one it holds the hash
_LONGEST = 60  # letters of an argument in the name of a row


@dataclass(frozen=True, repr=False)
class _Named:
    """A registered method or dataset with options of its own."""

    group: ClassVar[Group]
    name: str
    options: Mapping[str, Any]

    def values(self) -> dict[str, Any]:
        """Return the options by the names that a request has for them, those of a mapping one by one."""
        return {f"{self.group}.{name}": as_plain(value) for name, value in _flatten(self.options)}

    def overrides(self) -> tuple[str, ...]:
        """Return name and options as on the command line."""
        return (f"{self.group}={self.name}", *(f"{name}={_as_text(value)}" for name, value in self.values().items()))

    def __repr__(self) -> str:
        given = ", ".join([repr(self.name), *(f"{name}={value!r}" for name, value in self.options.items())])
        return shorten(f"{self.group}({given})")


class NamedMethod(_Named):
    """A registered method and options of its own; it is built when it runs."""

    group = "method"

    def build(self, seed: int = 0, device: str = "cpu") -> Method:
        """Return a new method, which is not fitted; raises BadInput for options that do not fit."""
        values = {**self.values(), "seed": seed, "device": device}
        return registry.make_method(make_request([f"method={self.name}"], values).method)


class NamedDataset(_Named):
    """A registered dataset and options of its own; it is built when a method runs on it."""

    group = "dataset"

    def build(self) -> Dataset:
        """Return the dataset; raises BadInput for options that do not fit, MissingData where its frames are missing."""
        return registry.make_dataset(make_request([f"dataset={self.name}"], self.values()).dataset)


AnyMethod = str | NamedMethod | Method | type[Method]
AnyDataset = str | NamedDataset | Dataset


def method(name: str, /, **options: Any) -> NamedMethod:
    """Return a registered method, or one in a file, with options of its own: `method("vprtempo", max_module=50)`.

    Raises BadInput, with the near names, for an unknown method or option.
    """
    chosen = NamedMethod(loose.resolve_name("method", name), options)
    make_request(chosen.overrides()[:1], chosen.values())
    return chosen


def dataset(name: str, /, **options: Any) -> NamedDataset:
    """Return a registered dataset, or one in a file, with options of its own: `dataset("synthetic", places=100)`.

    Raises BadInput, with the near names, for an unknown dataset or option.
    """
    chosen = NamedDataset(loose.resolve_name("dataset", name), options)
    make_request(chosen.overrides()[:1], chosen.values())
    return chosen


@dataclass(frozen=True)
class Choice:
    """The parts of a request that a method or a dataset decides."""

    name: str
    overrides: tuple[str, ...]  # name and options as on the command line
    values: Mapping[str, Any] = field(default_factory=dict)  # options by their dotted names
    described: Mapping[str, Any] = field(default_factory=dict)  # fields of the request that describe an object

    @property
    def options(self) -> tuple[str, ...]:
        """The option that chooses a registered one; none for an object."""
        return () if self.described else self.overrides[:1]

    @property
    def label(self) -> str:
        """The name with the options, as tables show it."""
        return " ".join([self.name, *(option.partition(".")[2] for option in self.overrides[1:])])


@dataclass(frozen=True)
class MethodChoice(Choice):
    """The parts of a request that a method decides."""

    make: Callable[[Mapping[str, Any]], Method] | None = None  # makes an object anew, of the request's arguments
    unstored_reason: str | None = None  # why its runs cannot be told from others, and so are not stored


def choose_dataset(chosen: AnyDataset) -> tuple[Choice, Dataset]:
    """Build a dataset; raises what its builder raises, BadInput for any other object."""
    chosen = dataset(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedDataset):
        return Choice(chosen.name, chosen.overrides(), chosen.values()), chosen.build()
    if not isinstance(chosen, Dataset):
        raise BadInput(
            f"a dataset of type {type(chosen).__name__} came; wanted a name, vprbench.dataset(...) or a Dataset, as "
            "vprbench.dataset_of(...) makes one of images"
        )
    described = {"dataset_name": chosen.name, "dataset": {"name": chosen.name}}
    return Choice(chosen.name, (f"dataset={chosen.name}",), {}, described), chosen


def choose_method(chosen: AnyMethod, seed: int | None = None, device: str | None = None) -> MethodChoice:
    """Return the parts of a request; without seed and device those of an object, else 0 and the CPU.

    Raises BadInput for any other object.
    """
    chosen = method(chosen) if isinstance(chosen, str) else chosen
    if isinstance(chosen, NamedMethod):
        values = {**chosen.values(), "seed": seed or 0, "device": device or "cpu"}
        return MethodChoice(chosen.name, chosen.overrides(), values)
    if isinstance(chosen, type) and issubclass(chosen, Method):
        chosen = chosen()
    if not isinstance(chosen, Method):
        raise BadInput(
            f"a method of type {type(chosen).__name__} came; wanted a name, vprbench.method(...) or an object whose "
            "class subclasses vprbench.api.Method"
        )
    return _describe_object(chosen, {"seed": seed, "device": device})


def _describe_object(given: Method, per_run: Mapping[str, Any]) -> MethodChoice:
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

    def make(wanted: Mapping[str, Any]) -> Method:
        if not arguments:
            return copy.deepcopy(given)
        return kind(
            **{name: wanted[name] if wanted.get(name) != recorded.get(name) else arguments[name] for name in arguments}
        )

    defaults = {name: one.default for name, one in inspect.signature(kind).parameters.items()}
    own = {name: value for name, value in recorded.items() if name not in per_run}
    changed = {name: value for name, value in own.items() if not _equals_default(value, defaults.get(name))}
    overrides = (f"method={kind.__name__}", *(f"method.{name}={_abbreviate(value)}" for name, value in changed.items()))
    config = {"_target_": f"{kind.__module__}.{kind.__qualname__}", **recorded}
    described = {"method_name": kind.__name__, "method": config, "changed": changed, "tuned_on": {}}
    values = {name: recorded[name] for name in per_run if name in recorded}
    return MethodChoice(kind.__name__, overrides, values, described, make, reason)


def _read_arguments(given: Method) -> tuple[dict[str, Any], str | None]:
    """Return the arguments that an object was made of, and the reason if they are not known.

    They are the fields of a dataclass, else the attributes of the same names.
    """
    if dataclasses.is_dataclass(given):
        return {one.name: getattr(given, one.name) for one in dataclasses.fields(given) if one.init}, None
    found: dict[str, Any] = {}
    for name in inspect.signature(type(given)).parameters:
        held = next((one for one in (name, f"_{name}") if hasattr(given, one)), None)
        if held is None:
            return {}, f"its argument {name} is not known: keep it as an attribute of that name, or use a dataclass"
        found[name] = getattr(given, held)
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
    if isinstance(value, np.ndarray) and value.dtype != object:
        if value.size <= _MOST_NUMBERS:
            return value.tolist()
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    raise ValueError(f"{type(value).__name__} has no plain content")


def _equals_default(recorded: Any, default: Any) -> bool:
    try:
        return bool(recorded == as_plain(default))
    except ValueError:
        return False


def _flatten(options: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in options.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _as_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _abbreviate(value: Any) -> str:
    """Return an argument of an object as text; of a long one, such as an array, the first digits of its hash."""
    text = _as_text(value)
    return text if len(text) <= _LONGEST else f"#{hashlib.sha256(text.encode()).hexdigest()[:8]}"
