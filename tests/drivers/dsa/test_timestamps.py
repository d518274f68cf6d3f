"""Which frames are new, by the controller's clock."""

import pytest

from deformscope_drivers.dsa.measurer import STEP_MAX_MS, TimestampGate, TimestampStatus

NEW, REPEATED, JUMPED, RESTARTED = map(TimestampStatus, ("new", "repeated", "jumped", "restarted"))


@pytest.mark.parametrize(
    ("times", "verdicts"),
    [
        ([7], [NEW]),
        ([0, 33, 66], [NEW, NEW, NEW]),
        ([100, 100, 133], [NEW, REPEATED, NEW]),
        ([2**32 - 10, 23], [NEW, NEW]),  # around the end of 32 bits
        ([100, 100 + STEP_MAX_MS], [NEW, NEW]),
        ([5000, 5033 ^ 1 << 20, 5066], [NEW, JUMPED, NEW]),  # one frame with flipped bits
        ([5000, 4999, 5066], [NEW, JUMPED, NEW]),
        ([50_000, 8000, 8033, 8066], [NEW, JUMPED, RESTARTED, NEW]),  # switched off and on
        ([50_000, 8000, 50_033, 8033], [NEW, JUMPED, NEW, JUMPED]),
        ([50_000, 8000, 3000, 3033], [NEW, JUMPED, JUMPED, RESTARTED]),
        ([50_000, 8000, 8000, 8033], [NEW, JUMPED, JUMPED, RESTARTED]),
        ([0, 60_000, 60_033], [NEW, JUMPED, RESTARTED]),  # a pause of a minute costs one frame
    ],
)
def test_frames_in_turn(times: list[int], verdicts: list[TimestampStatus]) -> None:
    gate = TimestampGate()
    assert [gate.check(time) for time in times] == verdicts


def test_restart_forgets() -> None:
    gate = TimestampGate()
    gate.check(50_000)
    gate.restart()
    assert gate.check(8000) is NEW
