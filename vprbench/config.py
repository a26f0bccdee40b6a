"""Options of the command line or of a program become requests of runs; Hydra is known here and in plugins.loose."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast, get_type_hints

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench.errors import BadInput
from vprbench.plugins import entries, loose, registry
from vprbench.plugins.entries import Folder, Group
from vprbench.plugins.options import check_values
from vprbench.plugins.tuned_places import parse_tuned_on
from vprbench.runs.request import OPTIONS, RunRequest
from vprbench.runs.timing_protocol import Protocol
from vprbench.storage.folders import require_homes
from vprbench.text import suggest_names

_CONF = "vprbench.conf"
_SET_BY_RUN = ("method.seed", "method.device")
_GROUPS: tuple[Folder, ...] = ("method", "dataset", "timing")  # options that name a yaml


@contextmanager
def _refuse_hydra_errors() -> Iterator[None]:
    """Turn an error of Hydra into BadInput of one line."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        text = " ".join(str(error).split()).partition(" See https://hydra.cc")[0]
        raise BadInput(text.replace("--multirun", "-m")) from error


@_refuse_hydra_errors()
def make_request(
    options: Sequence[str] = (),
    values: Mapping[str, Any] | None = None,
    objects: Mapping[str, Any] | None = None,
) -> RunRequest:
    """Return the request of a run.

    Args:
        options: of the command line, as in method=sad.
        values: more options by their dotted names, as plain values.
        objects: fields of the request that describe a method or dataset that is no registered one.

    Raises:
        BadInput: an option is unknown or does not fit.
    """
    options, values = quote_options(options), values or {}
    composed = _compose_config(options, values)
    config = cast(dict[str, Any], OmegaConf.to_container(composed, resolve=True))
    name = _choose_name("method", options)
    require_homes(config)
    declared = config["method"].get("tuned_on")
    own = {option: config[option] for option in OPTIONS if option not in _GROUPS}
    given = [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in values.items()]
    fields = {
        "method_name": name,
        "method": registry.take_arguments(config["method"]),
        "dataset_name": str(config["dataset"].get("name") or _choose_name("dataset", options)),
        "dataset": config["dataset"],
        "changed": _find_changed_arguments(options, values, composed),
        "tuned_on": {} if declared is None else parse_tuned_on(declared, f"method {name}"),
        "overrides": [*map(entries.spell_out_plugin_paths, options), *given],
        "timing": Protocol(**check_values("timing.", config["timing"], get_type_hints(Protocol, include_extras=True))),
        **check_values("", own, get_type_hints(RunRequest, include_extras=True)),
    }
    return RunRequest(**{**fields, **(objects or {})})


def split_sweep(options: Sequence[str]) -> list[list[str]]:
    """Return the options of each run of a sweep: `method=sad,pca seed=0,1` makes four runs; raises BadInput."""
    swept = []
    for parsed in OverridesParser.create().parse_overrides(quote_options(options)):
        if parsed.is_discrete_sweep():
            swept.append([f"{parsed.get_key_element()}={value}" for value in parsed.sweep_string_iterator()])
        else:
            swept.append([parsed.input_line or ""])
    return [list(run) for run in itertools.product(*swept)]


@_refuse_hydra_errors()
def show_config(options: Sequence[str]) -> str:
    """Return the configuration that options make, as YAML; raises BadInput."""
    return OmegaConf.to_yaml(_compose_config(quote_options(options), {}), resolve=True)


def quote_options(options: Sequence[str]) -> list[str]:
    """Put quotes around values, such as paths with accents, that Hydra's grammar cannot read bare.

    In a list, as in [~/north,~/south], each value gets its own. A method or dataset in a loose file, as in
    ./mine.py:MyMethod, is registered and gets its name. Raises BadInput for what is no option=value, and for a file
    that cannot be imported.
    """
    return [_quote_option(option) for option in options]


def _quote_option(option: str) -> str:
    name, equals, value = option.partition("=")
    if name.startswith("dataset."):
        _refuse_cut_path(name, value)
    if name in ("method", "methods", "dataset") and ".py" in value:
        group: Group = "dataset" if name == "dataset" else "method"
        value = re.sub(r"[^][,]+", lambda each: loose.resolve_name(group, each[0]), value)
    forms = [value, _quote_value(value)]
    if value[:1] + value[-1:] == "[]":
        forms.insert(1, f"[{','.join(map(_quote_value, value[1:-1].split(',')))}]")
    for form in forms if equals and not option.startswith(("-", "~")) else ():
        with suppress(HydraException):
            OverridesParser.create().parse_override(f"{name}={form}")
            return f"{name}={form}"
    wanted = f"give {name}=value" if name in OPTIONS else suggest_names(name, OPTIONS)
    raise BadInput(f"{option or 'an empty argument'} is no option=value: {wanted}")


def _refuse_cut_path(name: str, value: str) -> None:
    """Raise BadInput for a value without quotes that cuts an existing path at its comma."""
    parts = re.findall(r"[^],]+", value.removeprefix("[")) if not {"'", '"'} & {*value} else []
    for first, last in itertools.combinations(range(len(parts) + 1), 2):
        path = ",".join(parts[first:last])
        if last - first > 1 and Path(path).expanduser().exists():
            wanted = f'["{path}"]' if value.startswith("[") else f'"{path}"'
            raise BadInput(f"{name}={value}: {path} holds a comma: put the path in quotes, as in '{name}={wanted}'")


def _compose_config(options: Sequence[str], values: Mapping[str, Any]) -> DictConfig:
    """Return Hydra's composition of conf/run.yaml and these options; raises BadInput and Hydra's errors."""
    _require_known_options(options, values)
    folders = [
        _quote_value(f"file://{folder}") for name, folder in entries.find_conf_folders().items() if name != "vprbench"
    ]
    kept, GlobalHydra.instance().hydra = GlobalHydra.instance().hydra, None  # a program may use Hydra itself
    try:
        with hydra.initialize_config_module(_CONF, version_base="1.3"):
            config = hydra.compose("run", overrides=[f"hydra.searchpath=[{','.join(folders)}]", *options])
    finally:
        GlobalHydra.instance().hydra = kept
    for name, value in values.items():
        OmegaConf.update(config, name, value)
    return config


def _require_known_options(options: Sequence[str], values: Iterable[str]) -> None:
    """Raise BadInput, with near names, for an option that neither a run nor its method, dataset or timing has.

    The declarations in the yaml of a method or dataset, as `tuned_on`, are no options.
    """
    known: dict[str, list[str]] = {}  # options by group
    for group in _GROUPS:
        choices, name = entries.find_entries(group), _choose_name(group, options)
        if name in choices:
            known[group] = choices[name].options  # raises BadInput, with the line, for a yaml that cannot be read
        elif "," not in name:
            raise BadInput(f"{group}={name} is unknown: {suggest_names(name, choices)}")
    for option in (*options, *values):
        name = _get_option_name(option)
        above, _, inner = name.partition(".")
        if above not in OPTIONS:
            raise BadInput(f"option {name} is unknown: {suggest_names(above, OPTIONS)}")
        argument = inner.partition(".")[0]
        is_new = option.startswith("+") and above != "timing" and argument not in entries.DECLARED
        if inner and argument not in known.get(above, [argument]) and not is_new:
            raise BadInput(
                f"option {name} is unknown to {_choose_name(above, options)}: {suggest_names(argument, known[above])}"
            )


def _find_changed_arguments(options: Sequence[str], values: Iterable[str], given: DictConfig) -> dict[str, Any]:
    """Return the arguments of the method that options set to other values than its yaml does, but seed and device."""
    names = {name for name in map(_get_option_name, (*options, *values)) if name.startswith("method.")}
    if not names:
        return {}
    own = _compose_config([option for option in options if _get_option_name(option) not in names], {})
    changed = OmegaConf.create()
    for name in sorted(names.difference(_SET_BY_RUN)):
        value = OmegaConf.select(given, name)
        if value != OmegaConf.select(own, name):
            OmegaConf.update(changed, name, value)
    return cast(dict[str, dict[str, Any]], OmegaConf.to_container(changed, resolve=True)).get("method", {})


def _get_option_name(option: str) -> str:
    return option.partition("=")[0].lstrip("+")


def _choose_name(group: str, options: Sequence[str]) -> str:
    """Return the name of the method, dataset or timing that options choose, the last one if there are several."""
    given = [option.partition("=")[2].strip("'\"") for option in options if option.startswith(f"{group}=")]
    return given[-1] if given else entries.find_default(cast(Folder, group))


def _quote_value(value: str) -> str:
    return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"
