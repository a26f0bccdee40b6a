"""Options of the command line -> the configuration of a run; what Hydra has to say about them, in one line."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NoReturn, cast

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.runs.settings import KNOWN, timings
from vprbench.runs.timing_protocol import Protocol
from vprbench.text import near


def composed(options: Sequence[str], values: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the configuration of a run with these options, and these values by dotted names, as plain values.

    Raises BadInput for what begins with a dash, Hydra's errors for the rest.
    """
    for option in options:
        if option.startswith("-"):
            raise BadInput(f"{option} is no option here: see python -m vprbench --help")
    _require_options(options)
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = hydra.compose("run", overrides=list(options))
    for name, value in (values or {}).items():
        OmegaConf.update(config, name, value)
    return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))


def composed_in_python(options: Sequence[str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what `composed` does in a program that may use Hydra itself; raises BadInput for all that does not fit."""
    registry.register_search_path()
    kept, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None
    try:
        return composed(options, values)
    except (HydraException, OmegaConfBaseException) as error:
        raise BadInput(explained(error, [*options, *values])) from error
    finally:
        GlobalHydra.instance().hydra = kept


def readable(arguments: Sequence[str]) -> list[str]:
    """Put quotes around values, such as paths with letters from abroad, that Hydra's grammar cannot read bare.

    Of a list, as in [~/north,~/south], around each value. A method or dataset in a loose file, ./mine.py:MyMethod, is
    registered and gets its name. Raises BadInput for a file that cannot be imported.
    """
    quoted = []
    for argument in arguments:
        _require_quotes(argument)
        key, equals, value = argument.partition("=")
        if key in ("method", "dataset", "methods"):
            value = _named("dataset" if key == "dataset" else "method", value)
            argument = f"{key}{equals}{value}"
        if equals and not argument.startswith("-") and not _is_override(argument):
            parts = (
                [f"{key}=[{','.join(map(_quoted, value[1:-1].split(',')))}]"] if value[:1] + value[-1:] == "[]" else []
            )
            argument = next(filter(_is_override, parts), f"{key}={_quoted(value)}")
        quoted.append(argument)
    return quoted


def _named(group: registry.Group, names: str) -> str:
    """Return the names in a text, between commas, those of loose files as they are registered by."""
    bare = names.removeprefix("[").removesuffix("]")
    return names.replace(bare, ",".join(registry.named(group, name) for name in bare.split(","))) if bare else names


def _is_override(argument: str) -> bool:
    try:
        OverridesParser.create().parse_override(argument)
    except HydraException:
        return False
    return True


def _require_options(arguments: Sequence[str]) -> None:
    """Raise BadInput for the first that is no option=value, with the near names."""
    for argument in arguments:
        _require_quotes(argument)
        name = argument.partition("=")[0]
        if not name or not _is_override(argument):
            wanted = f"give {name}=value" if name in KNOWN or "." in name else near(name, KNOWN)
            raise BadInput(f"{argument or 'an empty argument'} is no option=value: {wanted}")


def _require_quotes(argument: str) -> None:
    """Raise BadInput for an option of the dataset that would cut a path which is there at its comma."""
    key, _, value = argument.partition("=")
    if not key.lstrip("+").startswith("dataset.") or "," not in value or {"'", '"'} & {*value}:
        return
    parts = value.removeprefix("[").removesuffix("]").split(",")
    for first, last in combinations(range(len(parts) + 1), 2):
        path = ",".join(parts[first:last])
        if last - first > 1 and _is_there(path) and not all(map(_is_there, parts[first:last])):
            wanted = f'["{path}"]' if value.startswith("[") else f'"{path}"'
            raise BadInput(f"{argument}: {path} holds a comma: put the path in quotes, as in '{key}={wanted}'")


def _is_there(path: str) -> bool:
    return os.path.lexists(Path(path).expanduser())


def _quoted(value: str) -> str:
    return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"


def in_order(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of a run with Hydra's flags before the options.

    An option of the method or the dataset follows the choice in each run of a sweep: Hydra applies the others to its
    default choice too. Raises BadInput for flags that do not fit.
    """
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]
    parsed = parser.parse_intermixed_args(list(arguments))
    for flag in ("resolve", "package"):
        if getattr(parsed, flag) and not parsed.cfg:
            raise BadInput(f"--{flag}: give --cfg job too")
    if parsed.multirun and not parsed.overrides:
        raise BadInput("-m: say what to run, as in method=sad,pca seed=0,1,2")
    _require_options(parsed.overrides)
    flags = list(arguments)
    for option in parsed.overrides:
        flags.remove(option)
    options = [_swept(option) if parsed.multirun else option for option in parsed.overrides]
    return [*flags, *options]


def _refuse(message: str) -> NoReturn:
    raise BadInput(f"{message}: see python -m vprbench --help")


def _swept(option: str) -> str:
    """Return an option of method or dataset with one value as a choice of one, which a sweep leaves to each run."""
    key, equals, value = option.partition("=")
    if not equals or key.lstrip("+").split(".")[0] not in ("method", "dataset") or "." not in key:
        return option
    return option if OverridesParser.create().parse_override(option).is_sweep_override() else f"{key}=choice({value})"


def check_names(arguments: Sequence[str]) -> None:
    """Raise BadInput, with near names, for a method, dataset or timing that is not there or has no readable yaml."""
    for argument in arguments:
        if re.fullmatch(r"timing=[\w,.-]*", argument):
            for name in argument.removeprefix("timing=").split(","):
                if name not in timings():
                    raise BadInput(_no_such("timing", name))
    groups: tuple[registry.Group, ...] = ("method", "dataset")
    for group in groups:
        for argument in arguments:
            if argument.startswith(f"{group}=["):
                raise BadInput(f"{argument}: give one name, or with -m several between commas")
            if argument.startswith(f"{group}=") and re.fullmatch(r"[\w,.-]*", argument.split("=", 1)[1]):
                names = _named(group, argument.split("=", 1)[1]).split(",")
                known = registry.entries(group)
                for name in names:
                    registry.require_one(group, name)
                    if name not in known:
                        raise BadInput(f"{group}={name} is unknown: {near(name, known)}")
                    known[name].values()


def explained(error: Exception, arguments: Sequence[str]) -> str:
    """Turn an error of Hydra into one line that names the option and what to do."""
    text = " ".join(str(error).split())
    if several := re.match(r"Ambiguous value for argument '(.+?)' 1\.", text):
        name, _, values = several[1].partition("=")
        return f"{several[1]}: give -m too, to run with each, or {name}=[{values}], for a list"
    if sought := re.search(r"Could not find '(method|dataset|timing)/(.*?)'\s+Available", str(error), re.DOTALL):
        return _no_such(sought[1], sought[2])
    if (unresolved := re.match(r"(.+) full_key: (\S+) object_type=", text)) and not text.startswith("Key '"):
        return f"{unresolved[2]}: {unresolved[1]}"
    if group := re.match(r"Multiple values for (\w+)\.|Could not override '(method|dataset|timing)'", text):
        name = group[1] or group[2]
        return f"option {name} takes one name, as in {name}={_names(name)[0]}, or with -m several between commas"
    told = (r"Could not override '([^']+)'", r"Key '([^']+)' is not in struct", r"Could not delete .*?'([^']+)' does")
    option = next(filter(None, (re.match(pattern, text) for pattern in told)), None)
    if option is None:
        found = re.search(r"Could not find '([^']+)'", text)
        return f"{found[1]} is unknown" if found else text.split(" See https://hydra.cc")[0]
    path = option.group(1)
    above, _, name = path.partition(".")
    if above in ("method", "dataset") and name:
        return _unfit("method" if above == "method" else "dataset", name, arguments)
    if above == "timing" and name:
        return f"option {path} is unknown: {near(name, Protocol.__dataclass_fields__)}"
    return f"option {path} is unknown: {near(path, KNOWN)}"


def _names(group: str) -> list[str]:
    if group == "timing":
        return timings()
    return list(registry.entries("method" if group == "method" else "dataset"))


def _no_such(group: str, name: str) -> str:
    return f"{group}={name} is unknown: {near(name, _names(group))}"


def _unfit(group: registry.Group, option: str, arguments: Sequence[str]) -> str:
    """Say which of the chosen methods or datasets lacks an option, and what it has."""
    given = next((a.split("=", 1)[1] for a in arguments if a.startswith(f"{group}=")), "")
    entries = registry.entries(group)
    for chosen in given.strip("'\"").split(",") if given else [{"method": "sad", "dataset": "synthetic"}[group]]:
        chosen = registry.named(group, chosen)
        known = entries[chosen].options if chosen in entries else []
        if option.split(".")[0] not in known:
            return f"option {group}.{option} is unknown to {chosen}: {near(option, known)}"
    return f"option {group}.{option} is unknown"
