"""The command line: one run, a sweep, the table, the list of plug-ins and the conformance check."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import vprbench
from vprbench import registry
from vprbench.interface import BadInput, TrainingDivergedError
from vprbench.options import KNOWN, Settings, checked_settings, n_threads
from vprbench.stopwatch import Protocol

if TYPE_CHECKING:
    from vprbench.records import Failure, Run, Store

_IN_SWEEP = "VPRBENCH_IN_SWEEP"  # set for the runs of a sweep: they record even a failure that is the user's

_USAGE = """\
vprbench - which method of Visual Place Recognition is better, how fast it is, and how sure that is

python -m vprbench method=NAME dataset=NAME [option=value ...]   run one method on one dataset
python -m vprbench -m method=NAME,NAME dataset=NAME,NAME ...     run all combinations, each in its own process
python -m vprbench table [option=value ...]                      run the rows of the table, write table.md and .csv
python -m vprbench list                                          show the methods and datasets
python -m vprbench check method=NAME [method.option=value ...]   test a method against the contract

Options of a run: seed, device, threads, results, force, output=json, depth, timing.minimum_seconds, save, load, ...
and those of the chosen method and dataset: method.OPTION, dataset.OPTION. Show all: python -m vprbench --cfg job
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    commands: dict[str, Callable[[list[str]], int]] = {"list": _list, "check": _check, "table": _table}
    try:
        if arguments and arguments[0] in ("--help", "-h", "help"):
            print(_USAGE, end="")
            return 0
        registry.register_search_path()
        if arguments and arguments[0] in commands:
            if "--help" in arguments or "-h" in arguments:
                print(_USAGE, end="")
                return 0
            return commands[arguments[0]](_readable(arguments[1:]))
        if arguments and re.fullmatch(r"\w+", arguments[0]):
            raise BadInput(f"{arguments[0]} is no command: {registry.near(arguments[0], commands)}")
        return _run_or_sweep(_readable(arguments))
    except BadInput as error:
        return _complain(str(error))
    except (HydraException, OmegaConfBaseException) as error:
        return _complain(_explained(error, arguments))
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        return _complain("interrupted; nothing was stored", 128 + signal.SIGINT)


def _run_or_sweep(arguments: list[str]) -> int:
    """Let Hydra compose the configuration, then run it, or each of its combinations in a process of its own."""
    _check_names(arguments)
    codes: list[int] = []
    errors: list[Exception] = []

    @hydra.main(version_base="1.3", config_path="pkg://vprbench.conf", config_name="run")
    def task(config: DictConfig) -> None:
        try:
            sweeping = HydraConfig.get().mode == RunMode.MULTIRUN
            codes.append(_run_in_process(HydraConfig.get().overrides.task) if sweeping else _run(config))
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


def _run(config: DictConfig) -> int:
    """Run one configuration, or answer it from the store."""
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings = checked_settings(plain)
    choices = HydraConfig.get().runtime.choices
    asked = {name: plain[name] for name in ("method", "dataset", "seed", "device", "depth", "load")}
    asked["overrides"] = list(HydraConfig.get().overrides.task)
    from vprbench.records import Failure, Store

    store = Store(Path(settings.results).expanduser())
    try:
        return _answer(choices["method"], asked, settings, store)
    except Exception as error:
        text = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
        failure = Failure(
            choices["method"], asked["dataset"].get("name", choices["dataset"]), asked, text.splitlines()[0]
        )
        if os.environ.get(_IN_SWEEP):
            _record(failure, store, settings.output)
        if isinstance(error, BadInput):
            raise
        if not isinstance(error, TrainingDivergedError):
            traceback.print_exc()
        if not os.environ.get(_IN_SWEEP):
            _record(failure, store, "row")
        return _complain(f"{failure.method} failed: {failure.error}", 1)


def _record(failure: Failure, store: Store, output: str) -> None:
    """Store a failure; in a sweep that reads JSON, say it there too."""
    with contextlib.suppress(OSError, BadInput):  # the error itself is told in any case
        store.root.mkdir(parents=True, exist_ok=True)
        store.save_failure(failure)
    if output == "json":
        print(json.dumps({"method": failure.method, "dataset": failure.dataset, "error": failure.error}))


def _answer(name: str, asked: dict[str, Any], settings: Settings, store: Store) -> int:
    """Find the run in the store or make it, and print it."""
    from vprbench import environment, networks, runner
    from vprbench.console import progress_shown

    threads = n_threads(settings)
    store.prepare()
    environment.pin_threads(threads)
    files = networks.chosen_files(settings.save, settings.load, settings.force)
    method = registry.make_method(asked["method"])
    dataset = registry.make_dataset(asked["dataset"])
    fingerprint = runner.fingerprint(dataset)
    key = runner.run_key(method, asked, dataset, fingerprint, settings.timing, threads, files.sha256)
    run = None if settings.force else store.find(dataset.name, name, key)
    if run is not None and files.save is not None and networks.made_by(files.save) != key:
        logging.info("%s is stored without its network: running again for save=%s", run.method, files.save)
        run = None
    from_store = run is not None
    if run is not None:  # whoever stored it may have asked in other words
        run = dataclasses.replace(run, config={**run.config, "overrides": asked["overrides"]})
    else:
        with progress_shown(f"{name} on {dataset.name}"):
            run = runner.run(name, method, dataset, asked, key, fingerprint, settings.timing, threads, files)
    try:
        folder = store.folder(dataset.name, name, key) if from_store else store.save(run)
    except BadInput:
        _print(run, None, from_store, settings.output)  # what was measured is shown even where it cannot be kept
        raise
    _print(run, folder, from_store, settings.output)
    return 0


def _print(run: Run, folder: Path | None, from_store: bool, output: str) -> None:
    from vprbench import tables

    if output == "json":
        print(
            json.dumps(
                {
                    "method": run.method,
                    "dataset": run.dataset,
                    **tables.numbers(run),
                    "network": run.network,
                    "notes": list(run.notes),
                    "from_store": from_store,
                    "run_folder": None if folder is None else str(folder),
                },
                allow_nan=False,
            )
        )
        return
    print(tables.protocol_line(run))
    print(tables.plain_row(tables.readable_row(run)))
    for note in run.notes:
        print(f"note: {note}")
    if from_store:
        print(f"from the store: {folder} (force=true runs again)")
    elif folder is not None:
        print(f"stored in {folder}")


def _run_in_process(overrides: Sequence[str]) -> int:
    """Run one configuration of a sweep in a process of its own, so that nothing of it can reach the next."""
    return _child(overrides).returncode


def _child(overrides: Sequence[str], stdout: int | None = None) -> subprocess.CompletedProcess[str]:
    home = str(Path(vprbench.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-m", "vprbench", *overrides],
        env={**os.environ, _IN_SWEEP: "1", "PYTHONPATH": path},
        stdout=stdout,
        text=True,
        check=False,
    )


def _table(options: list[str]) -> int:
    """Run the rows of conf/table.yaml, each in a process of its own, and write the table."""
    from vprbench import tables
    from vprbench.records import Failure, replace_text

    _check_names(options)
    if any(option.split("=")[0] in ("output", "method", "save", "load") for option in options):
        raise BadInput("the table chooses method, output, save and load itself: change conf/table.yaml for other rows")
    settings = checked_settings(_composed(options))
    results = Path(settings.results).expanduser()
    rows = yaml.safe_load((registry.conf_folders()["vprbench"] / "table.yaml").read_text(encoding="utf-8"))["rows"]
    outcomes, codes = zip(*(_table_cell(row, [*options, "output=json"]) for row in rows), strict=True)
    if set(codes) == {2}:
        return 2  # what no row can run with is no result, and the old table stays
    text = tables.table_text(outcomes)
    results.mkdir(parents=True, exist_ok=True)
    for name, content in (("table.md", text), ("table.csv", tables.csv(outcomes))):
        replace_text(results / name, content)
    print(text, end="")
    print(f"\nwritten to {results / 'table.md'} and {results / 'table.csv'}")
    return 1 if any(isinstance(outcome, Failure) for outcome in outcomes) else 0


def _table_cell(row: Sequence[str], options: Sequence[str]) -> tuple[Run | Failure, int]:
    """Run one row of the table, or find it in the store, and return it with the exit code; a failure is a row too."""
    from vprbench.records import Failure, load

    child = _child([*row, *options], stdout=subprocess.PIPE)
    answer = json.loads(child.stdout) if child.stdout.strip().startswith("{") else {}
    if child.returncode == 0:
        run = load(Path(answer["run_folder"]))
        return dataclasses.replace(run, config={**run.config, "overrides": list(row)}), 0
    name = next(option.split("=", 1)[1] for option in row if option.startswith("method="))
    ending = f"ended by signal {-child.returncode}" if child.returncode < 0 else "the message is above"
    error = answer.get("error", ending)
    return Failure(name, answer.get("dataset", ""), {"overrides": list(row)}, error), child.returncode


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

    if not any(option.startswith("method=") for option in options):
        raise BadInput(f"check needs method=NAME; {registry.near('', registry.entries('method'))}")
    _check_names(options)
    config = _composed(options)
    environment.pin_threads(n_threads(checked_settings(config)))
    asked = {option.split("=")[0].removeprefix("method.") for option in options}
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
