"""Cases of parametrised tests: which of them a default run takes, and which are left to `make test-slow`; short names
of fixtures' types."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

Capture = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def slow(*values: Any) -> Any:
    """One case that is slow."""
    return pytest.param(*values, marks=pytest.mark.slow)


def slow_but(quick: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """All cases, slow but for the quick ones; a tuple is a case of several arguments."""
    cases = list(cases)
    assert all(case in cases for case in quick)
    return [case if case in quick else slow(*(case if isinstance(case, tuple) else (case,))) for case in cases]
