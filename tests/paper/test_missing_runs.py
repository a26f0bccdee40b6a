"""Runs that are wanted and not stored are made apart, and whatever happens to them is stored."""

from __future__ import annotations

import fcntl
import os
import pty
import shutil
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from small_plan import RUN, install

from vprbench.cli import main
from vprbench.cluster import crew
from vprbench.paper import missing_runs, shelf
from vprbench.paper.missing_runs import MissingRun
from vprbench.paper.plan import Row
from vprbench.run.compose import composed
from vprbench.run.processes import Ending
from vprbench.run.store import Store

SAD = Row("SAD", "sad", training="none")
OPTIONS = ["dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4"]


def compose(options: Sequence[str]) -> dict[str, Any]:
    return composed(list(options))


def a_wish(row: Row = SAD, seed: int = 0, **changes: object) -> MissingRun:
    given = {
        "row": row,
        "title": "Journey",
        "dataset_options": ("dataset=synthetic", "dataset.places=20"),
        "dataset": {"name": "synthetic", "places": 20},
        "arguments": dict(row.arguments),
        "seed": seed,
        "device": "cpu",
    }
    return MissingRun(**{**given, **changes})


class Children:
    """Stands in for processes: each ends in the next way, and is remembered by its options."""

    def __init__(self, *answers: Ending) -> None:
        self.answers = list(answers)
        self.asked: list[list[str]] = []

    def __call__(self, options: Sequence[str], **_: object) -> Ending:
        self.asked.append(list(options))
        return self.answers.pop(0)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")


def with_children(monkeypatch: pytest.MonkeyPatch, *answers: Ending) -> Children:
    children = Children(*answers)
    monkeypatch.setattr(crew, "run_apart", children)
    return children


def test_a_run_is_asked_for_by_the_options_of_row_dataset_seed_and_device(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch, Ending(0))
    row = Row("Big patches", "sad", arguments={"patch": 14, "preprocessing": "A"})
    assert missing_runs.fill([a_wish(row, seed=3)], ["threads=1"], store, compose) == [Ending(0)]
    assert children.asked == [
        [
            "dataset=synthetic",
            "dataset.places=20",
            "method=sad",
            "method.patch=14",
            'method.preprocessing="A"',
            "seed=3",
            "device=cpu",
            "threads=1",
            f"results={store.root}",
        ]
    ]


def test_a_method_that_is_not_there_is_a_stored_failure_and_starts_no_process(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch)
    row = Row("Nothing", "no_such_method", seeds=(0, 1))
    endings = missing_runs.fill([a_wish(row, 0), a_wish(row, 1)], [], store, compose)
    assert [(ending.code, ending.missing) for ending in endings] == [(2, True), (2, True)]
    assert children.asked == []
    (failure,) = store.failures()
    assert (failure.method, failure.dataset, failure.missing) == ("no_such_method", "synthetic", True)
    assert "no_such_method" in failure.error


def test_weights_that_are_missing_for_one_seed_are_not_looked_for_again(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    missing = Ending(2, True, "weights are missing", recorded=True)
    children = with_children(monkeypatch, missing, Ending(0))
    endings = missing_runs.fill([a_wish(seed=0), a_wish(seed=1), a_wish(Row("PCA", "pca"))], [], store, compose)
    assert endings == [missing, missing, Ending(0)]
    assert len(children.asked) == 2


def test_published_weights_are_looked_for_once_and_without_a_process_where_they_are_missing(
    monkeypatch: pytest.MonkeyPatch, store: Store, tmp_path: Path
) -> None:
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
    children = with_children(monkeypatch, Ending(0))
    row = Row("GCL", "gcl", arguments={"backbone": "vgg16"}, training="pretrained")
    wishes = [a_wish(row), a_wish(row, title="Street", dataset={"name": "street", "places": 20})]
    assert [(ending.code, ending.missing) for ending in missing_runs.fill(wishes, [], store, compose)] == [
        (2, True)
    ] * 2
    assert children.asked == []
    assert {(failure.dataset, failure.missing) for failure in store.failures()} == {
        ("synthetic", True),
        ("street", True),
    }
    assert all("MSLS_vgg16_GeM_480_GCL.pth" in failure.error for failure in store.failures())
    (tmp_path / "MSLS_vgg16_GeM_480_GCL.pth").write_bytes(b"what is in it is for the process to see")
    assert missing_runs.fill(wishes[:1], [], store, compose) == [Ending(0)]
    assert len(children.asked) == 1


def test_a_failure_of_one_seed_does_not_stop_the_next_and_is_stored_unless_the_process_did(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    diverged, killed = Ending(1, False, "it diverged", recorded=True), Ending(1, False, "was ended by signal 9")
    with_children(monkeypatch, diverged, killed, Ending(0))
    endings = missing_runs.fill([a_wish(seed=seed) for seed in range(3)], OPTIONS[-1:], store, compose)
    assert [(ending.code, ending.recorded) for ending in endings] == [(1, True), (1, True), (0, False)]
    (failure,) = store.failures()
    assert (failure.error, failure.missing, failure.config["seed"]) == ("was ended by signal 9", False, 1)
    assert main([*a_wish(seed=1).options(), OPTIONS[-1], "timing=none", f"results={store.root}"]) == 0
    assert not [*store.failures()]  # the run takes its place


def test_a_method_that_knows_no_device_does_not_run_on_a_gpu(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    children = with_children(monkeypatch)
    assert missing_runs.fill([a_wish(Row("HOG", "hog"), device="cuda")], [], store, compose) == [Ending(0)]
    assert children.asked == []


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the stored runs of SAD in the two columns of the small plan."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        install(monkeypatch, folder)
        assert main(["table", "rows=[SAD]", "devices=[cpu]", *RUN]) == 0
    yield folder
    shutil.rmtree(folder)


STORED = a_wish(dataset_options=tuple(OPTIONS))


@pytest.mark.parametrize(
    ("wish", "options", "patched", "n_processes"),
    [
        (STORED, [], {}, 0),
        (a_wish(seed=1, dataset_options=tuple(OPTIONS)), [], {}, 1),
        (a_wish(dataset_options=tuple(OPTIONS), arguments={"patch": 14}), [], {}, 1),
        (a_wish(dataset_options=(*OPTIONS, "dataset.query_places=5")), [], {}, 1),
        (a_wish(dataset_options=(*OPTIONS, "dataset.protocol=nobody")), [], {}, 1),
        (STORED, ["timing.minimum_seconds=0.01"], {}, 1),
        (STORED, ["force=true"], {}, 1),
        (STORED, [], {"code_hash_of": "other code"}, 1),
        (STORED, [], {"code_hash_of": None}, 1),
        (STORED, [], {"fingerprint": "other frames"}, 1),
    ],
)
def test_a_process_is_started_only_for_what_is_not_stored_as_it_would_be_made_now(
    made: Path,
    monkeypatch: pytest.MonkeyPatch,
    wish: MissingRun,
    options: list[str],
    patched: dict[str, Any],
    n_processes: int,
) -> None:
    children = with_children(monkeypatch, Ending(0))
    for name, value in patched.items():
        monkeypatch.setattr(shelf, name, lambda _, value=value: value)
    assert missing_runs.fill([wish], [*RUN, *options], Store(made / "results"), compose) == [Ending(0)]
    assert len(children.asked) == n_processes


def test_frames_that_were_removed_are_kept_again_by_a_process(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(made / "results", tmp_path / "results", ignore=shutil.ignore_patterns("frames"))
    children = with_children(monkeypatch, Ending(0))
    store = Store(tmp_path / "results")
    missing_runs.fill([STORED], [*RUN, "frames=false"], store, compose)
    assert children.asked == []
    missing_runs.fill([STORED], RUN, store, compose)
    assert len(children.asked) == 1


def test_a_table_of_stored_runs_imports_no_torch(made: Path) -> None:
    code = """
import sys
from pathlib import Path
from vprbench.cluster import crew
from vprbench.paper import gather
from vprbench.paper.plan import read_plan
from vprbench.cli import main
gather.read_plan = lambda _: read_plan(Path("plan.yaml"))
crew.run_apart = None
code = main(["table", "rows=[SAD]", "devices=[cpu]", *sys.argv[1:]])
sys.exit("torch" if "torch" in sys.modules else code)
"""
    done = subprocess.run([sys.executable, "-c", code, *RUN], cwd=made, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# On a terminal


def on_a_terminal(monkeypatch: pytest.MonkeyPatch, act: Callable[[], None]) -> str:
    """Return what comes on a terminal of 100 columns and 30 rows while `act` runs."""
    monkeypatch.setenv("TERM", "xterm-256color")
    for name in ("COLUMNS", "LINES", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    pieces: list[bytes] = []

    def read() -> None:
        while piece := os.read(master, 65536):
            pieces.append(piece)
            if b"END" in piece:
                return

    reader = threading.Thread(target=read)
    reader.start()
    with os.fdopen(slave, "w", encoding="utf-8") as terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        patch.setenv("COLUMNS", "100")
        patch.setenv("LINES", "30")
        act()
        terminal.write("END")
        terminal.flush()
        reader.join(10)
    os.close(master)
    return b"".join(pieces).decode()


def talking(lines: Sequence[str], then: Ending | KeyboardInterrupt) -> Callable[..., Ending]:
    """Return what stands in for a process that says some lines and ends."""

    def run(_: object, heard: Callable[[str], None] = print, **__: object) -> Ending:
        for line in lines:
            heard(line)
        if isinstance(then, KeyboardInterrupt):
            raise then
        return then

    return run


def test_on_a_terminal_a_table_fills_with_what_is_stored_and_lines_stand_above(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = ["\x01fit\t0.250", "\x01!note: a warning", "vprbench: it failed"]
    monkeypatch.setattr(crew, "run_apart", talking(said, Ending(1, False, "it failed", recorded=True)))
    other = a_wish(Row("A row with a name that is longer than its column may be", "sad"), seed=1)
    endings: list[Ending] = []
    shown = on_a_terminal(
        monkeypatch,
        lambda: endings.extend(missing_runs.fill([STORED, other], RUN, Store(made / "results"), compose)),
    )
    assert [ending.code for ending in endings] == [0, 1]
    assert "\x1b[33mnote: a warning" in shown
    assert "\x1b[31mvprbench: it failed" in shown
    assert " %  " in shown  # recall
    assert " Hz" in shown
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")  # the cursor is there again


def test_an_interrupted_table_leaves_the_terminal_clean(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    monkeypatch.setattr(crew, "run_apart", talking(["\x01query\t0.500"], KeyboardInterrupt(2)))

    def interrupted() -> None:
        with pytest.raises(KeyboardInterrupt):
            missing_runs.fill([a_wish(), a_wish(seed=1)], [], store, compose)

    shown = on_a_terminal(monkeypatch, interrupted)
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")


def test_an_absolute_folder_is_what_a_process_elsewhere_finds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert missing_runs.results_folder("mine") == tmp_path / "mine"
