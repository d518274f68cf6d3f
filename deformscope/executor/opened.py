"""Opens the workers that the flags request."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from deformscope.executor.local import HereWorker, LocalWorkers, core_count
from deformscope.executor.tasks import Workers


@contextmanager
def open_workers(
    executor: str, address: str | None, workers: int | None, tasks: int | None = None, *, apart: bool = False
) -> Iterator[Workers]:
    """The workers, which are ended at the end of the context, even during a computation.

    executor: `local`, or `ray` at this address; workers: most workers, default: one for each core of this machine or of
    the cluster; tasks: how many there are, None = not known; apart: use a child process even for a single worker.
    Raises InputError if nothing answers at the address."""
    made: Workers
    if executor == "ray":
        from deformscope.executor.ray_cluster import RayWorkers

        made = RayWorkers(address or "", workers)
    else:
        count = core_count() if workers is None else workers
        count = max(count if tasks is None else min(count, tasks), 1)
        made = LocalWorkers(count) if apart or count > 1 else HereWorker()
    try:
        yield made
    finally:
        made.close()
