"""Click a point of the simulated surface, see the planned touch, confirm it: the arm touches there, nowhere else."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.recording.items import read_results
from deformscope.stages.map.exploration import PhaseStart, SteeringDecision, TouchEstimate, TouchForecast
from tests.page.pages import socket_to
from tests.page.test_in_browser import browser, shown, until
from tests.page.test_rig_on_page import started

__all__ = ["browser", "shown"]

KEEP_EVENTS = """
window.picked = [];
document.addEventListener("viewer", ({ detail }) => {
  if (detail.type === "recording_open") window.opened = true;
  const item = detail.items?.find((one) => one.entity_path && one.position);
  if (item) window.picked.push(item);
});
"""
PLACES_PX = ((430, 290), (480, 300), (520, 340), (330, 300)) * 3
"""Of the surface in the window. Where no picture was drawn while the pointer stood there, a click picks nothing."""


def asked(page: Any) -> str:
    """What waits for a confirm."""
    until(page, lambda: page.is_visible("#confirm"))
    return str(page.inner_text("#confirm-what"))


def type_place(page: Any, x_cm: float, y_cm: float) -> None:
    page.fill("#place-x", f"{x_cm}")
    page.fill("#place-y", f"{y_cm}")
    page.click("[data-kind=touch-at]")


@pytest.mark.slow
def test_a_click_on_the_surface_becomes_one_touch(shown: Any, tmp_path: Path) -> None:
    file = tmp_path / "touched.rrd"
    # a machine without a graphics card draws for seconds: what stops a touch then is tested elsewhere
    words = ("explore", "lab:two-60-150", "--paused", "--page-timeout", "60", "--beta-model", "none")
    shown.add_init_script(KEEP_EVENTS)
    with started(*words, "--record", str(file), folder=tmp_path) as command:
        shown.goto(command.page.address)
        until(shown, lambda: shown.inner_text("#phase") == "paused")

        # out of reach, at the edge; cancelled, and from another page: nothing moves, and the page says why
        type_place(shown, 90.0, 20.0)
        until(shown, lambda: "outside the surface" in shown.inner_text("#place-words"))
        type_place(shown, 30.0, 1.0)
        until(shown, lambda: "2 cm of the surface's edge" in shown.inner_text("#place-words"))
        type_place(shown, 30.0, 20.0)
        assert "(30.0, 20.0) cm" in asked(shown)
        shown.keyboard.press("Escape")
        until(shown, lambda: "cancelled: nothing moved" in shown.inner_text("#place-words"))
        with pytest.raises(Exception, match="403"), socket_to(command.page, "session", origin="http://evil.example"):
            pass

        # a click in rerun's viewer
        until(shown, lambda: shown.evaluate("window.opened"))
        for x, y in PLACES_PX:
            shown.mouse.move(x - 5, y)
            shown.wait_for_timeout(1000)
            shown.mouse.move(x, y)
            shown.wait_for_timeout(2500)  # it has to be under the pointer in a picture that was drawn
            before = shown.evaluate("window.picked.length")
            shown.mouse.click(x, y)
            shown.wait_for_timeout(3000)
            if shown.evaluate("window.picked.length") > before:  # what was picked may be the arm: that is refused
                until(shown, lambda: shown.is_visible("#confirm") or shown.is_visible("#place-words.bad"))
            if shown.is_visible("#confirm"):
                break
        at_m = np.array(shown.evaluate("window.picked.at(-1)")["position"])[:2]
        what = asked(shown)
        assert f"({100 * at_m[0]:.1f}, {100 * at_m[1]:.1f}) cm" in what
        assert "presses with 3 N" in what
        assert shown.is_visible("#curve svg")
        shown.keyboard.press("Enter")
        until(shown, lambda: "felt " in shown.inner_text("#curve figcaption"))
        until(shown, lambda: shown.is_enabled("[data-kind=touch-at]"))
        shown.keyboard.press(" ")
        until(shown, lambda: shown.inner_text("#phase") == "stopped")
        command.ended()

    def recorded(kind: type) -> list[Any]:
        return [row.item for row in read_results(file, (kind,), trust=True)]

    (touch,) = recorded(TouchEstimate)
    assert np.linalg.norm(touch.xyz_m[:2] - at_m) < 0.005
    assert [one.kind for one in recorded(SteeringDecision)] == ["touch"]
    assert len(recorded(TouchForecast)) == 2
    assert [one.name for one in recorded(PhaseStart)].count("travel") == 1
