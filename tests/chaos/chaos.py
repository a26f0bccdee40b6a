"""A sweep whose workers, schedulers and clients are killed at random, and what it leaves: `make chaos`."""

import argparse
import contextlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from vprbench.runs.run_lock import read_claims
from vprbench.runs.store import Store
from vprbench.storage.atomic import PARTIAL, remove_leftovers

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.append(str(HERE.parent / "support"))
from plugged_in import plugin  # noqa: E402

METHODS = {  # each is compared under as many seeds as make the cells
    "watched_gaussian": "RandomProjection\ncomponents: 256",
    "watched_signs": "RandomProjection\ncomponents: 256\ndirections: signs",
    "watched_flyhash": "FlyHash\nunits: 2000\nwinners: 100",
    "watched_flyhash_sparse": "FlyHash\nunits: 2000\nwinners: 20",
    "watched_hyperdimensional_small": "HyperDimensional\ncomponents: 256",
    "watched_hyperdimensional": "HyperDimensional\ncomponents: 512",
}
N_WORKERS = 4
KILLS = {"worker": 16, "scheduler": 1, "client": 3}  # how often each kind is chosen
PAUSE = (2.0, 14.0)  # seconds from one kill to the next
PEACE = 1800.0  # seconds that a sweep has to end once nothing is killed
MARK = "CHAOS_HOME"  # environment variable of all processes that are begun here


class Chaos:
    """The processes of the sweep, and who kills them."""

    def __init__(self, home, n_cells, seed):
        self.home = home
        self.drawn = random.Random(seed)
        self.kills: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        self.faults: list[str] = []
        self._cluster: dict[str, Any] = {}  # processes by what they are
        self._begun: Counter[str] = Counter()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.scheduler = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        asked = f"methods=[{','.join(METHODS)}] seeds={n_cells // len(METHODS)} dataset=synthetic dataset.places=30"
        self.command = ["compare", *asked.split(), "threads=1", "frames=false"]
        self.n_cells = n_cells // len(METHODS) * len(METHODS)
        for folder in ("tmp", "logs", "watch", "cache"):
            (home / folder).mkdir()
        yamls = {name: f"_target_: watched.{text}\nseed: ${{seed}}" for name, text in METHODS.items()}
        plugin(home / "plugin", "watched", "watched", yamls)
        shutil.copy(HERE / "watched.py", home / "plugin")
        own = {"TMPDIR": "tmp", "CHAOS_WATCH": "watch", MARK: "", "DASK_TEMPORARY_DIRECTORY": "dask"}
        own |= {f"VPRBENCH_{name}": f"cache/{name}" for name in ("FRAMES", "HASHES", "PARTIAL")}
        self.environment = {**os.environ, **{name: str(home / folder) for name, folder in own.items()}}
        self.environment["PYTHONPATH"] = os.pathsep.join([str(home / "plugin"), str(ROOT)])

    def begin(self, name, *arguments):
        """Begin a process of Python; what it says goes to a file of its own."""
        self._begun[name] += 1
        command, ours = [sys.executable, "-m", *arguments], self.environment
        with (self.home / "logs" / f"{name}-{self._begun[name]}.log").open("wb") as log:  # Ctrl-C is for this process
            return subprocess.Popen(command, cwd=self.home, env=ours, stdout=log, stderr=log, start_new_session=True)

    def client(self, results):
        elsewhere = self.drawn.choice([f"workers={N_WORKERS}", f"scheduler={self.scheduler}"])
        timing = [
            "timing=quick",
            "timing.minimum_seconds=0",
            "timing.maximum_seconds=0.1",
        ]  # while a cell is timed the others are stopped
        return self.begin("client", "vprbench", *self.command, *timing, f"results={results}", elsewhere)

    def keep_cluster(self):
        wanted = {"scheduler": ["scheduler", "--host", "127.0.0.1", "--port", self.scheduler.rpartition(":")[2]]}
        wanted |= {f"worker{n}": ["worker", self.scheduler, "--nthreads", "1"] for n in range(N_WORKERS)}
        for name, arguments in wanted.items():
            if name not in self._cluster or self._cluster[name].poll() is not None:
                self._cluster[name] = self.begin(name, "dask", *arguments, "--no-dashboard")

    def kill_one(self):
        kind = self.drawn.choices([*KILLS], [*KILLS.values()])[0]
        found = sorted(process for process, what in self.processes() if what == kind)
        if found:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.drawn.choice(found), signal.SIGKILL)
                self.kills[kind] += 1

    def processes(self):
        """Yield all processes of the sweep that live, and what they are."""
        mark = f"{MARK}={self.environment[MARK]}".encode()
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # it has ended
                if mark in (folder / "environ").read_bytes().split(b"\0"):
                    yield int(folder.name), _kind((folder / "cmdline").read_text(errors="replace").replace("\0", " "))

    def disturb(self, seconds, right):
        """Kill and begin again for so many seconds; a sweep that ends is looked at, and the next one begins."""
        until = time.monotonic() + seconds
        round_number, client = 0, None
        kill_at = time.monotonic() + self.drawn.uniform(*PAUSE) + 10.0
        while (now := time.monotonic()) < until:
            self.keep_cluster()
            results = self.home / f"results-{round_number}"
            if client is None:
                client = self.client(results)
            if (code := client.poll()) is not None:
                client = None
                self.ends[f"code {code}" if code >= 0 else "killed"] += 1
                if code == 0:
                    self.judge(results, right)
                    round_number += 1
            if now > kill_at:
                self.kill_one()
                kill_at = now + self.drawn.uniform(*PAUSE)
            time.sleep(0.2)
        self.end_in_peace(client, self.home / f"results-{round_number}", right)

    def end_in_peace(self, client, results, right):
        """Let the sweep end, by the same command if need be, and look at it."""
        until, code = time.monotonic() + PEACE, None
        for _ in range(3):  # the first may have lost its scheduler, the second meet what that left
            while (client := client or self.client(results)).poll() is None and time.monotonic() < until:
                self.keep_cluster()
                time.sleep(0.2)
            code, client = client.poll(), None
            if code in (0, None):
                break
        if code != 0:
            self.faults.append(f"the sweep did not end well in {PEACE:.0f} s of peace, but with {code}")
        self.ends[f"in peace, code {code}"] += 1
        self.judge(results, right)

    def judge(self, results, right):
        made, watched = stored(results), self.home / "watch" / "doubled"
        found = {
            "lost": [f"cell {number}" for number in range(len(made), self.n_cells)],
            "unknown": sorted(made.keys() - right.keys()),
            "doubled": watched.read_text().splitlines() if watched.exists() else [],
            "different": sorted(key for key in right.keys() & made.keys() if not _equal(right[key], made[key])),
            "failed": [f"{each.method}: {each.error}" for each in Store(results).failures()],
            "locked": read_claims(results),
        }
        counts = ", ".join(f"{len(those)} {what}" for what, those in found.items())
        print(f"{results.name}: {len(made)} of {self.n_cells} cells; {counts}", flush=True)
        self.faults += [f"{results.name}: {what}: {each}" for what, those in found.items() for each in those]

    def end(self):
        for process in self._cluster.values():
            process.terminate()
        until = time.monotonic() + 30.0
        while (left := [*self.processes()]) and time.monotonic() < until:
            time.sleep(0.5)
        self.forget()
        files = [path for path in self.home.rglob("*") if _temporary(path.relative_to(self.home))]
        print(f"left: {len(files)} temporary files, {len(left)} processes", flush=True)
        self.faults += [f"left: process {process}, {what}" for process, what in left]
        self.faults += [f"left: {path}" for path in files]
        for process, _ in left:
            os.kill(process, signal.SIGKILL)

    def forget(self):
        """Let more than a day pass over the unfinished files of killed processes, and clean as a run does."""
        for partial in [*self.home.rglob(f"{PARTIAL}*")]:
            with contextlib.suppress(FileNotFoundError):  # it lay in another one
                for path in (partial, *partial.rglob("*")):
                    os.utime(path, (0, 0))
                remove_leftovers(partial.parent)
        for results in self.home.glob("results-*"):
            Store(results).prepare()


def _kind(line):
    of = {"dask scheduler": "scheduler", "vprbench compare": "client", "dask worker": "worker", "spawn_main": "worker"}
    return next((kind for word, kind in of.items() if word in line), line)


def _temporary(path):
    """Tell whether a file should not be left.

    Temporary folders of killed processes are the system's to clear away, and dask clears its own when it starts again.
    """
    first = path.parts[0]
    if first == "tmp":
        return len(path.parts) == 2 and not path.name.startswith(("vprbench-", "dask-", "pymp-"))
    is_unfinished = path.name.startswith(".") and path.name != ".locks"
    return first not in ("dask", "watch", "logs") and (is_unfinished or path.suffix == ".tmp")


def stored(results):
    return {f"{run.dataset}/{run.method}-{run.key}": run for run in Store(results).runs()}


def _equal(left, right):
    """Tell whether two runs gave the same answers, bit for bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for one, other in ((left, right), (left.outcome, right.outcome))
        for name in vars(one)
        if name in ("top_places", "top_scores", *vars(left.outcome))
    )


def main():
    """Make the serial run, disturb, report; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="of disturbance")
    parser.add_argument("--seed", type=int, default=0, help="of what is killed, and when")
    parser.add_argument("--cells", type=int, default=60, help=f"in steps of {len(METHODS)}")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    home = Path(tempfile.mkdtemp(prefix="chaos-"))
    chaos = Chaos(home, asked.cells, asked.seed)
    serial, began = ROOT / "build" / "chaos" / f"serial-{chaos.n_cells}", time.monotonic()
    code = chaos.begin("serial", "vprbench", *chaos.command, "timing=none", f"results={serial}").wait()
    right = stored(serial)
    print(f"serial run: {chaos.n_cells} cells in {time.monotonic() - began:.0f} s", flush=True)
    if code or len(right) < chaos.n_cells:
        print(f"the serial run failed: {(home / 'logs' / 'serial-1.log').read_text()[-2000:]}")
        return 1
    try:
        chaos.disturb(60 * asked.minutes, right)
    finally:
        chaos.end()
    kills = ", ".join(f"{kind} {chaos.kills[kind]}" for kind in KILLS)
    print(f"seed {asked.seed}, {asked.minutes:g} minutes; kills: {kills}; clients ended: {dict(chaos.ends)}")
    if not chaos.faults:
        shutil.rmtree(home)
    for fault in chaos.faults:
        print(f"FAULT {fault}")
    print(f"failed: {len(chaos.faults)} faults; logs in {home}" if chaos.faults else "passed")
    return 1 if chaos.faults else 0


if __name__ == "__main__":
    sys.exit(main())
