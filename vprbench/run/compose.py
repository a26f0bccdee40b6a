"""Options of the command line -> the configuration of a run; what Hydra has to say about them, in one line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NoReturn, cast

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.run.settings import KNOWN, timings
from vprbench.run.timing_protocol import Protocol


def composed(options: Sequence[str]) -> dict[str, Any]:
    """Return the configuration of a run with these options, as plain values.

    Raises BadInput for what begins with a dash, Hydra's errors for the rest.
    """
    for option in options:
        if option.startswith("-"):
            raise BadInput(f"{option} is no option here: see python -m vprbench --help")
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        return cast(dict[str, Any], OmegaConf.to_container(hydra.compose("run", overrides=list(options)), resolve=True))


def readable(arguments: Sequence[str]) -> list[str]:
    """Put quotes around values, such as paths with letters from abroad, that Hydra's grammar cannot read bare.

    Of a list, as in [~/north,~/south], around each value.
    """
    quoted = []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and not argument.startswith("-") and not _is_override(argument):
            parts = (
                [f"{key}=[{','.join(map(_quoted, value[1:-1].split(',')))}]"] if value[:1] + value[-1:] == "[]" else []
            )
            argument = next(filter(_is_override, parts), f"{key}={_quoted(value)}")
        quoted.append(argument)
    return quoted


def _is_override(argument: str) -> bool:
    try:
        OverridesParser.create().parse_override(argument)
    except HydraException:
        return False
    return True


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
    if parsed.resolve and not parsed.cfg:
        raise BadInput("--resolve: give --cfg job too")
    if parsed.multirun and not parsed.overrides:
        raise BadInput("-m: say what to run, as in method=sad,pca seed=0,1,2")
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
    """Raise BadInput for a method or dataset that does not exist, with the near names."""
    groups: tuple[registry.Group, ...] = ("method", "dataset")
    for group in groups:
        known = registry.entries(group)
        for argument in arguments:
            if argument.startswith(f"{group}=") and re.fullmatch(r"[\w,.-]*", argument.split("=", 1)[1]):
                for name in argument.split("=", 1)[1].split(","):
                    registry.insist_on_one(group, name)
                    if name not in known:
                        raise BadInput(f"{group}={name} is unknown: {registry.near(name, known)}")


def explained(error: Exception, arguments: Sequence[str]) -> str:
    """Turn an error of Hydra into one line that names the option and what to do."""
    text = " ".join(str(error).split())
    if several := re.match(r"Ambiguous value for argument '(.+?)' 1\.", text):
        name, _, values = several[1].partition("=")
        return f"{several[1]}: give -m too, to run with each, or {name}=[{values}], for a list"
    if sought := re.search(r"Could not find '(method|dataset|timing)/(.*?)'\s+Available", str(error), re.DOTALL):
        return _no_such(sought[1], sought[2])
    if "Config group override must be" in text:
        wrong = [option.split("=", 1) for option in arguments if re.match("(method|dataset|timing)=", option)]
        return next((_no_such(*pair) for pair in wrong if pair[1] not in _names(pair[0])), text)
    if (unresolved := re.match(r"(.+) full_key: (\S+) object_type=", text)) and not text.startswith("Key '"):
        return f"{unresolved[2]}: {unresolved[1]}"
    option = re.match(r"Could not override '([^']+)'", text) or re.match(r"Key '([^']+)' is not in struct", text)
    if option is None:
        return text
    path = option.group(1)
    above, _, name = path.partition(".")
    if above in ("method", "dataset") and name:
        return _unfit("method" if above == "method" else "dataset", name, arguments)
    if above == "timing" and name:
        return f"option {path} is unknown: {registry.near(name, Protocol.__dataclass_fields__)}"
    return f"option {path} is unknown: {registry.near(path, KNOWN)}"


def _names(group: str) -> list[str]:
    if group == "timing":
        return timings()
    return list(registry.entries("method" if group == "method" else "dataset"))


def _no_such(group: str, name: str) -> str:
    return f"{group}={name} is unknown: {registry.near(name, _names(group))}"


def _unfit(group: registry.Group, option: str, arguments: Sequence[str]) -> str:
    """Say which of the chosen methods or datasets lacks an option, and what it has."""
    given = next((a.split("=", 1)[1] for a in arguments if a.startswith(f"{group}=")), "")
    entries = registry.entries(group)
    for chosen in given.strip("'\"").split(",") if given else [{"method": "sad", "dataset": "synthetic"}[group]]:
        known = entries[chosen].options if chosen in entries else []
        if option.split(".")[0] not in known:
            return f"option {group}.{option} is unknown to {chosen}: {registry.near(option, known)}"
    return f"option {group}.{option} is unknown"
