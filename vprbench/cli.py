"""The command line: a run, a sweep of runs, or a command beside them; errors become words and exit codes."""

from __future__ import annotations

import io
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from vprbench import config
from vprbench.commands import working
from vprbench.commands.at_once import COMMANDS, answered
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs.child import run_in_child
from vprbench.jobs.job import JobResult, complain, describe_error, failure_of, make_run
from vprbench.jobs.options import ClusterOptions
from vprbench.jobs.sweep import run_sweep
from vprbench.plugins.options import chosen
from vprbench.progress import answers_alone, log_to_stderr
from vprbench.runs.request import OPTIONS, RunRequest
from vprbench.text import near


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    log_to_stderr()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that knows no arrows shows something else
            stream.reconfigure(errors="replace")
    try:
        return _run_command(list(sys.argv[1:] if arguments is None else arguments))
    except BadInput as error:
        code, message = 2, str(error).strip() or "invalid input; the plug-in gave no reason"
    except ClusterLostError as error:
        code, message = 1, str(error)
    except BrokenPipeError:
        code, message = 1, "standard output was closed before all was printed"
    except OSError as error:
        code, message = 2, f"{error.filename or 'a file'}: {error.strerror or error}"
    except KeyboardInterrupt as error:
        code = 128 + int((error.args or (signal.SIGINT,))[0])
        message = "interrupted; what was finished before is kept: give the same command again"
    complain(message)
    return code


def run_or_sweep(arguments: Sequence[str]) -> int:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own."""
    flags = [argument for argument in arguments if argument.startswith("-")]
    options = [argument for argument in arguments if not argument.startswith("-")]
    shown = "--cfg" in flags
    if shown:
        if "job" not in options:
            raise BadInput("--cfg: give --cfg job, which shows the configuration of a run")
        options.remove("job")
        flags.remove("--cfg")
    sweep = bool({"-m", "--multirun"} & {*flags})
    if unknown := [flag for flag in flags if flag not in ("-m", "--multirun")]:
        raise BadInput(f"no options here: {', '.join(unknown)}; see python -m vprbench --help")
    if shown and sweep:
        raise BadInput("--cfg shows one run: leave --multirun out")
    if shown:
        print(config.show_config(options), end="")
        return 0
    if sweep and not options:
        raise BadInput("-m: say what to run, as in method=sad,pca seed=0,1,2")
    own = [option for option in options if ClusterOptions.has(option)]
    if own and not sweep:
        raise BadInput(f"{own[0]}: a single run is made here: give -m for several, or compare, table, figures, report")
    cluster = chosen(ClusterOptions, own, {})
    options = [option for option in options if option not in own]
    if not sweep:
        return _run(config.make_request(options))
    runs = config.split_sweep([*options, *cluster.threads(options)])
    return run_sweep([config.make_request(run) for run in runs], cluster)


def _run_command(arguments: list[str]) -> int:
    if (code := answered(arguments)) is not None:
        return code
    arguments = ["wide=true" if argument == "--wide" else argument for argument in arguments]
    name = arguments[0] if re.fullmatch(r"\w[\w-]*", arguments[0]) else "run"
    if name not in COMMANDS:
        raise BadInput(f"{name} is no command: {near(name, COMMANDS)}" if name not in OPTIONS else f"give {name}=value")
    if name == "run":
        return run_or_sweep(arguments[arguments[0] == "run" :])
    try:
        return int(getattr(working, COMMANDS[name].does.partition(":")[2])(arguments[1:]))
    except SystemExit as error:  # of a plug-in
        complain(describe_error(error))
        return 1


def _run(request: RunRequest) -> int:
    """Make one run here, or in a process of its own if it has a limit; returns the exit code."""
    from vprbench.runs.store import Store

    store = Store(Path(request.results).expanduser().absolute())  # a method may change the working folder
    with answers_alone() as say:
        result: JobResult = make_run(request, say) if request.limit_minutes is None else run_in_child(request.to_json())
        if result.printed:
            say(result.printed)
        if result.code == 1:
            store.try_to_save_failure(failure_of(request, result))
    return result.code
