"""Whatever becomes of its page, a run's file lacks nothing: `tools/page_robustness.py`, short."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.page.test_in_browser import CHROMIUM

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("command", ["record", "explore"])
def test_a_page_costs_neither_readings_nor_time(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """PAGE_SECONDS=600 for the full length."""
    pytest.importorskip("playwright.sync_api")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}; apt-get install chromium")
    seconds = os.environ.get("PAGE_SECONDS", "120")
    script = [sys.executable, str(ROOT / "tools" / "page_robustness.py"), "--command", command, "--seconds", seconds]
    done = subprocess.run(script, cwd=ROOT, capture_output=True, text=True, check=False)
    with capsys.disabled():
        print(f"\n{done.stdout}")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
