"""Every command that README and docs show is executed as it stands there, on a smaller journey."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from checkout import ROOT
from mat_cells import cells
from PIL import Image as PillowImage
from scipy.io import savemat
from small_plan import RUN, Apart

from vprbench import cli
from vprbench.api.neural import NeuralDescriptor
from vprbench.cluster import crew
from vprbench.datasets.nordland import chosen_names
from vprbench.datasets.synthetic_events import EventJourney, write_recording
from vprbench.paper import gather
from vprbench.paper.plan import Plan, read_plan
from vprbench.plugins import registry
from vprbench.run.processes import IN_SWEEP, Ending

DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "results/README.md",
    *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))),
)
PLACES = 12
PART = (f"dataset.places={PLACES}", "dataset.query_places=8", "dataset.first_query_place=4")
SMALLER = {
    **dict.fromkeys(("synthetic", "street", "nordland"), PART),
    "nordland_64x32": (*PART, "dataset.first_place=0"),
    "vprtempo": (f"method.max_module={PLACES}", "method.epochs=1", "method.stdp_rate=0.0001"),
    "vprsnn": (
        "method.places_per_module=4",
        "method.n_excitatory=4",
        "method.epochs=1",
        "method.recorded_presentations=8",
    ),
}
NO_WEIGHTS = {
    name for name, entry in registry.entries("method").items() if issubclass(entry.target(), NeuralDescriptor)
}  # type: ignore[arg-type]


def shown(document: str) -> Iterator[str]:
    """Yield the commands of a document, but for names in capitals that a reader fills in and the method it defines."""
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    for block in re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        yield from re.findall(r"^(?:python -m vprbench|vprbench|make) .*", block, re.MULTILINE)
    yield from re.findall(r"`((?:python -m )?vprbench [^`]*)`", text)


COMMANDS = sorted(
    {
        " ".join(shlex.split(command, comments=True))
        for document in DOCUMENTS
        for command in shown(document)
        if not re.search(
            r"[= ]NAME|COMMAND|darkness|lamps|mine|^make (test|docs|install|check|bench|gpu|chaos)|vprbench bench",
            command,
        )
    }
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder /data of the documents, with few little frames in each of its folders."""
    data = tmp_path_factory.mktemp("data")
    for folder, names in {
        "nordland": chosen_names(8, PLACES, 1, ".png"),
        "nordland_64x32": chosen_names(1, PLACES, 10, ".png"),
    }.items():
        for season in ("spring", "summer", "fall", "winter"):
            frames(data / folder / season, names)
    (data / "robotcar").mkdir()
    for folder in ("monday", "tuesday", "friday", "17places/ref", "17places/query"):
        frames(data / folder, [f"{number}.jpg" for number in range(PLACES)])
    (data / "17places" / "ground_truth.csv").write_text(
        "query,matching_refs\n" + "".join(f"{number},{number}\n" for number in range(PLACES))
    )
    positions = [f"@{585000 + 100 * number}.0@4477000.0@{number}.jpg" for number in range(PLACES)]
    for folder in ("database", "queries", "pitts30k/images/test/database", "pitts30k/images/test/queries"):
        frames(data / folder, positions)
    for name, season in {"monday": "spring", "friday": "summer"}.items():
        drive = EventJourney(window_ms=1000).recording(season, range(PLACES))
        write_recording(data / f"{name}.h5", drive)
    for name in ("map", "today"):
        (data / f"{name}.csv").write_text("image,place\n" + "".join(f"friday/{n}.jpg,{n}\n" for n in range(PLACES)))
    names = frames(data / "tokyo247", [f"{number}.png" for number in range(PLACES)])
    metres = np.array([[585000.0 + 100 * n for n in range(PLACES)], [4477000.0] * PLACES])
    fields = {"whichSet": "test", "dbImageFns": cells([name.replace("png", "jpg") for name in names]), "utmDb": metres}
    fields |= {"qImageFns": cells(names), "utmQ": metres, "numImages": float(PLACES), "numQueries": float(PLACES)}
    savemat(data / "tokyo247" / "tokyo247.mat", {"dbStruct": fields | {"posDistThr": 25.0, "posDistSqThr": 625.0}})
    return data


def frames(folder: Path, names: list[str]) -> list[str]:
    """Put an image into the folder under each name; the same place looks alike in every folder."""
    folder.mkdir(parents=True)
    for number, name in enumerate(names):
        levels = np.random.default_rng(number).integers(0, 256, (8, 16, 3), dtype=np.uint8)
        PillowImage.fromarray(levels).resize((64, 32)).save(folder / name)
    return names


def smaller(options: list[str]) -> list[str]:
    """Return the options of a run, and after them those that make it short."""
    chosen = dict(option.split("=", 1) for option in options if re.match(r"(method|dataset)=", option))
    names = (chosen.get("dataset", "synthetic"), *re.findall("^(?:vprtempo|vprsnn)", chosen.get("method", "sad")))
    return [*options, *(option for name in names for option in SMALLER.get(name, ())), *RUN]


def smaller_plan(path: Path) -> Plan:
    """Return the plan of the table with its own names, every column of few places and every row of one seed."""
    plan = read_plan(path)
    quick = {
        method: {option[len("method.") :].split("=")[0]: yaml.safe_load(option.split("=")[1]) for option in options}
        for method, options in SMALLER.items()
        if method in ("vprtempo", "vprsnn")
    }
    columns = {
        name: replace(column, options=(*column.options, *PART), fits=quick) for name, column in plan.columns.items()
    }
    growth = replace(plan.growth, sizes=(10, 12), at_most={"vprtempo": {"max_module": PLACES}})
    return replace(plan, columns=columns, growth=growth)


class Sweep:
    """Stands in for the processes of a sweep; remembers what each would run."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []

    def __call__(self, options: list[str]) -> Ending:
        self.asked.append(list(options))
        return Ending(0)


def of_make(command: str) -> list[str]:
    """Return the options with which a target of the Makefile calls the program."""
    given = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKEOVERRIDES", "ARGS")}
    asked = ["make", "-n", *command.split()[1:]]
    told = subprocess.run(asked, cwd=ROOT, env=given, capture_output=True, text=True, check=True)
    return shlex.split(told.stdout.replace("\\\n", " ").rsplit("-m vprbench ", 1)[1].splitlines()[0])


@pytest.fixture
def sweep(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sweep:
    sweep = Sweep()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VPRBENCH_DATA", str(data))
    monkeypatch.setenv(IN_SWEEP, "1")
    monkeypatch.setattr(
        crew,
        "run_apart",
        lambda options, stdout=None, **_: (
            sweep(options) if stdout is None else Apart()(smaller(list(options)))  # whose answers are shown, or not
        ),
    )
    monkeypatch.setattr(gather, "read_plan", smaller_plan)
    return sweep


@pytest.mark.parametrize("command", [command for command in COMMANDS if command.startswith("make")])
def test_a_documented_target_of_make_is_executed(command: str, data: Path, sweep: Sweep) -> None:
    name, *options = of_make(command.replace("/data/", f"{data}/"))
    if name == "search":
        options += ["dataset=synthetic", f"places={PLACES}", "trials=1", "jobs=1"]
    else:
        options += ["rows=[SAD]", "seeds=1"] + ["columns=[railway]"] * (name != "table")
    assert cli.main([name, *options]) == (2 if {"stored=true", "stores=[/mnt/gpu-box/results]"} & {*options} else 0)


@pytest.mark.parametrize("command", [command for command in COMMANDS if not command.startswith("make")])
def test_a_documented_command_is_executed(
    command: str, data: Path, sweep: Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = command.removeprefix("python -m ").replace("/data/", f"{data}/").split()[1:]
    options = [option for option in options if not re.match(r"workers=|cluster[.=]", option)]  # made here instead
    if options[0] in ("list", "fetch", "--cfg", "--version", "completion") or "--help" in options:
        nothing_is_downloaded = options[0] == "fetch" and len(options) > 1
        monkeypatch.setenv("VPRBENCH_DATA", str(Path("downloads").absolute()))
        assert cli.main(options) == (2 if nothing_is_downloaded else 0)
    elif options[0] == "status":
        Path("results").mkdir()
        assert cli.main(options) == 0
    elif options[0] == "table":
        assert cli.main([*options, "rows=[SAD]", "seeds=1", "columns=[railway]"]) == 0
    elif options[0] == "doctor":
        chosen = options[1].removeprefix("dataset=")
        assert cli.main([*options, *SMALLER.get(chosen, ())]) == 1  # a dozen frames, equal ones, are no journey
    elif options[0] == "compare":
        given = dict(option.split("=", 1) for option in options[1:])
        assert cli.main([*options, *SMALLER.get(given["dataset"], ()), *RUN]) == 0
    elif options[0] == "-m":
        assert cli.main(options) == 0
        assert sweep.asked
        of_one_method = {
            next(option for option in asked if option.startswith("method=")): asked for asked in sweep.asked
        }
        for asked in of_one_method.values():
            run(asked)
    else:
        store_what_is_loaded(options)
        run(options)


def store_what_is_loaded(options: list[str]) -> None:
    """Store the network that a command loads, as an earlier command or the authors' code would have."""
    for path in (Path(option.removeprefix("load=")) for option in options if option.startswith("load=")):
        if path.suffix == ".safetensors":
            run(["method=vprtempo", *(o for o in options if o.startswith("dataset")), f"save={path}"])
        else:
            sizes = {"feature": (1568, 784), "output": (PLACES, 1568)}
            layers = {f"{name}_layer.w.weight": torch.ones(size) for name, size in sizes.items()}
            torch.save(
                {"model_0": layers | {f"{name}_layer.thr": torch.zeros(1, n) for name, (n, _) in sizes.items()}}, path
            )


def run(options: list[str]) -> None:
    """Execute one run; a network without its weights, and a network that nobody stored, says so."""
    ending = Apart()(smaller(options))
    without = any(option == f"method={name}" for option in options for name in NO_WEIGHTS)
    assert (ending.code, ending.missing) == ((2, True) if without else (0, False)), ending.error
