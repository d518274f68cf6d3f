"""Record all devices at their full rates for hours of recorded time, as fast as the recorder takes it, and print what
memory that needs.

python -m tests.log.long_recording run.rrd 7200            without cameras
python -m tests.log.long_recording run.rrd 600 --cameras
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Iterator
from pathlib import Path

from deformscope.frames import ColorFrame, DepthFrame, HealthReport, Item, LinkChange, RawBytes, host_ns
from deformscope.log.rig_layout import RIG, RigLayout
from deformscope.recording.recorder import Recorder
from deformscope_drivers.clock import Stamp
from tests.log import synthetic_rig as rig

ROUND_S = 4
"""So much is made up, and recorded again and again with later stamps."""
PER_SECOND = {stream.device: round(stream.fastest_hz) for stream in rig.STREAMS}
STREAMS = [dataclasses.replace(one, urdf=rig.URDF) if one.kind == "arm" else one for one in rig.STREAMS]
LINES = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("seconds", type=int)
    parser.add_argument("--cameras", action="store_true")
    given = parser.parse_args()
    batches = list(rig.batches(first_round(cameras=given.cameras)))
    streams = [one for one in STREAMS if given.cameras or one.kind not in ("color", "depth")]
    rounds, making_s, began_s = given.seconds // ROUND_S, 0.0, time.process_time()
    with Recorder(given.file, "none", {}, application=RIG) as made:
        made.start(RigLayout(tuple(streams)), rig.START_NS)
        for number in range(rounds):
            for batch in batches:
                making_s -= time.thread_time()
                items = list(later(batch, number))
                making_s += time.thread_time()
                made.write(items)
            if number % max(1, rounds // LINES) == 0 or number == rounds - 1:
                size = made.summary().bytes / 1e6
                print(f"{(number + 1) * ROUND_S} {resident_mb():.0f} {size:.0f}", flush=True)
    cost_s = (time.process_time() - began_s - making_s) / given.seconds
    print(f"{made.summary().bytes / 1e6:.1f} MB; {1e3 * cost_s:.1f} ms of processor a recorded second", flush=True)


def first_round(*, cameras: bool) -> list[Item]:
    found = rig.items(ROUND_S) if cameras else rig.items(ROUND_S, (24, 32))
    left_out = (LinkChange,) if cameras else (LinkChange, ColorFrame, DepthFrame)
    return [one for one in found if not isinstance(one, left_out) and host_ns(one) < rig.ns(ROUND_S)]


def later(items: list[Item], rounds: int) -> Iterator[Item]:
    """The same so many rounds later."""
    shift_ns = rounds * ROUND_S * 1_000_000_000
    for item in items:
        if isinstance(item, RawBytes | HealthReport):
            yield dataclasses.replace(item, host_ns=item.host_ns + shift_ns)
        elif not isinstance(item, LinkChange):
            stamp = Stamp(item.stamp.host_ns + shift_ns, item.stamp.device_ticks)
            yield dataclasses.replace(item, stamp=stamp, index=item.index + rounds * ROUND_S * PER_SECOND[item.device])


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
