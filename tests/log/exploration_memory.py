"""Explore a simulated table, and print every 20 s which touch it is at and what memory its processes have [MB], the
exploring one first.

python -m tests.log.exploration_memory run.rrd 40
python -m tests.log.exploration_memory run.rrd 47 --hold 60    an hour of simulated time
"""

import argparse
import contextlib
import re
import subprocess
import sys
import time
from pathlib import Path

EVERY_S = 20.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("touches")
    parser.add_argument("--hold", default="0")
    given = parser.parse_args()
    # a small inclusion may be missed for long, so that it goes on as long as it is asked for touches
    rule = "--smallest-inclusion", "0.02", "--threshold", "1e-9", "--touches", given.touches, "--hold", given.hold
    command = [sys.executable, "-m", "deformscope", "explore", "lab:two-60-150", "--seed", "3", *rule]
    log = given.file.with_suffix(".log")
    with log.open("wb") as said:
        process = subprocess.Popen([*command, "--record", given.file], stdout=said, stderr=said)
        began_s = time.monotonic()
        while process.poll() is None:
            time.sleep(EVERY_S)
            touch = re.findall(rb"touch (\d+)", log.read_bytes())
            sizes = " ".join(f"{one:.0f}" for one in resident_mb(process.pid))
            print(f"{time.monotonic() - began_s:.0f} s, touch {int(touch[-1]) if touch else 0}: {sizes}", flush=True)
    sys.exit(process.returncode)


def resident_mb(pid: int) -> list[float]:
    """Of a process and of those that it made, by their ids."""
    of: dict[int, tuple[int, float]] = {}
    for status in Path("/proc").glob("[0-9]*/status"):
        with contextlib.suppress(OSError):  # one that has ended
            known = dict(re.findall(r"(PPid|VmRSS):\s+(\d+)", status.read_text()))
            of[int(status.parent.name)] = int(known["PPid"]), int(known.get("VmRSS", 0)) / 1e3
    own = [pid]
    for one in own:
        own += [child for child, (parent, _) in sorted(of.items()) if parent == one]
    return [of[one][1] for one in own if one in of]


if __name__ == "__main__":
    main()
