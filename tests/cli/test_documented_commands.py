"""Every command that README and docs show is understood, and runs in the order of its document on a smaller journey."""

import os
import re
import shlex
import subprocess
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from checkout import ROOT
from event_recordings import by_chance
from mat_cells import cells
from PIL import Image as PillowImage
from scipy.io import savemat
from small_plan import RUN, run_apart

from vprbench import cli
from vprbench.datasets.nordland import chosen_names
from vprbench.jobs import executors
from vprbench.plugins import registry
from vprbench.report import gather
from vprbench.report.plan import read_plan
from vprbench.runs.request import RunRequest

DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "results/README.md",
    *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))),
)
PLACES = 12
PART = (f"dataset.places={PLACES}", "dataset.query_places=8", "dataset.first_query_place=4")
SMALLER = {
    **dict.fromkeys(("synthetic", "nordland"), PART),
    "nordland_64x32": (*PART, "dataset.first_place=0"),
    "vprtempo": ("method.epochs=1", "method.stdp_rate=0.0001"),
    "vprsnn": (
        *("method.places_per_module=4", "method.n_excitatory=4"),
        *("method.epochs=1", "method.recorded_presentations=8"),
    ),
}
NO_WEIGHTS = {name for name, entry in registry.find_entries("method").items() if entry.needs_weights}


def commands(document):
    """Return the commands of a document in its order, each once; not those that install, test or measure speed.

    Names in capitals are for the reader to fill in, and some methods are for the reader to write.
    """
    left_out = r"[= ]NAME|COMMAND|darkness|lamps|mine|^make (test|docs|install|check|bench|gpu|chaos)|vprbench bench"
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    found = re.findall(r"^(?:python -m vprbench|vprbench|make) .*", "\n".join(blocks), re.MULTILINE)
    found += re.findall(r"`((?:python -m )?vprbench [^`]*)`", text)
    plain = (" ".join(shlex.split(command, comments=True)) for command in found)
    return [command for command in dict.fromkeys(plain) if not re.search(left_out, command)]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The folder /data of the documents, with few little frames in each of its folders."""
    data = tmp_path_factory.mktemp("data")
    for season in ("spring", "summer", "fall", "winter"):
        frames(data / "nordland" / season, chosen_names(8, PLACES, 1, ".png"))
        frames(data / "nordland_64x32" / season, chosen_names(1, PLACES, 10, ".png"))
    (data / "robotcar").mkdir()
    for folder in ("monday", "tuesday", "friday", "17places/ref", "17places/query"):
        frames(data / folder, [f"{number}.jpg" for number in range(PLACES)])
    (data / "17places" / "ground_truth.csv").write_text(
        "query,matching_refs\n" + "".join(f"{number},{number}\n" for number in range(PLACES))
    )
    positions = [f"@{585000 + 100 * number}.0@4477000.0@{number}.jpg" for number in range(PLACES)]
    for folder in ("database", "queries", "pitts30k/images/test/database", "pitts30k/images/test/queries"):
        frames(data / folder, positions)
    import h5py  # here, for no other test needs it

    for name in ("monday", "friday"):
        with h5py.File(data / f"{name}.h5", "w") as file:
            for column, values in vars(by_chance(4000, seconds=float(PLACES))).items():
                file[f"events/{column}"] = values
    for name, day in (("map", "monday"), ("today", "friday")):
        (data / f"{name}.csv").write_text("image,place\n" + "".join(f"{day}/{n}.jpg,{n}\n" for n in range(PLACES)))
    for drive in ("sunset1", "sunset2"):
        frames(data / "brisbane_events_7x7" / drive, [f"images_{n:05d}.png" for n in range(PLACES)], "L", (7, 7))
    np.savez(data / "brisbane_events_7x7" / "ground_truth.npz", positives=np.eye(PLACES, dtype=bool))
    names = frames(data / "tokyo247", [f"{number}.png" for number in range(PLACES)])
    frames(data / "tokyo247" / "queries", names)
    metres = np.array([[585000.0 + 100 * n for n in range(PLACES)], [4477000.0] * PLACES])
    fields = {"whichSet": "test", "dbImageFns": cells([name.replace("png", "jpg") for name in names]), "utmDb": metres}
    fields |= {"qImageFns": cells([f"queries/{name}" for name in names]), "utmQ": metres, "numImages": float(PLACES)}
    fields |= {"numQueries": float(PLACES), "posDistThr": 25.0, "posDistSqThr": 625.0}
    savemat(data / "tokyo247" / "tokyo247.mat", {"dbStruct": fields})
    return data


def frames(folder, names, mode="RGB", size=(64, 32)):
    """Put an image into the folder under each name; a place looks alike in every folder, queries are no copies."""
    folder.mkdir(parents=True)
    noise = np.random.default_rng(0)
    is_query = folder.name in ("summer", "friday", "query", "queries", "sunset2")
    for number, name in enumerate(names):
        levels = np.random.default_rng(number).integers(0, 256, (8, 16, 3), dtype=np.uint8)
        seen = levels ^ (is_query * noise.integers(0, 2, levels.shape, np.uint8))
        PillowImage.fromarray(seen).resize(size).convert(mode).save(folder / name)
    return names


def options_of(command, data):
    """Return the options that a documented command, or its target of the Makefile, gives the program for `data`."""
    if command.startswith("make"):
        given = {
            name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKEOVERRIDES", "ARGS")
        }
        make = ["make", "-n", *command.split()[1:]]
        done = subprocess.run(make, cwd=ROOT, env=given, capture_output=True, text=True, check=True)
        command = done.stdout.replace("\\\n", " ").rsplit("-m vprbench ", 1)[1].splitlines()[0]
    options = shlex.split(re.sub(r"^(python -m )?vprbench ", "", command).replace("/data/", f"{data}/"))
    return [option for option in options if not re.match(r"workers=|cluster[.=]", option)]  # one process here


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_document_says_how_to_get_the_frames_that_its_commands_need(document):
    asked = {option for command in commands(document) if "dataset.root" not in command for option in command.split()}
    needed = {option.removeprefix("dataset=") for option in asked if option.startswith("dataset=")}
    offered = {path.stem for path in (ROOT / "conf" / "fetch").glob("*.yaml")}
    named = set(re.findall(r"vprbench fetch (\w+)", (ROOT / document).read_text(encoding="utf-8")))
    assert needed & offered <= named


def smaller(options):
    """Return the options of a run, and after them those that make it short."""
    chosen = dict(option.split("=", 1) for option in options if re.match(r"(method|dataset)=", option))
    names = (chosen.get("dataset", "synthetic"), *re.findall("^(?:vprtempo|vprsnn)", chosen.get("method", "sad")))
    return [*options, *(option for name in names for option in SMALLER.get(name, ())), *RUN]


def smaller_plan(path):
    """Return the plan of the table with its own names, every column of few places and every row of one seed."""
    plan = read_plan(path)
    quick = {
        method: {option[len("method.") :].split("=")[0]: yaml.safe_load(option.split("=")[1]) for option in options}
        for method, options in SMALLER.items()
        if method in ("vprtempo", "vprsnn")
    }
    columns = {name: replace(column, options=(*column.options, *PART)) for name, column in plan.columns.items()}
    rows, more = (
        {name: replace(row, arguments={**quick.get(row.method, {}), **row.arguments}) for name, row in of.items()}
        for of in (plan.rows, plan.more_rows)
    )
    return replace(plan, rows=rows, more_rows=more, columns=columns, growth=replace(plan.growth, sizes=(10, 12)))


@pytest.mark.extended
@pytest.mark.parametrize("document", [document for document in DOCUMENTS if commands(document)])
def test_the_commands_of_a_document_run_in_its_order_from_a_clean_folder(document, data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VPRBENCH_DATA", str(data))
    monkeypatch.setattr(
        executors, "run_in_child", lambda text, *_: run_apart(smaller(RunRequest.from_json(text).overrides))
    )
    monkeypatch.setattr(gather, "read_plan", smaller_plan)
    Path("results").mkdir()
    for command in commands(document):
        options = options_of(command, data)
        store_what_others_trained(options)
        assert execute(options) in expected_codes(options), command


def expected_codes(options):
    """Return the exit codes that a command may have here: 2 where weights or frames cannot be got."""
    named = {name for option in options for name in re.findall(r"\w+", option)}
    if options[0] == "fetch":
        return [2 if len(options) > 1 else 0]  # the tests have no net
    if options[0] == "doctor":
        return [0, 1]  # 1: a dozen places are no journey
    if "stores=[/mnt/gpu-box/results]" in options or (named & NO_WEIGHTS and options[0].startswith("method=")):
        return [2]
    return [0, 2] if named & {*NO_WEIGHTS, "corridor"} else [0]


def execute(options):
    """Run a command in a smaller size; returns its exit code."""
    if options[0] == "fetch":
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("VPRBENCH_DATA", str(Path("downloads").absolute()))
            return cli.main(options)
    if options[0] == "table":
        options = [*options, "rows=[SAD]", "seeds=1", "columns=[railway]"]
    elif options[0] == "search":
        options = [*options, "dataset=synthetic", f"places={PLACES}", "trials=1", "workers=1"]
    elif options[0] in ("compare", "doctor"):
        (name,) = (option.partition("=")[2] for option in options if option.startswith("dataset="))
        options = [*options, *SMALLER.get(name, ()), *(RUN if options[0] == "compare" else ())]
    elif "=" in options[0] and "--help" not in options:
        return run_apart(smaller(options)).code
    return cli.main(options)


def store_what_others_trained(options):
    """Store the network that a command loads in the layout of the authors' code."""
    for path in (Path(option.removeprefix("load=")) for option in options if option.startswith("load=")):
        if path.suffix == ".pth":
            sizes = {"feature": (1568, 784), "output": (PLACES, 1568)}
            layers = {f"{name}_layer.w.weight": torch.ones(size) for name, size in sizes.items()}
            layers |= {f"{name}_layer.thr": torch.zeros(1, n) for name, (n, _) in sizes.items()}
            torch.save({"model_0": layers}, path)


TREE = [
    f"/{path.relative_to(ROOT)}"
    for top in ("vprbench", "methods", "datasets", "conf", "docs", "tests", ".ci")
    for path in (ROOT / top).rglob("*")
]
TO_BE_WRITTEN = re.compile(r"NAME|darkness|lamps|mine|^table/\*|^results/")  # by a reader, a plug-in or a command


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_that_a_document_names_is_there(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    named = re.findall(r"`([\w./*-]+\.(?:py|pyi|j2|md|css|js)|[\w./*-]+/[\w.*-]+\.(?:yaml|csv))`", text)
    wanted = {name.removeprefix("./") for name in named if not TO_BE_WRITTEN.search(name)}
    assert [name for name in wanted if not any(fnmatchcase(path, f"*/{name}") for path in TREE)] == []
