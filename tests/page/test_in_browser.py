"""The page in a real browser: rerun's viewer draws what is sent, keys and buttons are commands, nothing is loaded from
elsewhere."""

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rerun as rr

from deformscope.page.server import messages
from deformscope.page.server.page_server import PageServer
from deformscope.recording.live import page_stream
from tests.page.pages import page_script
from tests.patience import PATIENCE_S

CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
DEVICES = (
    messages.DeviceState("tip", "ok", simulated=True, rate_hz=1000.0, age_s=0.001, lost=3),
    messages.DeviceState("<b>pads</b>", "LOST", reason="unplugged"),
)


class Obeyed:
    """What pages asked for."""

    def __init__(self) -> None:
        self.commands: list[messages.PageCommand] = []

    def handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        self.commands.append(command)
        return "done", ""


def until(page: Any, happened: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < deadline, "it never happened"
        page.wait_for_timeout(20)


@contextmanager
def chromium(*flags: str) -> Iterator[Any]:
    """Where there is one."""
    sync_api = pytest.importorskip("playwright.sync_api")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}; apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(flags))
        yield started
        started.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(*FLAGS) as started:
        yield started


@pytest.fixture
def page() -> Iterator[PageServer]:
    with PageServer("bench") as server:
        server.session.enter(
            "live", commands=("stop", "write-note", "begin-episode", "tare"), tares=("tip",), devices=DEVICES
        )
        yield server


FAKE_VIEWER = """
window.pieces = [];
window.wasm_bindgen = async () => {};
window.wasm_bindgen.WebHandle = class {
  constructor(options) { this.tell = (event) => options.on_viewer_event(JSON.stringify(event)); }
  async start(canvas) {
    this.field = document.body.appendChild(document.createElement("input"));  // as rerun's viewer has one for text
    this.field.id = "viewer-field";
    this.field.focus();
  }
  override_panel_state() {}
  open_channel() {}
  send_rrd_to_channel(channel, bytes) {
    window.pieces.push(bytes.length);
    this.tell({ type: "time_update", time: window.pieces.length * 1e9 });
  }
  has_panicked() { return false; }
};
"""
"""In place of rerun's, whose start takes a machine without a graphics card seconds."""


def fake_viewer(shown: Any) -> None:
    shown.route("**/re_viewer.js", lambda route: route.fulfill(body=FAKE_VIEWER, content_type="text/javascript"))
    shown.route("**/re_viewer_bg.wasm", lambda route: route.fulfill(body=""))


@pytest.fixture
def shown(browser: Any) -> Iterator[Any]:
    one = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
    yield one
    one.close()


def test_keys_and_buttons_are_commands(page: PageServer, shown: Any) -> None:
    run = Obeyed()
    page.session.bind(run)
    fake_viewer(shown)
    wrong = list[str]()
    shown.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    shown.on("pageerror", lambda error: wrong.append(str(error)))
    shown.goto(page.address)
    until(shown, lambda: shown.inner_text("#phase") == "live")
    words = shown.inner_text("#devices").split()
    assert words[:4] == ["tip", "simulated", "ok", "rate"]
    assert words[4:6] == ["1000", "/s"]
    assert "<b>pads</b>" in shown.inner_text("#devices")  # a device's name is no HTML
    assert shown.is_hidden("[data-kind=start-recording]")  # it cannot be asked for
    assert shown.evaluate("document.elementFromPoint(640, 400).id") == "canvas"  # nothing lies over the viewer

    # keys: in a field they are text, elsewhere commands, also while a dialog is open or the viewer has the focus
    until(shown, lambda: shown.evaluate("document.activeElement.id") == "viewer-field")
    shown.keyboard.press(" ")
    shown.keyboard.press("n")
    shown.evaluate("document.getElementById('viewer-field').focus()")  # nobody clicked: the field keeps it
    shown.keyboard.type("soft here")
    shown.keyboard.press("Enter")
    shown.keyboard.press("t")
    shown.keyboard.press("e")
    shown.keyboard.type("left")
    shown.keyboard.press("Control+Space")
    shown.keyboard.press("Enter")
    shown.keyboard.press("?")
    assert shown.is_visible("#help")
    shown.keyboard.press(" ")
    shown.keyboard.press("Escape")
    until(shown, lambda: len(run.commands) == 6)
    match run.commands:
        case [
            messages.StopRun(),
            messages.WriteNote(text="soft here"),
            messages.TareDevice(device="tip"),
            messages.StopRun(),
            messages.BeginEpisode(label="left"),
            messages.StopRun(),
        ]:
            pass
        case other:
            pytest.fail(str(other))
    until(shown, lambda: "write-note: done" in shown.inner_text("#remarks"))
    until(shown, lambda: shown.input_value("#note-text") == "")

    # another page takes the controls over
    with page_script(page, "other") as other_page:
        assert other_page.command("take-controls")[0] == "done"
        until(shown, lambda: "another page has the controls" in shown.inner_text("#holder"))
        assert shown.is_disabled("[data-kind=write-note]")
        assert shown.is_enabled("#stop")
    assert wrong == []


PLACES = """(() => [
  ...document.querySelectorAll(".device .head, .device table, .device .drift, h2, #stop, #recording, #viewer, #tares")
].filter((one) => one.checkVisibility())
  .map((one) => [one.id || one.className, one.getBoundingClientRect()])
  .map(([name, box]) => [name, box.x, box.y, box.width]))()"""
"""Of what stands on the page, whatever its words."""


@pytest.mark.parametrize("size", [(1280, 800), (1180, 820)])
def test_nothing_moves_while_values_and_reasons_change(page: PageServer, shown: Any, size: tuple[int, int]) -> None:
    fake_viewer(shown)
    shown.set_viewport_size({"width": size[0], "height": size[1]})
    quiet = (
        messages.DeviceState("tip", "ok", drift=messages.DriftState(0.0, "", (), ())),
        messages.DeviceState("pads", "ok"),
    )
    page.session.enter("live", commands=("stop", "start-recording", "tare"), devices=quiet)
    shown.goto(page.address)
    until(shown, lambda: shown.inner_text("#devices").startswith("tip"))
    before = shown.evaluate(PLACES)
    assert len(before) > 8
    reason = "saturated: fz at the end of its range; stuck at the same count: fx; the cable may be loose " * 3
    drift = messages.DriftState(4000.0, "counts", (12345.6, -12345.6, 12345.6), (0.0, 21000.0))
    loud = (
        messages.DeviceState(
            "tip", "saturated", simulated=True, rate_hz=12345.0, age_s=99.9, lost=10**7, reason=reason, drift=drift
        ),
        messages.DeviceState("pads", "LOST", refused=10**6, reason=reason),
    )
    page.session.enter("live", reason, commands=("stop", "tare"), devices=loud)  # a file is being closed meanwhile
    with page_script(page, "other") as other:
        other.command("take-controls")
        until(shown, lambda: "another page" in shown.inner_text("#holder"))
        until(shown, lambda: "saturated" in shown.inner_text("#devices"))
        assert shown.evaluate(PLACES) == before
    assert shown.get_attribute(".device .why", "title") == reason
    whole = "(({ scrollHeight, clientHeight }) => scrollHeight <= clientHeight)(document.querySelector('.why span'))"
    assert not shown.evaluate(whole)
    shown.hover(".device .why")
    assert shown.evaluate(whole)  # over the device below
    assert shown.evaluate(PLACES) == before
    assert not shown.evaluate("document.documentElement.scrollWidth > innerWidth")


def test_keys_that_have_no_place_here(page: PageServer, shown: Any) -> None:
    """Without a recording `n` names what is lacking, and the list of keys has those of this page alone."""
    fake_viewer(shown)
    page.session.enter("live", commands=("stop", "start-recording", "tare"), devices=DEVICES)
    shown.goto(page.address)
    until(shown, lambda: shown.inner_text("#devices").startswith("tip"))
    shown.keyboard.press("n")
    until(shown, lambda: "nothing is being recorded; r starts a recording" in shown.text_content("#remarks"))
    shown.keyboard.press("?")
    listed = "[...document.querySelectorAll('#help dt')].filter(one => one.offsetHeight).map(one => one.innerText)"
    assert shown.evaluate(listed) == ["space", "r", "t", "Esc", "?"]


def test_a_page_that_is_loaded_again_keeps_the_controls_and_a_copy_of_its_tab_has_none(
    page: PageServer, shown: Any
) -> None:
    page.session.bind(Obeyed())
    fake_viewer(shown)
    shown.context.route("**/re_viewer*", lambda route: route.fulfill(body=""))
    shown.goto(page.address)
    for _ in range(2):
        until(shown, lambda: "this page has the controls" in shown.inner_text("#holder"))
        shown.reload()
    until(shown, lambda: "this page has the controls" in shown.inner_text("#holder"))
    with shown.context.expect_page() as opened:
        shown.evaluate("window.open(location.href)")  # with a copy of what the tab keeps
    copy = opened.value
    until(shown, lambda: copy.is_visible("#take"))  # once it has a state, and so a name: the copied one or its own
    assert shown.is_hidden("#take")
    assert shown.evaluate("sessionStorage.getItem('page')") != copy.evaluate("sessionStorage.getItem('page')")
    copy.close()


def test_a_batch_is_acknowledged_once_it_is_drawn(page: PageServer, shown: Any) -> None:
    fake_viewer(shown)
    page.pieces.add(b"views", lasting=True)
    shown.goto(page.address)
    for number in range(1, 4):  # the third says how long the first was shown
        until(shown, lambda number=number: shown.evaluate("window.pieces.length") == number)
        page.pieces.add(b"numbers", lasting=False, until_ns=number * 10**9)
    until(shown, lambda: shown.evaluate("window.pieces.length") == 4)
    until(shown, lambda: "viewer" in shown.inner_text("#lag"))
    assert shown.evaluate("window.pieces") == [5, 7, 7, 7]


@pytest.mark.slow
def test_the_viewer_draws(page: PageServer, shown: Any) -> None:
    run = Obeyed()
    page.session.bind(run)
    stream = page_stream("deformscope-test", "test", page.pieces, {"rig": "test"}, threading.Event())
    stream.rec.log("views", rr.TextDocument("static"), static=True)
    stream.flush(timeout_sec=PATIENCE_S)
    wrong, asked = list[str](), set[str]()
    shown.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    shown.on("pageerror", lambda error: wrong.append(str(error)))
    shown.on("requestfinished", lambda request: asked.add(request.url))
    shown.add_init_script(
        "window.seen = []; document.addEventListener('viewer', (event) => window.seen.push(event.detail.type))"
    )
    shown.goto(page.address)
    until(shown, lambda: "recording_open" in shown.evaluate("window.seen"))

    # it acknowledges what it draws
    steps = itertools.count()

    def goes_on() -> bool:
        stream.rec.set_time("session", duration=float(next(steps)))
        stream.rec.log("plot", rr.Scalars(1.0))
        stream.flush(timeout_sec=PATIENCE_S)
        return bool("viewer" in shown.inner_text("#lag"))

    until(shown, goes_on)
    shown.mouse.click(640, 400)  # the viewer has the keys now
    shown.keyboard.press(" ")
    until(shown, lambda: run.commands)
    assert isinstance(run.commands[0], messages.StopRun)
    stream.disconnect()
    # rerun's viewer asks the internet for new versions, and reports on its use: the page's policy lets neither through
    blocked = ("Content Security Policy", "violates", "Failed to fetch")
    assert [words for words in wrong if not any(one in words for one in blocked)] == []
    assert {url.split("/")[2] for url in asked if "://" in url} == {page.address.split("/")[2]}
