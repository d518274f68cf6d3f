"""Somebody who has never seen it: the words of `deformscope` alone, then clicks, until there is a map."""

import os
import shlex
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from tests.page.test_in_browser import browser, shown, until
from tests.page.test_rig_on_page import started
from tests.patience import PATIENCE_S

__all__ = ["browser", "shown"]

TIMES = 5
"""A question that was left to expire, on a machine that draws a picture in seconds, is asked for again."""

VIEW = {"x": 240, "y": 70, "width": 440, "height": 370}
"""Of the window: where the surface and the arm are drawn."""
SEEN = 0.05


def colored(page: Any) -> float:
    """Share of the view of surface and arm that has colours, as a surface has that is mapped."""
    view = cv2.imdecode(np.frombuffer(page.screenshot(clip=VIEW), np.uint8), cv2.IMREAD_COLOR)
    return float((view.max(axis=2).astype(int) - view.min(axis=2) > 60).mean())


def click(page: Any, selector: str, words: str) -> bool:
    """As a person does: the pointer goes to where the button is seen, and presses. Whether it was still there."""
    button = page.locator(selector)
    box = button.bounding_box()
    if box is not None:
        assert button.inner_text().startswith(words)
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    return box is not None


def explores(page: Any) -> bool:
    """Press Explore, and Confirm in the dialog that opens; whether that came in time."""
    assert click(page, "[data-kind=explore]", "Explore")
    until(page, lambda: page.is_visible("#confirm"))
    click(page, "#confirm-yes", "Confirm")
    until(page, lambda: page.inner_text("#phase") == "exploring" or "not confirmed" in page.inner_text("#place-words"))
    return bool(page.inner_text("#phase") == "exploring")


@pytest.mark.slow
def test_clicks_alone_lead_from_no_arguments_to_a_map(
    shown: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert "press Explore" in printed
    (line,) = (one for one in printed.splitlines() if one.startswith("  deformscope explore"))
    words = shlex.split(line)[1:]
    assert words[-2:] == ["--viewer", "page"]
    shown.set_default_timeout(1e3 * PATIENCE_S)
    began_s = time.monotonic()
    with started(*words[:-2], folder=tmp_path) as command:
        shown.goto(command.page.address)
        until(shown, lambda: "press Explore" in shown.inner_text("#reason"))
        assert colored(shown) < SEEN
        assert any(explores(shown) for _ in range(TIMES))
        until(shown, lambda: "measured at (" in shown.inner_text("#remarks"))
        until(shown, lambda: "map so far: 2 regions" in shown.inner_text("#remarks"))
        until(shown, lambda: colored(shown) > SEEN)
        took_s = time.monotonic() - began_s
        assert click(shown, "#stop", "Stop")
        until(shown, lambda: shown.inner_text("#phase") == "stopped")
        found = command.ended()
    assert found["region_count"] == 2
    with capsys.disabled():
        print(f"\na map of two regions after {took_s:.0f} s, load {os.getloadavg()[0]:.1f}")
