"""The command line: one run, a sweep of runs, or one of the commands beside them."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
import signal
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench.commands import working
from vprbench.commands.at_once import COMMANDS, answered
from vprbench.errors import BadInput, ClusterLostError, NotThere, TrainingDivergedError
from vprbench.jobs import job
from vprbench.jobs.child import run_job
from vprbench.jobs.job import JobResult
from vprbench.jobs.sweep import as_json, divided, swept
from vprbench.plugins import registry
from vprbench.progress import answers_alone, log_to_stderr
from vprbench.runs.compose import check_names, explained, in_order, readable
from vprbench.runs.settings import KNOWN, RECORDED, Settings, checked_settings, n_threads
from vprbench.storage.atomic import scratch
from vprbench.text import near, printable

if TYPE_CHECKING:
    from vprbench.api.dataset import Dataset
    from vprbench.runs.get_or_run import RunResult
    from vprbench.runs.record import Failure
    from vprbench.runs.store import Store


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    return attempt(sys.argv[1:] if arguments is None else arguments).code


def attempt(given: Sequence[str]) -> JobResult:
    """Run the command line; returns the exit code and why it is not 0, which standard error says too."""
    log_to_stderr()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that knows no arrows shows something else
            stream.reconfigure(errors="replace")
    arguments = list(given)
    try:
        if (code := answered(arguments)) is not None:
            return JobResult(code)
        arguments = ["wide=true" if argument == "--wide" else argument for argument in arguments]
        registry.register_search_path()
        name = arguments[0] if re.fullmatch(r"\w[\w-]*", arguments[0]) else "run"
        if name not in COMMANDS:
            raise BadInput(
                f"{name} is no command: {near(name, COMMANDS)}" if name not in KNOWN else f"give {name}=value"
            )
        if name != "run":
            try:
                return JobResult(int(getattr(working, COMMANDS[name].does.partition(":")[2])(arguments[1:])))
            except SystemExit as error:  # of a plug-in; Hydra's goes on
                return _complain(_error_text(error), 1)
        return run_or_sweep(in_order(readable(arguments[arguments[0] == "run" :])))
    except BadInput as error:
        return _complain(str(error).strip() or "bad input, of which nothing is said")
    except (HydraException, OmegaConfBaseException) as error:
        return _complain(explained(error, arguments))
    except ClusterLostError as error:
        return _complain(str(error), 1)
    except BrokenPipeError:
        return _complain("standard output was closed before all was printed", 1)
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}")
    except KeyboardInterrupt as error:
        code = 128 + int((error.args or (signal.SIGINT,))[0])
        if job.current is not None:  # the process that asked says it
            return JobResult(code)
        return _complain("interrupted; what was finished before is kept: give the same command again", code)


def run_or_sweep(arguments: list[str]) -> JobResult:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own."""
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
                results.append(_run(config))
        except Exception as error:  # Hydra would print lines of its own; it is raised again below
            errors.append(error)

    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, and `main` explains
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


def _run(config: DictConfig) -> JobResult:
    """Run one configuration, or answer it from the store."""
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings = checked_settings(plain)
    choices, given = HydraConfig.get().runtime.choices, [*HydraConfig.get().overrides.task]
    registry.require_one("method", choices["method"])
    registry.require_one("dataset", choices["dataset"])
    recorded = {name: plain[name] for name in RECORDED}
    recorded["overrides"] = [registry.with_plugin_paths(option) for option in given]
    from vprbench.runs import machine
    from vprbench.runs.get_or_run import FailedElsewhereError
    from vprbench.runs.record import Failure
    from vprbench.runs.run_lock import HeldElsewhereError
    from vprbench.runs.store import Store

    store, threads = Store(Path(settings.results).expanduser()), n_threads(settings)
    failures = Store(store.root.absolute())  # a method may change the working folder

    def failed(error: str, missing: bool = False) -> Failure:
        dataset = recorded["dataset"].get("name", choices["dataset"])
        return Failure(choices["method"], dataset, recorded, error, machine.capture(settings.device, threads), missing)

    as_job = job.current is not None
    if settings.limit_minutes is not None and not as_job:
        result = run_job(given)
        if result.code == 1 and not result.recorded:
            failures.try_to_save_failure(failed(result.error))
        print(result.printed, end="\n" * bool(result.printed))
        return result
    printed: list[str] = []
    with answers_alone() as say:
        say = printed.append if as_job else say  # the process that asked prints it
        try:
            key = _answer(choices["method"], recorded, settings, store, say)
            return JobResult(0, key=key, printed="\n".join(printed))
        except KeyboardInterrupt:
            raise
        except HeldElsewhereError as error:  # the process that asked asks again
            logging.info("%s: it is left to that", error)
            return JobResult(0, held=str(error.path))
        except BaseException as error:  # whatever a plug-in raises
            elsewhere = error.failure if isinstance(error, FailedElsewhereError) else None
            failure = elsewhere or failed(_public(_error_text(error).splitlines()[0]), isinstance(error, NotThere))
            if isinstance(error, BadInput) and not as_job:
                raise
            if elsewhere is None:
                failures.try_to_save_failure(failure)
            if settings.output == "json" and as_job:
                say(as_json(failure))
            message = f"{failure.method} failed: {failure.error}"
            if isinstance(error, BadInput):
                message = str(error).strip() or failure.error
            elif elsewhere is not None:
                message = str(error)
            elif not isinstance(error, TrainingDivergedError):
                print(textwrap.indent(printable(traceback.format_exc(), but="\n"), "  "), file=sys.stderr)
            result = _complain(message, 2 if isinstance(error, BadInput) else 1, failure)
            return replace(result, printed="\n".join(printed))


def _answer(method: str, recorded: dict[str, Any], settings: Settings, store: Store, say: Callable[[str], None]) -> str:
    """Say the run of a configuration, or one for each of its corruptions, and return the key of the last.

    A run is from the store or made now. `recorded` is its configuration. Raises what `get_or_run` raises.
    """
    from vprbench.runs.build_request import build_request, corrupted_request
    from vprbench.runs.get_or_run import UnstoredRunError, get_or_run

    current, key = job.current, ""
    request = build_request(method, recorded, settings, store)
    for name in settings.corruption if isinstance(settings.corruption, list) else [None]:
        if name is not None:
            clean = [option for option in recorded["overrides"] if not option.startswith("corruption=")]
            recorded |= {"corruption": name, "overrides": [*clean, f"corruption={name}"]}
        wanted = request if name is None else corrupted_request(request, name, recorded)
        try:
            result = get_or_run(wanted, settings, store, current is None, None if current is None else current.since)
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
    from vprbench.runs.predictions import predictions, write_csv
    from vprbench.runs.sequences import suffix, views

    if settings.predictions is None:
        return []
    name = f"{dataset.name}-{result.folder.name}"
    shown = {suffix([view]): view(result.run) for view in views(settings.sequence, settings.filter)}
    return [
        write_csv(
            predictions(run, settings.predictions, dataset),
            Path(settings.results).expanduser() / f"{name}{ending}-predictions.csv",
        )
        for ending, run in (shown or {"": result.run}).items()
    ]


def _error_text(error: BaseException) -> str:
    """Return an error in words, whatever a plug-in has made of it."""
    if isinstance(error, SystemExit):
        return f"SystemExit: the method or dataset ended the program, with exit code {error.code or 0}"
    try:
        text = str(error)
    except Exception as unsaid:  # a plug-in's error may fail to say what it is
        text = f"(its text fails: {type(unsaid).__name__})"
    return (text if isinstance(error, BadInput) else f"{type(error).__name__}: {text}") or type(error).__name__


def _public(text: str) -> str:
    """Return an error without the name of a person's home, for it may be printed in a table."""
    home = os.path.expanduser("~")  # noqa: PTH111 - which leaves it as it is where nobody knows the home
    return text if home in ("~", "/", "") else text.replace(home, "~")


def _complain(message: str, code: int = 2, stored: Failure | None = None) -> JobResult:
    """Say why the exit code is not 0; `stored` is the failure that the store knows of."""
    with contextlib.suppress(OSError):  # nobody may be there to read it
        print(printable(f"vprbench: {message}"), file=sys.stderr, flush=True)
    return JobResult(code, stored is not None and stored.missing, message, recorded=stored is not None)
