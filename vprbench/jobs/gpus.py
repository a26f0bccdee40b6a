"""GPUs for runs that are made side by side: each run has a GPU of its own, by a lock that the system frees."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence

from vprbench.runs.timing_lock import LOOK_EVERY, folder


@contextlib.contextmanager
def free_gpu(options: Sequence[str], given_up: Callable[[], bool]) -> Iterator[dict[str, str]]:
    """Yield the environment variables that name a free GPU; none for options of a run without `device=cuda`.

    Waits until a GPU is free, or `given_up`. A GPU that the options name by its number needs no variable.
    """
    device = next((option for option in reversed(options) if option.startswith("device=")), "")
    kind, _, number = device.removeprefix("device=").partition(":")
    names = _gpus() if kind == "cuda" else []
    if number.isdigit():
        names = names[int(number) :][:1]
    while names and not given_up():
        for name in names:
            with (folder() / f"gpu-{name}").open("ab") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                yield {} if number else {"CUDA_VISIBLE_DEVICES": name}
                return
        time.sleep(LOOK_EVERY)
    yield {}


@functools.cache
def _gpus() -> list[str]:
    """Return the GPUs that a process started here sees, by names that hold in every process of this host."""
    found = []
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        asked = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
        found = subprocess.run(asked, capture_output=True, text=True, timeout=30, check=False).stdout.split()
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is None:
        return found
    names = filter(None, map(str.strip, visible.split(",")))
    return [found[int(name)] if name.isdigit() and int(name) < len(found) else name for name in names]
