"""Record all devices at their full rates for hours of recorded time, as fast as the recorder takes it, and print what
memory that needs.

python -m tests.log.long_recording run.rrd 7200            without cameras
python -m tests.log.long_recording run.rrd 600 --cameras
python -m tests.log.long_recording run.rrd 3600 --touches   an exploration, a touch every 12 s
"""

import argparse
import dataclasses
import os
import time
from collections.abc import Iterator
from pathlib import Path

from deformscope.frames import ColorFrame, DepthFrame, HealthReport, Item, LinkChange, RawBytes, host_ns
from deformscope.log.layout import EXPLORATION, RIG, ExplorationLayout, RigLayout
from deformscope.recording.recorder import Recorder
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import PlannedTouch
from deformscope_drivers.clock import Stamp
from tests.log import synthetic_exploration as exploration
from tests.log import synthetic_rig as rig

ROUND_S = 4
"""So much is made up, and recorded again and again with later stamps."""
PER_SECOND = {stream.device: round(stream.fastest_hz) for stream in rig.STREAMS}
STREAMS = [dataclasses.replace(one, urdf=rig.URDF) if one.kind == "arm" else one for one in rig.STREAMS]
LINES = 20
SIZE_M = (0.6, 0.4)
ROUNDS_A_TOUCH = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("seconds", type=int)
    parser.add_argument("--cameras", action="store_true")
    parser.add_argument("--touches", action="store_true")
    given = parser.parse_args()
    batches = list(rig.batches(first_round(cameras=given.cameras)))
    streams = [one for one in STREAMS if given.cameras or one.kind not in ("color", "depth")]
    rounds, making_s, began_s = given.seconds // ROUND_S, 0.0, time.process_time()
    layout = ExplorationLayout(tuple(streams), SIZE_M, None, True) if given.touches else RigLayout(tuple(streams))
    with Recorder(given.file, "none", {}, application=EXPLORATION if given.touches else RIG) as made:
        made.start(layout, rig.START_NS)
        for number in range(rounds):
            if given.touches and number % ROUNDS_A_TOUCH == 0:
                for step in touch(number // ROUNDS_A_TOUCH, rig.START_NS + number * rig.ns(ROUND_S)):
                    made.write(step)
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


def touch(number: int, now_ns: int) -> Iterator[Step]:
    """What is recorded of a touch, and the plan of the next; results are those of one of eight touches."""
    which = number % len(exploration.CONTACTS_M)
    for _, touches, result in exploration.story():
        if touches == which + 1:
            plan_is_over = isinstance(result, PlannedTouch) and result.target_m is None
            shown = exploration.plan(1) if plan_is_over else result
            yield Step((shown,), moment=Moment(now_ns, number + 1, cell_m=exploration.CELL_M))


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
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
