"""The rate of a query timed alone, in the timing slot of a busy sweep, and beside that sweep: `make slot-check`.

A machine's speed may drift by more than what is asked here, so the three are taken within seconds of one another, in a
random order, again and again; what counts is their ratio. The exit code is 0 if the median rate in the slot is within
5 % of that of the machine without any sweep.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vprbench.api import Images
from vprbench.methods.sad import SAD
from vprbench.run import slot

SECONDS = 4.0  # of queries
SWEEP = (
    "-m method=vprtempo,pca,gabor,flyhash seed=0,1,2 dataset=synthetic dataset.places=2000 "
    "workers=4 threads=1 timing=none frames=false"
)
WITHIN = 0.05


def rate(method: SAD, image: Images) -> float:
    """Return queries a second, 1 / median, of one image after the other."""
    laps, end = [], time.perf_counter() + SECONDS
    while (began := time.perf_counter()) < end:
        method.query(image)
        laps.append(time.perf_counter() - began)
    return 1 / float(np.median(laps))


@contextlib.contextmanager
def sweep(home: Path) -> Iterator[None]:
    """Keep both cores busy with cells of a sweep, from the moment that two of them run."""
    command = [sys.executable, "-m", "vprbench", *SWEEP.split(), f"results={home}"]
    with (home / "log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
    try:
        while sum(1 for _ in (slot.folder() / "running").iterdir()) < 2:
            if process.poll() is not None:
                raise SystemExit(f"the sweep ended: {(home / 'log').read_text()[-2000:]}")
            time.sleep(0.1)
        time.sleep(2.0)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def main() -> int:
    """Print the rates of each round and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    chance, drawn = random.Random(asked.seed), np.random.default_rng(asked.seed)
    frames = drawn.integers(256, size=(2761, 32, 64, 3), dtype=np.uint8)
    method = SAD().fit(Images.from_arrays([*frames]), np.arange(len(frames)))
    one = Images.from_arrays([frames[0]])
    ratios: dict[str, list[float]] = {"slot": [], "beside": []}
    with tempfile.TemporaryDirectory() as home:
        os.environ[slot.FOLDER] = str(Path(home) / "slot")  # handed on to the sweep
        (slot.folder() / "running").mkdir()
        for number in range(asked.rounds):
            found: dict[str, float] = {}
            for arm in chance.sample(["alone", "slot", "beside"], 3):
                with contextlib.ExitStack() as stack:
                    if arm != "alone":
                        stack.enter_context(sweep(Path(home)))
                    if arm == "slot":
                        stack.enter_context(slot.alone())
                    found[arm] = rate(method, one)
            for arm, each in ratios.items():
                each.append(found[arm] / found["alone"])
            print(
                f"round {number}: " + ", ".join(f"{arm} {hz:,.0f} Hz" for arm, hz in sorted(found.items())), flush=True
            )
    for arm, each in ratios.items():
        medians = np.median(drawn.choice(each, (10_000, len(each))), axis=1)
        low, high = np.quantile(medians, (0.025, 0.975))
        print(f"{arm} / alone: median {np.median(each):.3f}, 95 % interval [{low:.3f}, {high:.3f}]")
    return int(abs(float(np.median(ratios["slot"])) - 1) > WITHIN)


if __name__ == "__main__":
    sys.exit(main())
