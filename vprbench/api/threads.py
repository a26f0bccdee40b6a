"""Rows of arrays shared among threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.images import Images

_BLOCK = 64  # images that are encoded together, at most
_FEWEST = 8  # images that threads share: fewer are done before a thread has started
_BLOCKS_BYTES = 1 << 25  # of all images that are held at once, about


def in_shares(work: Callable[[slice], None], n: int, threads: int, shares: int = 1) -> None:
    """Call `work` with slices that make up 0 to `n`: `shares` of them a thread, whoever is ready first takes the next.

    Without threads to share with there is one slice, and none of nothing. Raises what `work` raises.
    """
    count = min(threads * shares, n) if threads > 1 else min(n, 1)
    parts = [slice(*ends) for ends in pairwise(np.linspace(0, n, count + 1).astype(int).tolist())]
    if count < 2:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(min(threads, count)) as pool:
        list(pool.map(work, parts))


def encode_blocks(
    images: Images,
    codes: npt.NDArray[Any],
    encode: Callable[[Sequence[Image], npt.NDArray[Any]], None],
) -> None:
    """Fill `codes` (n_images, ...) by `encode(images, codes)`, a block of images after the other, read in order.

    All threads that PyTorch may use encode: the one that reads does so if the others are busy.
    """
    threads = _count_threads() if len(images) >= _FEWEST else 1
    size, n_bytes = min(_BLOCK, -(-len(images) // threads)), _BLOCKS_BYTES // (threads + 1)  # one is being gathered
    if threads == 1:
        for start, block in _read_blocks(images, size, n_bytes):
            encode(block, codes[start : start + len(block)])
        return
    worked: list[float] = []  # seconds of all threads

    def work(block: Sequence[Image], own: npt.NDArray[Any]) -> None:
        started = time.thread_time()
        encode(block, own)
        worked.append(time.thread_time() - started)

    started, read = time.perf_counter(), images.reading.seconds
    with ThreadPoolExecutor(threads - 1) as pool:
        others: list[Future[None]] = []
        for start, block in _read_blocks(images, size, n_bytes):
            own = codes[start : start + len(block)]
            if sum(not other.done() for other in others) < threads - 1:
                others.append(pool.submit(work, block, own))
            else:  # this thread would only wait, with ever more images in memory
                work(block, own)
        for other in others:
            other.result()
    # While others worked, waiting for images was no loss: without waiting the work would have taken as long.
    images.reading.limit(read, time.perf_counter() - started - sum(worked) / threads)


def _count_threads() -> int:
    import torch  # slow to import, and few images need no threads

    return torch.get_num_threads()


def _read_blocks(images: Images, size: int, n_bytes: int) -> Iterator[tuple[int, list[Image]]]:
    """Yield the images, read in order, in lists with the number of the first; `size` or `n_bytes` end a list."""
    block: list[Image] = []
    held = 0
    for number, image in enumerate(images):
        block.append(image)
        held += image.nbytes
        if len(block) == size or held >= n_bytes or number == len(images) - 1:
            yield number + 1 - len(block), block
            block, held = [], 0
