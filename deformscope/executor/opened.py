"""Which workers compute, as the flags say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from deformscope.executor.local import HereWorker, LocalWorkers, core_count
from deformscope.executor.tasks import Workers


@contextmanager
def open_workers(
    executor: str, address: str | None, workers: int | None, tasks: int | None = None, *, apart: bool = False
) -> Iterator[Workers]:
    """Workers, which are ended at the end whatever they compute then.

    executor: `local`, or `ray` at this address; workers: at most, default: this machine's cores, or the cluster's
    tasks: how many there are, None = not known; apart: a single one is a child process too Raises InputError if nothing
    answers at the address.
    """
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
