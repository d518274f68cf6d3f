"""Cases of parametrised tests: which of them a default run takes, and which are left to `make test-slow`; short names
of fixtures' types; rig files; what a command refuses."""

from collections.abc import Collection, Iterable, Sequence
from itertools import product
from typing import Any

import pytest

Capture = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch

# Parts of a rig file with doubles over a simulated table
OPTOFORCE = """
[devices.tip]
driver = "optoforce"
double = true
rate_hz = 1000
filter_hz = 150
"""
DEPTH = """
[devices.depth]
driver = "depth_camera"
double = true
fps = 5
"""
COMPLIANCE = """
[tool]
compliance_m_per_n = 2e-4
compliance_sd = 2e-5
"""
SURFACE = """
[surface]
scene = "two-60-150"
"""
AHEAD = f"""
[workspace]
low_m = [0.1, -0.45, 0.0]
high_m = [0.95, 0.45, 0.75]
travel_speed_m_s = 0.1
{SURFACE}T_arm_surface = [[0, -1, 0, 0.75], [1, 0, 0, -0.3], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def slow(*values: Any) -> Any:
    """One case that is slow."""
    return pytest.param(*values, marks=pytest.mark.slow)


def slow_but(quick: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """All cases, slow but for the quick ones; a tuple is a case of several arguments."""
    cases = list(cases)
    assert all(case in cases for case in quick)
    return [case if case in quick else slow(*(case if isinstance(case, tuple) else (case,))) for case in cases]


def each_once(*columns: Sequence[Any]) -> list[Any]:
    """All combinations of the columns' values, slow but for as few as have each value."""
    quick = [tuple(column[at % len(column)] for column in columns) for at in range(max(map(len, columns)))]
    return slow_but(quick, product(*columns))


def one_line(capsys: Capture) -> str:
    """What an error said: exactly one line on stderr, nothing on stdout."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert err.startswith("deformscope: ")
    return err.strip()
