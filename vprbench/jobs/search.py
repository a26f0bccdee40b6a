"""Exact search of a large map spread over a dask cluster: each worker searches its parts, the best are merged here."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from vprbench.api.nearest import Nearest, Part
from vprbench.api.search import Mapped
from vprbench.errors import BadInput
from vprbench.runs.shortlist import searching

if TYPE_CHECKING:
    from distributed import Client


def spread(client: Client) -> Mapped:
    """Return what stands in for `map` in `Search.nearest`: the same answers, found by the workers of a cluster.

    They read shards from the files that the client names. A part is searched by the same worker each time, so the
    memory of each host holds its own shards; a worker that is lost has its parts searched by others.
    """

    def mapped(function: Callable[[Part], Nearest], parts: Sequence[Part]) -> list[Nearest]:
        client.wait_for_workers(1)
        workers = sorted(client.nthreads())
        asked = client.scatter(function, broadcast=True, hash=False)  # the codes, once for each worker
        found = [
            client.submit(_search, asked, part, pure=False, workers=workers[n % len(workers)], allow_other_workers=True)
            for n, part in enumerate(parts)
        ]
        gathered: list[Nearest] = client.gather(found)
        return gathered

    return mapped


_PATIENCE = 20.0  # seconds until a scheduler has answered


@contextmanager
def spread_over(address: str | None) -> Iterator[None]:
    """Let the workers of a running cluster search large maps inside the block; None: this process does.

    Raises BadInput if nobody answers at the address.
    """
    if address is None:
        yield
        return
    if importlib.util.find_spec("distributed") is None:
        raise BadInput(f"search_scheduler={address}: distributed is not installed: pip install vprbench[cluster]")
    from distributed import Client

    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BadInput(f"search_scheduler={address}: no dask scheduler answers there ({error})") from error
    with client, searching(spread(client)):
        yield


def _search(function: Callable[[Part], Nearest], part: Part) -> Nearest:
    return function(part)
