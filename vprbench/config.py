"""Options of the command line or of a program become requests of runs; Hydra is known here and in plugins.registry."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast, get_type_hints

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench.errors import BadInput
from vprbench.plugins import entries, registry
from vprbench.plugins.entries import Folder, Group
from vprbench.plugins.options import check_value
from vprbench.plugins.tuned_places import parse_tuned_on
from vprbench.runs.request import OPTIONS, RunRequest
from vprbench.runs.timing_protocol import Protocol
from vprbench.storage.folders import require_homes
from vprbench.text import near

_CONF = "vprbench.conf"
_OF_RUN = ("_target_", "seed", "device")  # arguments of a method that every run sets for itself
_GROUPS: tuple[Folder, ...] = ("method", "dataset", "timing")  # options that name a yaml


def make_request(
    options: Sequence[str] = (),
    values: Mapping[str, Any] | None = None,
    objects: Mapping[str, Any] | None = None,
) -> RunRequest:
    """Return the run that is asked for.

    Args:
        options: of the command line, as in method=sad.
        values: more options by their dotted names, as plain values.
        objects: fields of the request that describe a method or dataset that is no registered one.

    Raises:
        BadInput: an option is unknown or does not fit.
    """
    options = quote_options(options)
    composed = _compose(options, values)
    config = _resolve(composed)
    fields = {
        "method_name": _choose("method", options),
        "method": registry.arguments(config["method"]),
        "dataset_name": str(config["dataset"].get("name") or _choose("dataset", options)),
        "dataset": config["dataset"],
        "changed": _find_changed(options, values or {}, composed),
        "tuned_on": parse_tuned_on(config["method"].get("tuned_on"), f"method {_choose('method', options)}"),
        "overrides": [*map(entries.with_plugin_paths, options), *_as_options(values or {})],
        **_check_options(config),
    }
    return RunRequest(**{**fields, **(objects or {})})


def split_sweep(options: Sequence[str]) -> list[list[str]]:
    """Return the options of each run of a sweep, as `method=sad,pca seed=0,1` asks for four; raises BadInput."""
    options = quote_options(options)
    _require_options(options)
    swept = []
    with _explaining():
        for parsed in OverridesParser.create().parse_overrides(list(options)):
            key = parsed.get_key_element()
            if parsed.is_discrete_sweep():
                swept.append([f"{key}={value}" for value in parsed.sweep_string_iterator()])
            else:
                swept.append([parsed.input_line or ""])
    return [list(run) for run in itertools.product(*swept)]


def show_config(options: Sequence[str]) -> str:
    """Return the configuration that options make, as YAML; raises BadInput."""
    return OmegaConf.to_yaml(OmegaConf.create(_resolve(_compose(quote_options(options)))))


def quote_options(options: Sequence[str]) -> list[str]:
    """Put quotes around values, such as paths with accents, that Hydra's grammar cannot read bare.

    Of a list, as in [~/north,~/south], around each value. A method or dataset in a loose file, ./mine.py:MyMethod, is
    registered and gets its name. Raises BadInput for a file that cannot be imported.
    """
    quoted = []
    for option in options:
        _require_quotes(option)
        key, equals, value = option.partition("=")
        if key in ("method", "dataset", "methods"):
            value = _register_names("dataset" if key == "dataset" else "method", value)
            option = f"{key}{equals}{value}"
        if equals and not option.startswith("-") and not _is_override(option):
            listed = f"{key}=[{','.join(map(_quote, value[1:-1].split(',')))}]"
            is_list = value[:1] + value[-1:] == "[]" and _is_override(listed)
            option = listed if is_list else f"{key}={_quote(value)}"
        quoted.append(option)
    return quoted


def _compose(options: Sequence[str], values: Mapping[str, Any] | None = None) -> DictConfig:
    """Return the composition of conf/run.yaml and these options by Hydra; raises BadInput."""
    _require_options(options)
    for option in (*options, *(values or {})):
        if option.lstrip("+~").startswith("method.tuned_on"):
            raise BadInput(f"{option}: the yaml of a method alone says method.tuned_on=, give no other")
    for group in _GROUPS:
        known, name = entries.entries(group), _choose(group, options)
        if name in known:
            known[name].values()  # raises BadInput, with the line, for a yaml that cannot be read
        elif re.fullmatch(r"[\w.-]*", name):
            raise BadInput(f"{group}={name} is unknown: {near(name, known)}")
    for option in (*options, *(values or {})):
        _require_known(option, options)
    folders = [_quote(f"file://{folder}") for name, folder in entries.conf_folders().items() if name != "vprbench"]
    kept, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None  # a program may use Hydra itself
    try:
        with _explaining(), hydra.initialize_config_module(_CONF, version_base="1.3"):
            config = hydra.compose("run", overrides=[f"hydra.searchpath=[{','.join(folders)}]", *options])
            for name, value in (values or {}).items():
                OmegaConf.update(config, name, value)
            return config
    finally:
        GlobalHydra.instance().hydra = kept


def _resolve(config: DictConfig, resolve: bool = True) -> dict[str, Any]:
    """Return a configuration as plain values; raises BadInput for an interpolation that names nothing."""
    with _explaining():
        return cast(dict[str, Any], OmegaConf.to_container(config, resolve=resolve))


def _find_changed(options: Sequence[str], values: Mapping[str, Any], given: DictConfig) -> dict[str, Any]:
    """Return the arguments of the method that differ from its yaml, with their values; seed and device do not count."""
    plain = [option for option in options if not option.lstrip("+~").startswith("method.")]
    if len(plain) == len(options) and not any(name.startswith("method.") for name in values):
        return {}
    own, changed = (_resolve(each, resolve=False)["method"] for each in (_compose(plain), given))
    arguments = registry.arguments(_resolve(given)["method"])
    return _find_different({name: arguments[name] for name in arguments if name not in _OF_RUN}, changed, own)


def _find_different(values: Mapping[str, Any], given: Mapping[Any, Any], own: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the values whose given text, interpolations as they stand, differs from the own one."""
    found = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and isinstance(own.get(name), Mapping):
            if inner := _find_different(value, given[name], own[name]):
                found[name] = inner
        elif name not in own or given[name] != own[name]:
            found[name] = value
    return found


def _check_options(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a run; raises BadInput that names the first one that is missing or of another type."""
    for name in OPTIONS:
        if name not in config:
            raise BadInput(f"option {name} is missing: leave its default in place")
    require_homes(config)
    hints = get_type_hints(RunRequest, include_extras=True)
    own = [name for name in OPTIONS if name not in ("method", "dataset", "timing")]
    return {**{name: check_value(name, config[name], hints[name]) for name in own}, "timing": _timing(config["timing"])}


def _timing(config: Any) -> Protocol:
    if not isinstance(config, Mapping):
        known = ", ".join(entries.entries("timing"))
        raise BadInput(f"timing={config}: give {known}, or one option, as in timing.minimum_seconds=10")
    hints = get_type_hints(Protocol, include_extras=True)
    for name in config:
        if name not in hints:
            raise BadInput(f"option timing.{name} is unknown: {near(name, hints)}")
    return Protocol(**{name: check_value(f"timing.{name}", config[name], hints[name]) for name in config})


def _as_options(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield values by dotted names as options of the command line."""
    for name, value in values.items():
        yield f"{name}={value if isinstance(value, str) else json.dumps(value)}"


def _choose(group: Folder, options: Sequence[str]) -> str:
    """Return the name of the method, dataset or timing that options choose, the last one if there are several."""
    given = [option.partition("=")[2].strip("'\"") for option in options if option.startswith(f"{group}=")]
    return given[-1] if given else entries.find_default(group)


def _register_names(group: Group, names: str) -> str:
    """Return names between commas; a loose file is registered and replaced by the name of its method or dataset."""
    bare = names.removeprefix("[").removesuffix("]")
    found = ",".join(registry.resolve_name(group, name) for name in bare.split(","))
    return names.replace(bare, found) if bare else names


def _is_override(option: str) -> bool:
    try:
        OverridesParser.create().parse_override(option)
    except HydraException:
        return False
    return True


def _require_options(options: Sequence[str]) -> None:
    """Raise BadInput for the first that is no option=value, with the near names."""
    for option in options:
        if option.startswith("-"):
            raise BadInput(f"{option} is no option here: see python -m vprbench --help")
        name = option.partition("=")[0]
        if not name or not _is_override(option):
            wanted = f"give {name}=value" if name in OPTIONS or "." in name else near(name, OPTIONS)
            raise BadInput(f"{option or 'an empty argument'} is no option=value: {wanted}")


def _require_known(option: str, options: Sequence[str]) -> None:
    """Raise BadInput, with near names, for an option that neither a run nor its method, dataset or timing has."""
    name = option.partition("=")[0].lstrip("+~")
    group, _, inner = name.partition(".")
    if group not in OPTIONS:
        raise BadInput(f"option {name} is unknown: {near(group, OPTIONS)}")
    if not inner or group not in _GROUPS or option.startswith("+"):
        return
    chosen = _choose(group, options)
    entry = entries.entries(group).get(chosen)
    if entry is not None and inner.partition(".")[0] not in entry.values():
        raise BadInput(f"option {name} is unknown to {chosen}: {near(inner, entry.options)}")


def _require_quotes(option: str) -> None:
    """Raise BadInput for an option of the dataset that would cut an existing path at its comma."""
    key, _, value = option.partition("=")
    if not key.lstrip("+").startswith("dataset.") or "," not in value or {"'", '"'} & {*value}:
        return
    parts = value.removeprefix("[").removesuffix("]").split(",")
    for first, last in itertools.combinations(range(len(parts) + 1), 2):
        path = ",".join(parts[first:last])
        if last - first > 1 and _exists(path) and not all(map(_exists, parts[first:last])):
            wanted = f'["{path}"]' if value.startswith("[") else f'"{path}"'
            raise BadInput(f"{option}: {path} holds a comma: put the path in quotes, as in '{key}={wanted}'")


def _exists(path: str) -> bool:
    return os.path.lexists(Path(path).expanduser())


def _quote(value: str) -> str:
    return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"


@contextmanager
def _explaining() -> Iterator[None]:
    """Turn an error of Hydra into BadInput."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise BadInput(_explain(error)) from error


def _explain(error: Exception) -> str:
    """Return an error of Hydra as one line that names the option and the remedy."""
    text = " ".join(str(error).split())
    if several := re.match(r"Ambiguous value for argument '(.+?)' 1\.", text):
        name, _, values = several[1].partition("=")
        return f"{several[1]}: give -m too, to run with each, or {name}=[{values}], for a list"
    if sought := re.search(r"Could not find '(method|dataset|timing)/(.*?)'\s+Available", str(error), re.DOTALL):
        return f"{sought[1]}={sought[2]} is unknown: {near(sought[2], entries.entries(cast(Folder, sought[1])))}"
    if (unresolved := re.match(r"(.+) full_key: (\S+) object_type=", text)) and not text.startswith("Key '"):
        return f"{unresolved[2]}: {unresolved[1]}"
    if group := re.match(r"Multiple values for (\w+)\.|Could not override '(method|dataset|timing)'", text):
        name = group[1] or group[2]
        return f"option {name} takes one name, as in {name}=NAME, or with -m several between commas"
    if nested := re.match(r"Key '[^']+' is not in struct full_key: (\S+)", text):
        return f"option {nested[1]} is unknown"
    return text.split(" See https://hydra.cc")[0]
