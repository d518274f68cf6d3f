"""What the page does to a robot and to its recording: python tools/page_robustness.py [--seconds 600]

Explores, or records, a rig of doubles on the host's clock while its page is absent, open, hidden, frozen (SIGSTOP),
killed, and loaded again 50 times, in a browser at nice 19, as is what steers it; before that for a part of the time
without a page. Prints a table, and exits with 1 unless all hold:

- readings: each sample of the force sensor from the first to the last is in the file, by the double's own counter; of
  every device the file holds as many frames as its driver took, and counts no loss
- the supervisor's period, 99 of 100 looks: within 12 ms, or not longer than without a page (of 1000 looks at least)
  (not with --command record, which any machine can do: where others take the processor, a supervisor stops the arm)
- memory of the command and of the browser, after the first and at the end of the time

In six minutes: python tools/page_robustness.py --seconds 200 --without 60

Where Linux shares processors out by sessions (autogroup), nice 19 counts within one alone. The command has a session of
its own, therefore, and that of this program is at nice 19 meanwhile: with both in one, the kernel's own threads, which
pass a serial port's bytes on, were held up for 0.1 s and more.

A headless browser knows no hidden tab: it is made of what a page has of it, which is that it says so and gets no frames
to draw. Needs playwright and chromium (CHROMIUM=path).
"""

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RIG = """
[devices.arm]
driver = "jaco"
double = true
state_hz = 100
command_deadline_s = 0.5
[devices.tip]
driver = "optoforce"
double = true
port = "/dev/double"
rate_hz = 333
[devices.depth]
driver = "depth_camera"
double = true
fps = 5
[surface]
scene = "two-60-150"
T_arm_surface = [[1, 0, 0, -0.30], [0, 1, 0, -0.55], [0, 0, 1, 0], [0, 0, 0, 1]]
[tool]
compliance_m_per_n = 2e-4
compliance_sd = 2e-5
[workspace]
low_m = [-0.40, -0.66, 0.0]
high_m = [0.45, 0.10, 0.75]
# doubles share the machine with what reads them
force_silent_s = 0.5
arm_silent_s = 0.5
camera_silent_s = 0.5
"""
HIDEABLE = """
{
  const draw = window.requestAnimationFrame.bind(window);
  const waiting = [];
  let hidden = false;
  window.requestAnimationFrame = (call) => (hidden ? waiting.push(call) : draw(call));
  Object.defineProperty(document, "visibilityState", { get: () => (hidden ? "hidden" : "visible") });
  window.setHidden = (value) => {
    hidden = value;
    document.dispatchEvent(new Event("visibilitychange"));
    if (!hidden) waiting.splice(0).forEach((call) => draw(call));
  };
}
"""
FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
         "--ignore-gpu-blocklist", "--remote-debugging-port=0", "--window-size=1280,800")  # fmt: skip
DEVICES = ("arm", "tip", "depth")
MOST_MS = 12.0
LEAST_LOOKS = 1000
"""Without a page, or its period is not known."""
LOADS = 50
WAIT_S = 60.0
COUNTER = 1 << 16
"""The force sensor's counter begins anew after so many samples."""


@dataclass(slots=True)
class Memory:
    """Of some processes, now and then. at: (time [s], bytes)"""

    group: int
    seen: list[tuple[float, int]] = field(default_factory=list)

    def look(self) -> None:
        total = 0
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError, ValueError, IndexError):
                fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
                if int(fields[2]) == self.group:
                    found = re.search(r"^Pss:\s+(\d+)", (folder / "smaps_rollup").read_text(), re.MULTILINE)
                    total += int(found[1]) << 10 if found else 0
        if total:
            self.seen.append((time.monotonic(), total))

    def words(self) -> str:
        """After the first third, at the end, and the slope of what is between."""
        if len(self.seen) < 6:
            return "too short to say"
        late = np.array(self.seen[len(self.seen) // 3 :], float)
        slope = np.polyfit((late[:, 0] - late[0, 0]) / 60.0, late[:, 1] / 1e6, 1)[0]
        return f"{late[0, 1] / 1e6:.0f} MB, at the end {late[-1, 1] / 1e6:.0f} MB, {slope:+.1f} MB/min"


class Browser:
    """Chromium at nice 19, in a process group of its own."""

    def __init__(self, playwright: Any) -> None:
        folder = Path(tempfile.mkdtemp())
        program = os.environ.get("CHROMIUM", "/usr/bin/chromium")
        modest = ["setpriv", "--bounding-set=-sys_nice"] if os.geteuid() == 0 else []  # root's would raise itself again
        self.process = subprocess.Popen(
            [*modest, "nice", "-n", "19", program, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            process_group=0,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = folder / "DevToolsActivePort"
        until(lambda: port.exists() and len(port.read_text().split()) == 2)
        self._connected = playwright.chromium.connect_over_cdp(f"http://127.0.0.1:{port.read_text().split()[0]}")
        self.page = self._connected.contexts[0].pages[0]
        self.page.add_init_script(HIDEABLE)

    def load(self, address: str) -> None:
        """Until the page has a state of the server's."""
        self.page.goto(address, wait_until="domcontentloaded", timeout=1e3 * WAIT_S)
        until(lambda: self.page.evaluate("document.getElementById('phase').dataset.phase"))

    def signal(self, number: signal.Signals) -> None:
        os.killpg(self.process.pid, number)


@contextlib.contextmanager
def modestly() -> Iterator[None]:
    """What this thread begins runs at nice 19, as does this program's session; the thread itself stays there."""
    autogroup, before = Path("/proc/self/autogroup"), ""
    os.setpriority(os.PRIO_PROCESS, 0, 19)
    with contextlib.suppress(OSError, IndexError):  # sessions have no share of their own
        before = autogroup.read_text().split()[-1]
        autogroup.write_text("19")
    try:
        yield
    finally:
        if before:
            with contextlib.suppress(OSError):  # set twice within 0.1 s, or a negative one, by others than root
                autogroup.write_text(before)


def until(happened: Any) -> None:
    deadline = time.monotonic() + WAIT_S
    while not happened():
        if time.monotonic() > deadline:
            raise TimeoutError("it never happened")
        time.sleep(0.05)


@contextlib.contextmanager
def running(what: str, folder: Path, name: str, viewer: str) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """The command, and the lines that it has written so far; ended by Ctrl-C."""
    (folder / "rig.toml").write_text(RIG)
    words = [what, "rig.toml", "--viewer", viewer]
    # inclusions so small that it does not stop by itself meanwhile
    endless = ["--touches", "1000", "--threshold", "1e-6", "--smallest-inclusion", "0.02", "--beta-model", "none"]
    words += endless if what == "explore" else []
    words += ["--record", f"{name}.rrd", "--json", f"{name}.json"]
    command = [sys.executable, "-m", "deformscope", *words]
    paths = [str(ROOT), str(ROOT / "drivers"), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}  # this checkout, whatever is installed
    process = subprocess.Popen(command, cwd=folder, env=env, stderr=subprocess.PIPE, text=True, start_new_session=True)
    lines: list[str] = []
    assert process.stderr is not None
    reader = threading.Thread(target=_read, args=(process.stderr, lines))
    reader.start()
    try:
        until(lambda: process.poll() is not None or (folder / f"{name}.part.rrd").exists())
        yield process, lines
        process.send_signal(signal.SIGINT)
        process.wait(2 * WAIT_S)
    finally:
        if process.poll() is None:
            process.kill()
        reader.join()


def _read(stream: IO[str], lines: list[str]) -> None:
    for line in stream:
        lines.append(line)


def go_on(seconds: float, process: subprocess.Popen[str], lines: list[str], *memories: Memory) -> None:
    """Let it explore. Raises RuntimeError where it ends by itself."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if process.poll() is not None:
            raise RuntimeError(f"the command ended by itself with status {process.returncode}: {lines[-1:]}")
        for memory in memories:
            memory.look()
        time.sleep(min(2.0, max(0.0, end - time.monotonic())))


def with_a_page(what: str, folder: Path, seconds: float) -> tuple[Memory, list[tuple[str, Memory]]]:
    """One run through all that can become of a page."""
    from playwright.sync_api import sync_playwright

    browsers: list[tuple[str, Memory]] = []
    with running(what, folder, "page", "page") as (process, lines), modestly(), sync_playwright() as playwright:
        until(lambda: any("http://" in line for line in lines))
        address = next(word for line in lines for word in line.split() if word.startswith("http://"))
        memory = Memory(process.pid)

        def stage(name: str, share: float, browser: Browser | None = None) -> None:
            print(f"{name}: {share * seconds:.0f} s", flush=True)
            looks = [memory]
            if browser is not None:
                browsers.append((name, Memory(browser.process.pid)))
                looks.append(browsers[-1][1])
            go_on(share * seconds, process, lines, *looks)

        stage("absent", 0.05)
        browser = Browser(playwright)
        try:
            browser.load(address)
            stage("open", 0.15, browser)
            browser.page.evaluate("window.setHidden(true)")
            stage("hidden", 0.5, browser)
            browser.page.evaluate("window.setHidden(false)")
            browser.signal(signal.SIGSTOP)
            stage("frozen", 0.08, browser)
            browser.signal(signal.SIGCONT)
            stage("open again", 0.05, browser)
            browser.signal(signal.SIGKILL)
            stage("killed", 0.02)
            browser = Browser(playwright)
            print(f"loaded {LOADS} times", flush=True)
            for _ in range(LOADS):
                browser.load(address)
            stage("open after that", 0.15, browser)
        finally:
            browser.signal(signal.SIGKILL)
    return memory, browsers


def recorded(folder: Path, name: str) -> tuple[dict[str, Any], list[str], dict[str, str]]:
    """The command's JSON, what is wrong with its recording, and what is to be shown of both."""
    from deformscope.frames import WrenchFrame
    from deformscope.recording.facts import read_facts
    from deformscope.recording.items import read_items
    from deformscope.recording.ledger import read_counts

    found: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    path = folder / f"{name}.rrd"
    counts, facts = read_counts(path), read_facts(path)
    wrong = [f"losses: {facts.losses}"] if facts.losses else []
    frames = [item for item in read_items(path, kinds=(WrenchFrame,)) if isinstance(item, WrenchFrame)]
    ticks = np.array([frame.stamp.device_ticks for frame in frames], np.int64)
    gaps = np.flatnonzero(np.diff(ticks) % COUNTER != 1)
    if len(gaps):
        missing = int((np.diff(ticks)[gaps] % COUNTER - 1).sum())
        counted = int(facts.losses.get("tip", {}).get("readings", 0))
        said = "the recording counts as many or more" if missing <= counted else f"the recording COUNTS {counted}"
        wrong.append(f"the force sensor's own counter lacks {missing} samples in {len(gaps)} places; {said}")
    for device in DEVICES:
        if facts.counts.get(f"{device}/frames") != counts[f"{device}/frames"]:
            wrong.append(f"{device}: {facts.counts.get(f'{device}/frames')} frames of {counts[f'{device}/frames']}")
    shown = {f"{device} frames": str(counts[f"{device}/frames"]) for device in DEVICES}
    shown["samples of the force sensor, by its counter"] = f"{len(ticks)}, {len(gaps)} gaps"
    shown["losses"] = str(facts.losses or "none")
    if "supervisor_gaps_ms" in found:
        looks = found["supervisor_gaps_ms"]
        shown["looks of the supervisor"] = str(looks["count"])
        shown["its period, p50, p99, p99.9, most [ms]"] = ", ".join(
            f"{looks[share]:.2f}" for share in ("p50", "p99", "p99_9", "max")
        )
    return found, wrong, shown


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="with a page; loading it again comes on top")
    parser.add_argument("--command", choices=["explore", "record"], default="explore")
    parser.add_argument("--without", type=float, help="seconds without a page; default: a quarter of that")
    parser.add_argument("--folder", type=Path, help="keep the recordings there")
    arguments = parser.parse_args()
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(exist_ok=True)
        with running(arguments.command, folder, "none", "none") as (process, lines):
            memory_alone = Memory(process.pid)
            go_on(arguments.without or arguments.seconds / 4, process, lines, memory_alone)
        memory, browsers = with_a_page(arguments.command, folder, arguments.seconds)
        before, wrong, alone = recorded(folder, "none")
        now, more, beside = recorded(folder, "page")
    wrong += more
    wrong += late(before, now) if arguments.command == "explore" else []
    alone["memory of the command"], beside["memory of the command"] = memory_alone.words(), memory.words()
    beside |= {f"memory of the browser, {name}": one.words() for name, one in browsers}
    print(f"load of the machine, 1, 5, 15 min: {', '.join(f'{load:.1f}' for load in os.getloadavg())}")
    print(f"{'':<44} {'without a page':<42} with a page")
    for name in beside:
        print(f"{name:<44} {alone.get(name, ''):<42} {beside[name]}")
    for line in wrong:
        print(f"WRONG: {line}")
    return 1 if wrong else 0


def late(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """What is wrong with the supervisor's period."""
    late_ms = now["supervisor_gaps_ms"]["p99"]
    known = before["supervisor_gaps_ms"]["count"] >= LEAST_LOOKS
    within = late_ms <= max(MOST_MS, before["supervisor_gaps_ms"]["p99"] if known else 0.0)
    return [] if within else [f"the supervisor's period: {late_ms:.2f} ms"]


if __name__ == "__main__":
    sys.exit(main())
