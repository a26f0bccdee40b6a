"""One run of the command line, or a sweep of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vprbench import config
from vprbench.errors import BadInput
from vprbench.jobs.child import run_in_child
from vprbench.jobs.job import failure_of, make_run
from vprbench.jobs.options import ClusterOptions
from vprbench.jobs.sweep import run_sweep
from vprbench.plugins.options import parse_options
from vprbench.runs.request import RunRequest
from vprbench.terminal.streams import results_only_on_stdout


def run_or_sweep(arguments: Sequence[str]) -> int:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own.

    With `--cfg job` the configuration of the run is printed, and nothing runs. Returns the exit code.
    """
    flags = [argument for argument in arguments if argument.startswith("-")]
    options = [argument for argument in arguments if not argument.startswith("-")]
    if unknown := [flag for flag in flags if flag not in ("-m", "--multirun", "--cfg")]:
        raise BadInput(f"no options here: {', '.join(unknown)}; see python -m vprbench --help")
    sweep = bool({"-m", "--multirun"} & {*flags})
    if "--cfg" in flags:
        if sweep or "job" not in options:
            raise BadInput("--cfg: give --cfg job, without --multirun: it shows the configuration of one run")
        options.remove("job")
        print(config.show_config(options), end="")
        return 0
    if sweep and not options:
        raise BadInput("-m: say what to run, as in method=sad,pca seed=0,1,2")
    own = [option for option in options if ClusterOptions.has(option)]
    if own and not sweep:
        raise BadInput(f"{own[0]}: a single run is made here: give -m for several, or compare, table, figures, report")
    cluster = parse_options(ClusterOptions, own, {})
    options = [option for option in options if option not in own]
    if not sweep:
        return _run_alone(config.make_request(options))
    runs = config.split_sweep([*options, *cluster.threads(options)])
    return run_sweep([config.make_request(run) for run in runs], cluster)


def _run_alone(request: RunRequest) -> int:
    """Make one run here, or in a process of its own if it has a limit; returns the exit code."""
    from vprbench.runs.store import Store

    store = Store(Path(request.results).expanduser().absolute())  # a method may change the working folder
    with results_only_on_stdout() as say:
        alone = request.limit_minutes is None
        result = make_run(request, say) if alone else run_in_child(request.to_json())
        if result.printed:
            say(result.printed)
        if result.code == 1:
            store.try_to_save_failure(failure_of(request, result))
    return result.code
