"""One run of the command line, or a sweep of them: options -> the run, from the store or made now, and its words."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import textwrap
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from vprbench.errors import BadInput, NotThere, TrainingDivergedError, format_error, hide_home
from vprbench.jobs import job
from vprbench.jobs.child import run_job
from vprbench.jobs.job import JobResult
from vprbench.jobs.search import spread_over
from vprbench.jobs.sweep import as_json, divided, swept
from vprbench.plugins import registry
from vprbench.runs.compose import check_names, explained, in_order, readable
from vprbench.runs.settings import RECORDED, Settings, checked_settings, n_threads
from vprbench.storage.atomic import scratch
from vprbench.terminal.streams import complain, results_only_on_stdout
from vprbench.text import printable

if TYPE_CHECKING:
    from vprbench.api.dataset import Dataset
    from vprbench.runs.get_or_run import RunResult
    from vprbench.runs.store import Store


def run_or_sweep(arguments: list[str]) -> JobResult:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own."""
    registry.register_search_path()
    arguments = in_order(readable(arguments))
    sweep = any(text == "-m" or "multirun" in text.lower() for text in arguments)
    options, arguments = divided(arguments, sweep)
    check_names(arguments)
    results: list[JobResult] = []
    runs: list[list[str]] = []  # of a sweep, the options of each
    errors: list[Exception] = []

    @hydra.main(version_base="1.3", config_path="pkg://vprbench.conf", config_name="run")
    def task(config: DictConfig) -> None:
        try:
            if HydraConfig.get().mode == RunMode.MULTIRUN:
                runs.append(list(HydraConfig.get().overrides.task))
            else:
                results.append(make_run(config))
        except Exception as error:  # Hydra would print lines of its own; it is raised again below
            errors.append(error)

    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, and the command line explains
    kept = sys.argv
    with scratch() if sweep else contextlib.nullcontext() as folder:  # where Hydra leaves its notes on a sweep
        sys.argv = [kept[0], *arguments, *([f"hydra.sweep.dir={folder}"] if sweep else [])]
        try:
            task()
        except ValueError as error:  # of flags that do not go together, and of what is no name
            raise BadInput(explained(error, arguments)) from error
        finally:
            sys.argv = kept
    if errors:
        raise errors[0]
    return JobResult(swept(runs, options)) if runs else [*results, JobResult(0)][0]


def make_run(config: DictConfig) -> JobResult:
    """Run one configuration, or answer it from the store."""
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings = checked_settings(plain)
    choices, given = HydraConfig.get().runtime.choices, [*HydraConfig.get().overrides.task]
    registry.require_one("method", choices["method"])
    registry.require_one("dataset", choices["dataset"])
    recorded = {name: plain[name] for name in RECORDED}
    recorded["overrides"] = [registry.with_plugin_paths(option) for option in given]
    from vprbench.runs import machine
    from vprbench.runs.record import Failure
    from vprbench.runs.run_lock import HeldElsewhereError
    from vprbench.runs.store import Store

    store, threads = Store(Path(settings.results).expanduser()), n_threads(settings)
    failures = Store(store.root.absolute())  # a method may change the working folder

    def failed(error: str, missing: bool = False) -> Failure:
        dataset = recorded["dataset"].get("name", choices["dataset"])
        return Failure(
            choices["method"], dataset, recorded, error, machine.describe_machine(settings.device, threads), missing
        )

    as_job = job.current is not None
    if settings.limit_minutes is not None and not as_job:
        result = run_job(given)
        if result.code == 1 and not result.recorded:
            failures.try_to_save_failure(failed(result.error))
        print(result.printed, end="\n" * bool(result.printed))
        return result
    printed: list[str] = []
    with results_only_on_stdout() as say:
        say = printed.append if as_job else say  # the process that asked prints it
        try:
            with spread_over(settings.search_scheduler):
                key = _answer(choices["method"], recorded, settings, store, say)
                return JobResult(0, key=key, printed="\n".join(printed))
        except KeyboardInterrupt:
            raise
        except HeldElsewhereError as error:  # the process that asked asks again
            logging.info("%s: it is left to that", error)
            return JobResult(0, held=str(error.path))
        except BaseException as error:  # whatever a plug-in raises
            failure = failed(hide_home(format_error(error).splitlines()[0]), isinstance(error, NotThere))
            if isinstance(error, BadInput) and not as_job:
                raise
            failures.try_to_save_failure(failure)
            if settings.output == "json" and as_job:
                say(as_json(failure))
            message = f"{failure.method} failed: {failure.error}"
            if isinstance(error, BadInput):
                message = str(error).strip() or failure.error
            elif not isinstance(error, TrainingDivergedError):
                print(textwrap.indent(printable(traceback.format_exc(), but="\n"), "  "), file=sys.stderr)
            complain(message)
            code = 2 if isinstance(error, BadInput) else 1
            return JobResult(code, failure.missing, message, recorded=True, printed="\n".join(printed))


def _answer(method: str, recorded: dict[str, Any], settings: Settings, store: Store, say: Callable[[str], None]) -> str:
    """Say the run of a configuration, or one for each of its corruptions, and return the key of the last.

    A run is from the store or made now. `recorded` is its configuration. Raises what `get_or_run` raises.
    """
    from vprbench.runs.build_request import build_request, corrupted_request
    from vprbench.runs.get_or_run import UnstoredRunError, get_or_run

    key = ""
    request = build_request(method, recorded, settings, store)
    for name in settings.corruption if isinstance(settings.corruption, list) else [None]:
        if name is not None:
            clean = [option for option in recorded["overrides"] if not option.startswith("corruption=")]
            recorded |= {"corruption": name, "overrides": [*clean, f"corruption={name}"]}
        wanted = request if name is None else corrupted_request(request, name, recorded)
        try:
            result = get_or_run(wanted, settings, store, wait=job.current is None)
        except UnstoredRunError as error:
            from vprbench.runs.run_text import run_text  # what it imports does not count as the run's memory

            say(run_text(error.run, None, False, settings))
            raise
        from vprbench.runs.run_text import run_text

        files = _write_predictions(result, wanted.dataset, settings)
        say(run_text(result.run, result.folder, result.from_store, settings, files))
        key = result.run.key
    return key


def _write_predictions(result: RunResult, dataset: Dataset, settings: Settings) -> list[Path]:
    """Write the best places of each query, if asked for, of a run or of each of its views; returns the files."""
    from vprbench.runs.predictions import tabulate_predictions, write_csv
    from vprbench.runs.sequences import name_views, parse_views

    if settings.predictions is None:
        return []
    name = f"{dataset.name}-{result.folder.name}"
    shown = {name_views([view]): view(result.run) for view in parse_views(settings.sequence, settings.filter)}
    return [
        write_csv(
            tabulate_predictions(run, settings.predictions, dataset),
            Path(settings.results).expanduser() / f"{name}{ending}-predictions.csv",
        )
        for ending, run in (shown or {"": result.run}).items()
    ]
