"""How late a thread with the robot's control period comes while a rig is recorded beside it: nothing recorded, portions
flushed every second, and portions flushed as they are, in turns.

python -m tests.log.control_period 12        twelve rounds of 10 s each way
"""

import argparse
import dataclasses
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.commanded_robot import without_long_pauses
from deformscope.frames import Item
from deformscope.log.layout import RIG, RigLayout
from deformscope.recording import recorder, rrd_file
from deformscope.robot.readings import PERIOD_NS
from deformscope_drivers.pacing import STEERING, be_prompt
from tests.log import synthetic_rig as rig
from tests.log.long_recording import ROUND_S, STREAMS, first_round, later

ROUND_TIME_S = 10.0
PERIOD_S = PERIOD_NS / 1e9
WORK_S = 5e-4
"""A control period keeps a processor so long."""
WAYS = {"nothing recorded": None, "flushed every 1 s": 1.0, "flushed every 0.15 s": 0.15}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rounds", type=int)
    given = parser.parse_args()
    batches = list(rig.batches(first_round(cameras=True)))
    found: dict[str, list[FloatArray]] = {name: [] for name in WAYS}
    with tempfile.TemporaryDirectory() as folder, without_long_pauses():
        for number in range(given.rounds):
            for name, gather_s in WAYS.items():
                write = None if gather_s is None else recorded(Path(folder) / f"{number}.rrd", gather_s)
                found[name].append(periods(write, batches))
                for path in Path(folder).iterdir():
                    path.unlink()
    for name, gaps_s in found.items():
        ms = 1e3 * np.concatenate(gaps_s)
        shares = np.percentile(ms, [50, 90, 99, 99.9, 100]).round(2)
        print(f"{name}: {len(ms)} periods, 50, 90, 99, 99.9, 100 of 100 within {shares} ms", flush=True)


def recorded(path: Path, gather_s: float) -> recorder.Recorder:
    """A recorder of a rig. gather_s: what is gathered, and flushed, together [s]"""
    recorder.GATHER_LIVE_S = rrd_file.BEAT_S = gather_s
    return recorder.Recorder(path, "none", {}, application=RIG, real_time=True)


def periods(into: recorder.Recorder | None, batches: list[list[Item]]) -> FloatArray:
    """(n,) from one control period to the next [s], while a rig's items are recorded at their own pace."""
    gaps_s: list[float] = []
    over = threading.Event()
    thread = threading.Thread(target=cycle, args=(gaps_s, over))
    if into is None:
        thread.start()
        play(batches, lambda items: None)
    else:
        with into:
            into.start(RigLayout(tuple(STREAMS)), rig.START_NS)
            thread.start()
            play(batches, into.write)
            over.set()
    over.set()
    thread.join()
    return np.array(gaps_s)


def play(batches: list[list[Item]], write: Callable[[list[Item]], None]) -> None:
    began_s = time.monotonic()
    for at, items in enumerate(endless(batches)):
        time.sleep(max(0.0, began_s + at * ROUND_S / len(batches) - time.monotonic()))
        if time.monotonic() - began_s > ROUND_TIME_S:
            return
        write(items)


def endless(batches: list[list[Item]]) -> Iterator[list[Item]]:
    number = 0
    while True:
        for batch in batches:
            yield [dataclasses.replace(item) for item in later(batch, number)]
        number += 1


def cycle(gaps_s: list[float], over: threading.Event) -> None:
    """As the robot's thread does: wait for the next period, compute, and so on."""
    be_prompt(STEERING)
    before_s = due_s = time.monotonic()
    while not over.is_set():
        due_s = max(due_s + PERIOD_S, time.monotonic() + PERIOD_S / 2)  # what came late is not made up for
        time.sleep(max(0.0, due_s - time.monotonic()))
        now_s = time.monotonic()
        gaps_s.append(now_s - before_s)
        before_s = now_s
        while time.monotonic() - now_s < WORK_S:
            pass


if __name__ == "__main__":
    main()
