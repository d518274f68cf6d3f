"""Memory of a body: of the process on a CPU, of the device's pool on a GPU."""

import gc
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from deformscope.bench.bodies import counted, cube
from deformscope.bench.plan import BenchPlan, Note, side_of
from deformscope.bench.report import Stepping
from deformscope.bench.timing import OURS, TimingRow
from deformscope.processes import release_memory

MEMORY_LEAST = 10_000
"""Number of particles below which a body's memory cannot be seen in that of the process, which grows in pages and
pools."""


class Meter:
    """Counter of bytes in use since it was last set to zero. `peak` is the largest number since then; None if the
    system does not report it."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._base: int | None = None
        self._gpu = device != "cpu"
        self.zero()

    def zero(self) -> None:
        """Set the counter to zero. On Linux the kernel forgets the process's highest mark."""
        gc.collect()
        if self._gpu:
            if not wp.is_mempool_supported(self._device):
                return
            wp.synchronize_device(self._device)
            self._base = wp.get_mempool_used_mem_current(self._device)
            self._highest = wp.get_mempool_used_mem_high(self._device)
            return
        release_memory()  # what is free would hide what is taken next
        try:
            Path("/proc/self/clear_refs").write_text("5")
        except OSError:
            self._base = None
            return
        self._base = _status("VmRSS")

    def peak(self) -> int | None:
        """The most bytes in use since zero; on a GPU None if an earlier body used more: its pool does not shrink."""
        if self._base is None:
            return None
        if self._gpu:
            wp.synchronize_device(self._device)
            highest = wp.get_mempool_used_mem_high(self._device)
            return highest - self._base if highest > self._highest else None
        highest_rss = _status("VmHWM")
        return None if highest_rss is None else highest_rss - self._base


def _status(name: str) -> int | None:
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in text.splitlines() if line.startswith(f"{name}:")), None)


def memory(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """What setting up and stepping of ever larger cubes take; no rows where the system does not report it."""
    for particles in plan.sizes:
        if plan.cpu and particles < MEMORY_LEAST:
            continue
        what, body = counted(particles), cube(side_of(particles))
        note(f"memory: {what}")
        meter = Meter(plan.device)
        engine = plan.engine(body, precision="float32")
        built = meter.peak()
        meter.zero()
        stepping = Stepping(engine, body, plan)
        peaks = {"set-up": built, "stepping": meter.peak()}
        del engine, stepping  # the next cube finds their memory free
        where = "process" if plan.cpu else "device"
        for doing, peak in peaks.items():
            if peak is not None:
                yield TimingRow("memory", f"{what}, {doing}", OURS, f"B/particle ({where})", (peak / particles,))
