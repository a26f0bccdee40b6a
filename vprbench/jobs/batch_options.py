"""Jobs of a batch system that make cells: what conf/cluster/*.yaml and the command line ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_type_hints

from vprbench.errors import BadInput
from vprbench.plugins.checked import checked
from vprbench.plugins.entries import conf_folders, read
from vprbench.text import near

System = Literal["slurm", "pbs", "lsf", "sge"]


@dataclass(frozen=True)
class Job:
    """One job, which makes one cell after the other, and how many there are."""

    system: System
    queue: str | None = None  # or partition
    account: str | None = None  # or project
    cores: int = 1
    memory: str = "8GB"
    walltime: str = "24:00:00"
    gpus: int = 0
    minimum: int = 0
    maximum: int = 16
    adaptive: bool = True  # as many jobs as there are cells, between minimum and maximum; false: maximum at once
    directives: list[str] = field(default_factory=list)  # more lines of the script's head
    prologue: list[str] = field(default_factory=list)  # commands before the worker starts
    interface: str | None = None  # network by which workers find this process, as ib0
    logs: str = "vprbench-jobs"  # folder for what jobs print


def job(given: Mapping[str, Any], workers: int | None) -> Job:
    """Return the job that `name`, in conf/cluster or a yaml elsewhere, asks for, and what replaces its values.

    Raises BadInput for what is not known.
    """
    known = {path.stem: path for folder in conf_folders().values() for path in (folder / "cluster").glob("*.yaml")}
    name = str(given.get("name") or "")
    path = Path(name).expanduser() if name.endswith(".yaml") else known.get(name)
    if path is None or not path.is_file():
        raise BadInput(f"cluster={name}: {near(name, known)}, or a yaml of your own, as in cluster=./ours.yaml")
    hints = get_type_hints(Job)
    values = {**read(path.read_text(encoding="utf-8")), **given}
    del values["name"]
    for option in values:
        if option not in hints:
            raise BadInput(f"option cluster.{option} is unknown: {near(option, hints)}")
    found = Job(**{option: checked(f"cluster.{option}", value, hints[option]) for option, value in values.items()})
    return found if workers is None else replace(found, maximum=workers, minimum=min(found.minimum, workers))
