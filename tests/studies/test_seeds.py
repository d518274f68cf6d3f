"""Seeds for tuning and for reports stay apart."""

import pytest

from deformscope.errors import InputError
from studies.seeds import REPORTED, TUNING, reported


def test_no_seed_is_in_both() -> None:
    assert not set(REPORTED) & set(TUNING)


def test_reported_seeds_never_reach_those_for_tuning() -> None:
    assert reported(1000) == REPORTED
    assert reported(3, TUNING.stop) == range(2000, 2003)
    with pytest.raises(InputError, match="1 from 1000"):
        reported(1, TUNING.start)
    with pytest.raises(InputError, match="999"):
        reported(2, 999)
