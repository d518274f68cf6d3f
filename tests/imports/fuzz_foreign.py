"""Read foreign files, each in a process of its own, and print what went wrong; the status is 1 then.

python -m tests.imports.fuzz_foreign FIRST COUNT    cases FIRST to FIRST + COUNT - 1, one after the other
"""

import collections
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

GROWTH_BYTES = 10**9
"""Resident memory may grow by this."""
ADDRESSES_BYTES = 8 << 30
"""Beyond this an allocation fails: whatever a case does, the machine goes on."""
SECONDS = 120
STATUSES = (0, 2, 3)


def main(first: int, count: int) -> int:
    import cv2
    import open3d
    import pyarrow.csv
    import pyarrow.parquet
    import rerun
    import scipy.spatial.transform

    import deformscope.cli.classify
    import deformscope.cli.doctor
    import deformscope.cli.recordings
    import deformscope.runs.importing
    from tests.imports.foreign_files import stores

    stores()
    loaded = (cv2, open3d, pyarrow, rerun, scipy, deformscope)
    assert all(loaded)
    kinds: collections.Counter[str] = collections.Counter()
    worst, failed, began = 0, 0, time.monotonic()
    for seed in range(first, first + count):
        folder = Path(tempfile.mkdtemp(prefix="foreign-"))
        try:
            kind, grown, found = read_case(seed, folder)
        finally:
            shutil.rmtree(folder)
        worst = max(worst, grown)
        kinds[kind] += 1
        failed += bool(found)
        for one in found:
            print(f"{seed} {kind}: {one}", flush=True)
        if (seed - first) % 500 == 499:
            print(f"# {seed - first + 1} read, {failed} failed, {time.monotonic() - began:.0f} s", flush=True)
    for kind, number in sorted(kinds.items()):
        print(f"# {kind}: {number}")
    print(f"# {count} cases: {failed} failed; memory grew by {worst / 1e6:.0f} MB at most")
    return int(failed > 0)


def read_case(seed: int, folder: Path) -> tuple[str, int, list[str]]:
    """Kind of a case and whether its last command took it, by how much memory grew [bytes], and what went wrong."""
    if (child := os.fork()) == 0:
        _child(seed, folder)
    _, ended, used = os.wait4(child, 0)
    text = (folder / "said").read_text(errors="replace") if (folder / "said").exists() else ""
    about, _, said = text.partition("\n")
    kind, _, resident = about.partition(" ")
    resident, said = (resident, said) if resident.isdigit() else ("0", text)  # it could not be made
    found = [f"{name} in {said[-1500:]}" for name in ("unexpected", "Traceback", "Warning") if name in said]
    if ended:
        how = f"signal {os.WTERMSIG(ended)}" if os.WIFSIGNALED(ended) else f"status {os.WEXITSTATUS(ended)}"
        found.append(f"ended by {how}: {said[-1500:]}")
    grown = used.ru_maxrss * 1024 - int(resident)
    if grown > GROWTH_BYTES:
        found.append(f"memory grew by {grown / 1e6:.0f} MB: {said[-500:]}")
    how = "refused" if said.endswith("= 2\n") else "taken"
    return f"{kind}, {how}", grown, found


def _child(seed: int, folder: Path) -> None:
    """Make and read a case; never returns. It fails with the status of the first command line that did, plus 100."""
    status = 1
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(SECONDS)
        out = os.open(folder / "said", os.O_CREAT | os.O_WRONLY | os.O_APPEND)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        from deformscope.cli import main as command
        from tests.imports.foreign_files import case

        (folder / "files").mkdir()
        kind, commands = case(seed, folder / "files")
        pages = Path("/proc/self/statm").read_text().split()
        mapped, resident = (int(one) * resource.getpagesize() for one in pages[:2])
        os.write(out, f"{kind} {resident}\n".encode())
        os.dup2(out, 2)
        resource.setrlimit(resource.RLIMIT_AS, (mapped + ADDRESSES_BYTES,) * 2)
        status = 0
        for one in commands:
            os.write(out, f"$ {' '.join(one)}\n".encode(errors="replace"))
            ended = _describe(Path(one[1]), one[2]) if one[0] == "describe" else command(one)
            status = status or (0 if ended in STATUSES else 100 + ended)
            os.write(out, f"= {ended}\n".encode())
    except BaseException:
        os.write(out, traceback.format_exc().encode(errors="replace"))
    finally:
        os._exit(status)


def _describe(folder: Path, name: str) -> int:
    """The status of a command that reads a rig file whose [shape] names a gripper."""
    from deformscope.errors import InputError
    from deformscope.rig.sections import ShapeSection
    from deformscope.robot.description import describe

    try:
        describe(ShapeSection(gripper=name), None, folder)
    except InputError:
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
