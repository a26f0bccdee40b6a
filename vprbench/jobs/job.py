"""One run made from start to end, and its outcome as plain values."""

from __future__ import annotations

import logging
import sys
import textwrap
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vprbench.errors import BadInput, MissingData, TrainingDivergedError, format_error, hide_home
from vprbench.plugins.registry import locate_error
from vprbench.runs.record import Failure
from vprbench.runs.request import RunRequest
from vprbench.terminal.streams import complain
from vprbench.text import escape_unprintable

if TYPE_CHECKING:
    from vprbench.runs.timing_lock import TimingLock


@dataclass(frozen=True)
class JobResult:
    """The outcome of a run."""

    code: int  # 0: the run is stored; 1: it failed; 2: its input has to be mended
    failure: Failure | None = None
    key: str = ""  # of the run that is stored
    printed: str = ""  # the row or JSON of the run
    lock: str = ""  # of another process that makes the run now: try again once the lock is free
    lines: list[str] = field(default_factory=list)  # of standard error, unless they were heard before

    @property
    def missing(self) -> bool:
        """Whether the run failed because its method, weights or frames are not there."""
        return self.failure is not None and self.failure.missing


def make_run(request: RunRequest, say: Callable[[str], None], lock: TimingLock | None = None) -> JobResult:
    """Make a run, or find it stored, and say its row or JSON; an error is one line on standard error, and returned.

    With a `lock`, by which this process computes, a run that another process makes is left to that: without one this
    process waits for it. Raises KeyboardInterrupt alone.
    """
    from vprbench.runs.machine import describe_machine
    from vprbench.runs.run_lock import HeldElsewhereError

    try:
        return JobResult(0, key=_get_or_make_run_key(request, say, lock))
    except HeldElsewhereError as error:
        logging.info("%s: it is left to that", error)
        return JobResult(0, lock=str(error.path))
    except KeyboardInterrupt:
        raise
    except BadInput as error:
        code, words, trace, is_missing = 2, format_error(error), "", isinstance(error, MissingData)
        complain(words)
    except BaseException as error:  # whatever a plug-in raises
        trace = hide_home(escape_unprintable(traceback.format_exc(), but="\n"))
        code, words, is_missing = 1, hide_home(format_error(error).splitlines()[0]), False
        if request.debug:
            print(textwrap.indent(trace, "  "), file=sys.stderr)
        hint = "" if request.debug or isinstance(error, TrainingDivergedError) else "; debug=true shows the traceback"
        complain(f"{request.method_name} failed: {words}{locate_error(error)}{hint}")
    environment = describe_machine(request.device, request.n_threads)
    return JobResult(code, describe_failure(request, words, is_missing, trace, environment))


def _get_or_make_run_key(request: RunRequest, say: Callable[[str], None], lock: TimingLock | None) -> str:
    """Make the run of a request, or one for each of its corruptions, and return the key of the last."""
    from vprbench.runs.experiment import build_experiment, corrupt_experiment
    from vprbench.runs.get_or_run import UnstoredRunError, get_or_run
    from vprbench.runs.predictions import write_predictions
    from vprbench.runs.store import Store

    store, key = Store(Path(request.results).expanduser()), ""
    clean = build_experiment(request)
    for name in request.corruption if isinstance(request.corruption, list) else [None]:
        experiment = clean if name is None else corrupt_experiment(clean, name)
        try:
            result = get_or_run(experiment, store, lock)
        except UnstoredRunError as error:
            from vprbench.runs.run_text import format_run  # what it imports does not count as the run's memory

            say(format_run(error.run, None, False, request))
            raise
        from vprbench.runs.run_text import format_run

        files = write_predictions(result.run, result.folder.name, request, experiment.dataset)
        say(format_run(result.run, result.folder, result.from_store, request, files))
        key = result.run.key
    return key


def describe_failure(
    request: RunRequest,
    error: str,
    missing: bool = False,
    traceback: str = "",
    environment: Mapping[str, Any] | None = None,
) -> Failure:
    """Return the record of a run that gave no result; `environment` is the run's machine, this one if None."""
    from vprbench.runs.machine import describe_machine

    reason, config = hide_home(error.partition("\n")[0]), request.record()
    environment = environment or describe_machine("cpu", 1)
    return Failure(request.method_name, request.dataset_name, config, reason, environment, missing, traceback)
