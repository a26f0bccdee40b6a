"""The command line: one run, a sweep, the table and what goes with it, the list of plug-ins, checks and benchmarks."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import logging
import os
import re
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench import registry
from vprbench.interface import BadInput, Method, NotThere, TrainingDivergedError
from vprbench.options import KNOWN, checked_settings, n_threads
from vprbench.stopwatch import Protocol

if TYPE_CHECKING:
    from vprbench.paper import Asked, Compose
    from vprbench.records import Failure, Store

_USAGE = """\
vprbench - which method of Visual Place Recognition is better, how fast it is, and how sure that is

python -m vprbench method=NAME dataset=NAME [option=value ...]   run one method on one dataset
python -m vprbench -m method=NAME,NAME dataset=NAME,NAME ...     run all combinations, each in its own process
python -m vprbench table [option=value ...]                      Table II: make what it lacks, write table.md, csv, tex
python -m vprbench figures [option=value ...]                    the paper's figures, as PDF and PNG in results/figures
python -m vprbench report [option=value ...]                     one page with table, figures and a browser of failures
python -m vprbench search [option=value ...]                     search VPRTempo's parameters on places of no result
python -m vprbench list                                          show the methods and datasets
python -m vprbench check method=NAME [method.option=value ...]   test a method against the contract
python -m vprbench bench [option=value ...]                      measure the speed here, write bench.md and .json
python -m vprbench bench-descriptors [option=value ...]          measure how fast descriptors are, write descriptors.md
python -m vprbench gpu-check [option=value ...]                  compare a GPU with the CPU, write gpu.md

Options of a run: seed, device, threads, results, force, output=json, depth, timing.minimum_seconds, save, load, ...
and those of the chosen method and dataset: method.OPTION, dataset.OPTION. Show all: python -m vprbench --cfg job
Options of table, figures and report: rows, methods, columns, seeds, devices, full, stored, stores, nordland, robotcar,
name, results, and those of a run that are not the table's to choose: threads, timing.minimum_seconds, force, ...
Options of search: places, trials, jobs, seed, dataset, root, results
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that knows no arrows shows something else
            stream.reconfigure(errors="replace")
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    commands: dict[str, Callable[[list[str]], int]] = {
        "list": _list,
        "check": _check,
        "table": _table,
        "figures": _figures,
        "report": _report,
        "search": _search,
        "bench": _bench,
        "bench-descriptors": _bench_descriptors,
        "gpu-check": _gpu_check,
    }
    try:
        if arguments and arguments[0] in ("--help", "-h", "help"):
            print(_USAGE, end="")
            return 0
        registry.register_search_path()
        if arguments and arguments[0] in commands:
            if "--help" in arguments or "-h" in arguments:
                print(_USAGE, end="")
                return 0
            return commands[arguments[0]](arguments[1:])
        if arguments and re.fullmatch(r"\w[\w-]*", arguments[0]):
            raise BadInput(f"{arguments[0]} is no command: {registry.near(arguments[0], commands)}")
        return _run_or_sweep(_readable(arguments))
    except BadInput as error:
        return _complain(str(error))
    except (HydraException, OmegaConfBaseException) as error:
        return _complain(_explained(error, arguments))
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        reason = "interrupted; what was finished before is kept: give the same command again"
        return _complain(reason, 128 + signal.SIGINT)


def _run_or_sweep(arguments: list[str]) -> int:
    """Let Hydra compose the configuration, then run it, or each of its combinations in a process of its own."""
    _check_names(arguments)
    codes: list[int] = []
    errors: list[Exception] = []

    @hydra.main(version_base="1.3", config_path="pkg://vprbench.conf", config_name="run")
    def task(config: DictConfig) -> None:
        try:
            sweeping = HydraConfig.get().mode == RunMode.MULTIRUN
            codes.append(_run_apart() if sweeping else _run(config))
        except Exception as error:  # Hydra would print lines of its own; it is raised again below
            errors.append(error)

    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, and `main` explains
    kept = sys.argv
    sys.argv = [kept[0], *arguments]
    with tempfile.TemporaryDirectory() as scratch:  # where Hydra leaves its notes on a sweep
        sys.argv += [f"hydra.sweep.dir={scratch}"]
        try:
            task()
        finally:
            sys.argv = kept
    if errors:
        raise errors[0]
    return max(codes, default=0)


def _run_apart() -> int:
    """Run one configuration of a sweep in a process of its own."""
    from vprbench.sweep import run_apart

    return run_apart(HydraConfig.get().overrides.task).returncode


def _run(config: DictConfig) -> int:
    """Run one configuration, or answer it from the store."""
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings = checked_settings(plain)
    choices = HydraConfig.get().runtime.choices
    asked = {name: plain[name] for name in ("method", "dataset", "seed", "device", "depth", "load")}
    asked["overrides"] = list(HydraConfig.get().overrides.task)
    from vprbench import environment
    from vprbench.answer import answer
    from vprbench.records import Failure, Store

    store = Store(Path(settings.results).expanduser())
    try:
        return answer(choices["method"], asked, settings, store)
    except Exception as error:
        from vprbench.sweep import IN_SWEEP

        text = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
        failure = Failure(
            choices["method"],
            asked["dataset"].get("name", choices["dataset"]),
            asked,
            _public(text.splitlines()[0]),
            environment.capture(settings.device, n_threads(settings)),
            isinstance(error, NotThere),
        )
        if os.environ.get(IN_SWEEP):
            _record(failure, store, settings.output)
        if isinstance(error, BadInput):
            raise
        if not isinstance(error, TrainingDivergedError):
            traceback.print_exc()
        if not os.environ.get(IN_SWEEP):
            _record(failure, store, "row")
        return _complain(f"{failure.method} failed: {failure.error}", 1)


def _public(text: str) -> str:
    """Return an error without the name of a person's home, for it may be printed in a table."""
    return text.replace(str(Path.home()), "~")


def _record(failure: Failure, store: Store, output: str) -> None:
    """Store a failure; in a sweep that reads JSON, say it there too."""
    with contextlib.suppress(OSError, BadInput):  # the error itself is told in any case
        store.root.mkdir(parents=True, exist_ok=True)
        store.save_failure(failure)
    if output == "json":
        told = ("method", "dataset", "error", "missing")
        print(json.dumps({name: getattr(failure, name) for name in told}))


def _table(options: list[str]) -> int:
    """Make what Table II lacks, and write it."""
    from vprbench.paper_table import make_table

    return make_table(*_asked(options))


def _figures(options: list[str]) -> int:
    """Make what the figures lack, and draw them."""
    from vprbench.paper_figures import make_figures

    return make_figures(*_asked(options))


def _report(options: list[str]) -> int:
    """Make what the table lacks, and write the page."""
    from vprbench.paper_report import make_report

    return make_report(*_asked(options))


def _asked(options: list[str]) -> tuple[Asked, list[str], Compose]:
    """Return which rows and columns are asked for, the options of their runs, and what resolves those of a dataset."""
    from vprbench.bench_report import chosen
    from vprbench.paper import Asked

    own = [option for option in options if option.partition("=")[0] in Asked.__dataclass_fields__]
    rest = _readable([option for option in options if option not in own])
    for option in rest:
        if option.split("=")[0].split(".")[0] in ("method", "dataset", "seed", "device", "output", "save", "load"):
            raise BadInput(
                f"{option}: rows, methods, columns, seeds and devices say what the table holds; "
                "conf/table.yaml has what they are"
            )
    asked = chosen(Asked, own, {})
    checked_settings(_composed(_readable([*rest, f"results={asked.results}"])))
    return asked, rest, lambda more: _composed(_readable(list(more)))


def _search(options: list[str]) -> int:
    """Search the best hyperparameters of VPRTempo on places that no result uses, and write them."""
    from vprbench.bench_report import chosen
    from vprbench.console import progress_shown
    from vprbench.records import Store
    from vprbench.tuning import search, text

    settings = chosen(search.Settings, options, search.QUICK)
    _check_names([f"dataset={settings.dataset}"])
    root = [] if settings.root is None else [f"dataset.root={settings.root}"]
    config = _composed(_readable(["method=vprtempo", f"dataset={settings.dataset}", *root]))
    folder = Path(settings.results).expanduser()
    Store(folder).prepare()
    with progress_shown("search"):
        found = search.search(settings, config["method"], config["dataset"])
    print(text.write(found, folder), end="")
    return 0


def _bench(options: list[str]) -> int:
    """Measure how fast training, preprocessing and queries are, and write the numbers."""
    from vprbench import bench, bench_text
    from vprbench.bench_report import QUICK, Settings, chosen

    settings = chosen(Settings, options, QUICK)
    with _prepared("bench", settings.device, settings.threads, settings.results, settings.seed) as results:
        report = bench.measure(settings, _maker(settings.seed))
    bench_text.write(report, results)
    return 1 if report.failures else 0


def _bench_descriptors(options: list[str]) -> int:
    """Measure how fast each method describes frames and searches, and write the numbers."""
    from vprbench import descriptor_bench
    from vprbench.bench_report import chosen

    settings = chosen(descriptor_bench.Settings, options, descriptor_bench.QUICK)
    _check_names([f"method={','.join(settings.methods)}"])
    title = "bench-descriptors"
    with _prepared(title, settings.devices[-1], settings.threads, settings.results, settings.seed) as results:
        report = descriptor_bench.measure(settings, _maker(settings.seed))
    descriptor_bench.write(report, results)
    return 1 if report.failures else 0


def _gpu_check(options: list[str]) -> int:
    """Compare the GPU with the CPU, time it, and write both."""
    from vprbench import gpu_check
    from vprbench.bench_report import chosen

    settings = chosen(gpu_check.Settings, options, gpu_check.QUICK)
    gpu_check.require_gpu(settings.device)
    with _prepared("gpu-check", settings.device, settings.threads, settings.results, settings.seed) as results:
        report = gpu_check.measure(settings, _maker(settings.seed))
    gpu_check.write(report, results)
    return 0 if report.correct else 1


@contextlib.contextmanager
def _prepared(title: str, device: str, threads: int | None, results: str, seed: int) -> Iterator[Path]:
    """Check what all commands share, pin the threads and show the progress; yields the results folder."""
    from vprbench import environment
    from vprbench.console import progress_shown
    from vprbench.records import Store

    run = {**_composed([]), "method": {}, "device": device, "threads": threads, "results": results, "seed": seed}
    settings = checked_settings(run)
    folder = Path(settings.results).expanduser()
    Store(folder).prepare()
    environment.pin_threads(n_threads(settings))
    with progress_shown(title):
        yield folder


def _maker(seed: int) -> Callable[..., Method]:
    """Return what builds a method by its name for a device, with arguments that replace those of its yaml."""

    @functools.cache
    def config(name: str, device: str) -> dict[str, Any]:
        return cast(dict[str, Any], _composed([f"method={name}", f"device={device}", f"seed={seed}"])["method"])

    def make(name: str, device: str, **arguments: Any) -> Method:
        return registry.make_method({**config(name, device), **arguments})

    return make


def _list(options: list[str]) -> int:
    """Show the methods and datasets with a line each, broken ones with their reason."""
    if options:
        raise BadInput(f"list takes no options, but {' '.join(options)} came")
    groups: tuple[registry.Group, ...] = ("method", "dataset")
    for group in groups:
        print(f"{group}s")
        known = registry.entries(group)
        width = max(map(len, known))
        for name, entry in known.items():
            try:
                entry.target()
                line = entry.description
            except BadInput as error:
                line = f"BROKEN: {error}"
            origin = "" if entry.provider == "vprbench" else f"  [{entry.provider}]"
            print(f"  {name:<{width}}  {line}{origin}")
    for provider, reason in registry.broken_plugins().items():
        print(f"plug-in {provider} BROKEN: {reason}")
    return 0


def _check(options: list[str]) -> int:
    """Test a method against the rules of the contract and count them."""
    from vprbench import conformance, environment
    from vprbench.console import progress_shown

    if not any(option.startswith("method=") for option in options):
        raise BadInput(f"check needs method=NAME; {registry.near('', registry.entries('method'))}")
    _check_names(options)
    options = _readable(options)
    config = _composed(options)
    environment.pin_threads(n_threads(checked_settings(config)))
    asked = {option.split("=")[0].removeprefix("method.") for option in options}
    with progress_shown(config["method"]["_target_"].rpartition(".")[2]):  # a file may have to be downloaded
        results = list(conformance.check(config["method"], asked))
    for result in results:
        print(result)
    kept, excepted, broken = (sum(r.state == state for r in results) for state in ("kept", "excepted", "broken"))
    print(f"{len(results)} rules: {kept} kept, {excepted} excepted, {broken} broken")
    return 1 if broken else 0


def _composed(options: Sequence[str]) -> dict[str, Any]:
    """Return the configuration of a run with these options, as plain values."""
    for option in options:
        if option.startswith("-"):
            raise BadInput(f"{option} is no option here: see python -m vprbench --help")
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        return cast(dict[str, Any], OmegaConf.to_container(hydra.compose("run", overrides=list(options)), resolve=True))


def _readable(arguments: Sequence[str]) -> list[str]:
    """Put quotes around values, such as paths with letters from abroad, that Hydra's grammar cannot read bare."""
    readable = []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and not argument.startswith("-"):
            try:
                OverridesParser.create().parse_override(argument)
            except HydraException:
                argument = f"{key}='" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"
        readable.append(argument)
    return readable


def _check_names(arguments: Sequence[str]) -> None:
    """Raise BadInput for a method or dataset that does not exist, with the near names."""
    groups: tuple[registry.Group, ...] = ("method", "dataset")
    for group in groups:
        known = registry.entries(group)
        for argument in arguments:
            if argument.startswith(f"{group}=") and re.fullmatch(r"[\w,.-]*", argument.split("=", 1)[1]):
                for name in argument.split("=", 1)[1].split(","):
                    if name not in known:
                        raise BadInput(f"{group}={name} is unknown: {registry.near(name, known)}")


def _explained(error: Exception, arguments: Sequence[str]) -> str:
    """Turn an error of Hydra into one line that names the option and what to do."""
    text = " ".join(str(error).split())
    option = re.match(r"Could not override '([^']+)'", text) or re.match(r"Key '([^']+)' is not in struct", text)
    if option is None:
        return text
    path = option.group(1)
    group, _, name = path.partition(".")
    if group in ("method", "dataset") and name:
        return _unfit("method" if group == "method" else "dataset", name, arguments)
    if group == "timing" and name:
        return f"option {path} is unknown: {registry.near(name, Protocol.__dataclass_fields__)}"
    return f"option {path} is unknown: {registry.near(path, KNOWN)}"


def _unfit(group: registry.Group, option: str, arguments: Sequence[str]) -> str:
    """Say which of the chosen methods or datasets lacks an option, and what it has."""
    given = next((a.split("=", 1)[1] for a in arguments if a.startswith(f"{group}=")), "")
    entries = registry.entries(group)
    for chosen in given.strip("'\"").split(",") if given else [{"method": "sad", "dataset": "synthetic"}[group]]:
        known = entries[chosen].options if chosen in entries else []
        if option.split(".")[0] not in known:
            return f"option {group}.{option} is unknown to {chosen}: {registry.near(option, known)}"
    return f"option {group}.{option} is unknown"


def _complain(message: str, code: int = 2) -> int:
    print(f"vprbench: {message}", file=sys.stderr)
    return code
