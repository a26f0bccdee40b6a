"""The command line: one run, a sweep of runs, or one of the commands beside them."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import re
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vprbench import registry
from vprbench.commands import COMMANDS
from vprbench.composing import check_names, explained, readable
from vprbench.interface import BadInput, NotThere, TrainingDivergedError
from vprbench.options import checked_settings, n_threads
from vprbench.replacing import PARTIAL, remove_leftovers

if TYPE_CHECKING:
    from vprbench.records import Failure
    from vprbench.store import Store

_SWEEP = "-vprbench-sweep"  # how the names of temporary folders end

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
python -m vprbench fetch [NAME] [parts=[...]] [root=FOLDER]      download a dataset, or say how to get it
python -m vprbench doctor dataset=NAME [dataset.option=value]    look at every frame, say what is wrong and what to do
python -m vprbench bench [option=value ...]                      measure the speed here, write bench.md and .json
python -m vprbench bench-descriptors [option=value ...]          measure how fast descriptors are, write descriptors.md
python -m vprbench gpu-check [option=value ...]                  compare a GPU with the CPU, write gpu.md

Options of a run: seed, device, threads, results, force, output=json, depth, timing.minimum_seconds, save, load, ...
and those of the chosen method and dataset: method.OPTION, dataset.OPTION. Show all: python -m vprbench --cfg job
Options of table, figures and report: rows, methods, columns, seeds, devices, full, stored, stores, nordland, robotcar,
name, results, and those of a run that are not the table's to choose: threads, timing.minimum_seconds, force, ...
Options of search: places, trials, jobs, seed, dataset, root, results
Options of fetch: parts, root, keep_archives; of doctor: those of the dataset, output=json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that knows no arrows shows something else
            stream.reconfigure(errors="replace")
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if arguments[:1] == ["help"] or {"--help", "-h"} & {*arguments}:
            print(_USAGE, end="")
            return 0
        registry.register_search_path()
        if arguments and arguments[0] in COMMANDS:
            return COMMANDS[arguments[0]](arguments[1:])
        if arguments and re.fullmatch(r"\w[\w-]*", arguments[0]):
            raise BadInput(f"{arguments[0]} is no command: {registry.near(arguments[0], COMMANDS)}")
        return _run_or_sweep(readable(arguments))
    except BadInput as error:
        return _complain(str(error))
    except (HydraException, OmegaConfBaseException) as error:
        return _complain(explained(error, arguments))
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        reason = "interrupted; what was finished before is kept: give the same command again"
        return _complain(reason, 128 + signal.SIGINT)


def _run_or_sweep(arguments: list[str]) -> int:
    """Let Hydra compose the configuration, then run it, or each of its combinations in a process of its own."""
    check_names(arguments)
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
    with _scratch(arguments) as options:
        sys.argv += options
        try:
            task()
        finally:
            sys.argv = kept
    if errors:
        raise errors[0]
    return max(codes, default=0)


@contextlib.contextmanager
def _scratch(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Yield the options by which Hydra leaves its notes on a sweep in a folder that is removed; none for one run."""
    if not any(text == "-m" or "multirun" in text.lower() for text in arguments):
        yield []
        return
    remove_leftovers(Path(tempfile.gettempdir()), _SWEEP)
    with tempfile.TemporaryDirectory(prefix=PARTIAL, suffix=_SWEEP, ignore_cleanup_errors=True) as scratch:
        yield [f"hydra.sweep.dir={scratch}"]


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
    from vprbench.records import Failure
    from vprbench.store import Store

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


def _complain(message: str, code: int = 2) -> int:
    print(f"vprbench: {message}", file=sys.stderr)
    return code
