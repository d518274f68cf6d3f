"""Runs the commands of the console blocks in README and docs, and compares what they print with what the pages show.

python tools/printed.py [--write] [PAGE...]

A console block is fenced as ```console. `$ COMMAND` is typed in an empty folder, and what it prints on stdout follows;
`...` stands for lines that are left out. Where lines are left out, each line shown is found by the name of its row.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
"""Their prints are shown as text, and `tests/test_site.py` types them."""
PAGES = [ROOT / "README.md", *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent != TUTORIALS)]
PAGES += [*sorted((ROOT / "drivers").glob("*.md")), ROOT / "recordings" / "README.md"]
FENCE = re.compile(r"^```(\w*)(?: [^\n]*)?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.(\d+))?")
LEFT_OUT = "..."
OF_THE_MACHINE = ("time", "recording", "supervisor looked")
"""Rows whose values are times of this machine, and names with a stamp: of these the name alone is compared."""
PROMPT = "$ "


@dataclass(frozen=True, slots=True)
class Printed:
    """A command in a page, and the lines that the page shows of what it prints."""

    page: Path
    command: str
    shown: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}: {self.command}"


def printed(page: Path) -> list[Printed]:
    """The commands of a page's console blocks, in their order."""
    found: list[tuple[str, list[str]]] = []
    for kind, body in FENCE.findall(page.read_text(encoding="utf-8")):
        for line in body.splitlines() if kind == "console" else ():
            if line.startswith(PROMPT):
                found.append((line.removeprefix(PROMPT), []))
            else:
                found[-1][1].append(line)
    return [Printed(page, command, tuple(shown)) for command, shown in found]


def typed(command: str, folder: Path) -> list[str]:
    """What a command prints on stdout, in a folder; `make demo` is what the Makefile makes of it. Raises RuntimeError
    where it fails."""
    name, *words = shlex.split(command, comments=True)
    if name not in ("deformscope", "make"):
        raise RuntimeError(f"{command}: not a command of ours")
    kept = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    paths = os.pathsep.join([str(ROOT), str(ROOT / "drivers")])
    line = [sys.executable, "-m", "deformscope", *words]
    done = subprocess.run(line, cwd=folder, env=kept | {"PYTHONPATH": paths}, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command}: exit status {done.returncode}: {done.stderr[-500:]}")
    return done.stdout.splitlines()


def renewed(shown: Sequence[str], came: Sequence[str]) -> list[str]:
    """What a page is to show of the lines that came. Raises LookupError for a row that came no longer."""
    if LEFT_OUT not in shown:
        return list(came)
    found, at = [], 0
    for line in shown:
        if line != LEFT_OUT:
            at = next((index for index in range(at, len(came)) if row_of(came[index]) == row_of(line)), -1)
            if at < 0:
                raise LookupError(f"no row {row_of(line)!r} among what came:\n" + "\n".join(came))
            line, at = came[at], at + 1
        found.append(line)
    return found


def row_of(line: str) -> str:
    """The name of a row of a table."""
    return re.split(r"\s{2,}", line.strip())[0]


def is_same(shown: str, came: str) -> bool:
    """Whether two lines say the same: numbers as they are printed, give or take one in the last place, as rounding
    falls differently with the kernels of another processor."""
    if row_of(shown) == row_of(came) in OF_THE_MACHINE:
        return True
    if NUMBER.sub("#", shown) != NUMBER.sub("#", came):
        return False
    pairs = zip(NUMBER.finditer(shown), NUMBER.finditer(came), strict=True)
    return all(
        a[0] == b[0] or abs(float(a[0]) - float(b[0])) <= 1.01 * 10.0 ** -min(len(a[1] or ""), len(b[1] or ""))
        for a, b in pairs
    )


def differing(one: Printed, came: Sequence[str]) -> list[str]:
    """In which lines a page shows what did not come; none where it is true."""
    now = renewed(one.shown, came)
    if len(now) != len(one.shown):
        return [f"{len(one.shown)} lines are shown, {len(now)} came", *now]
    return [f"- {a}\n+ {b}" for a, b in zip(one.shown, now, strict=True) if not is_same(a, b)]


def write(page: Path, every: Sequence[tuple[Printed, Sequence[str]]]) -> None:
    """Put what came into the page's console blocks."""
    lines = iter(every)

    def block(found: re.Match[str]) -> str:
        if found[1] != "console":
            return found[0]
        text = ""
        for _ in re.findall(r"^\$ ", found[2], re.MULTILINE):
            one, came = next(lines)
            text += "".join(f"{line}\n" for line in (PROMPT + one.command, *renewed(one.shown, came)))
        return f"```console\n{text}```"

    page.write_text(FENCE.sub(block, page.read_text(encoding="utf-8")), encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", type=Path, nargs="*", metavar="PAGE", help="default: all")
    parser.add_argument("--write", action="store_true", help="put what is printed now into the pages")
    arguments = parser.parse_args()
    differs = 0
    for page in [one.resolve() for one in arguments.pages] or PAGES:
        every = []
        with tempfile.TemporaryDirectory() as folder:
            for one in printed(page):
                every.append((one, typed(one.command, Path(folder))))
                wrong = differing(*every[-1])
                differs += bool(wrong)
                print("\n".join([f"{one}: {'DIFFERS' if wrong else 'as shown'}", *wrong]), flush=True)
        if arguments.write and every:
            write(page, every)
    return 1 if differs and not arguments.write else 0


if __name__ == "__main__":
    sys.exit(main())
