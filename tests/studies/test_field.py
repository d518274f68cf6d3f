"""How fields of stiffness are scored."""

from __future__ import annotations

import dataclasses

from studies.field import FieldOutcome, field_rows


def test_a_row_counts_what_was_right_and_how_near() -> None:
    good = FieldOutcome("two, stretch", 0, "materials", True, 1.1, True, 1.0, 1.0, 0.1, 0.8)
    far = dataclasses.replace(good, ratio=0.7, border=3.0, covered=False, held=0.5)
    silent = dataclasses.replace(good, verdict="unidentified", right=False, ratio=9.0)
    ((kind, right, unidentified, near, ratio, border, held, beta),) = field_rows([good, far, silent])
    assert (kind, right, unidentified, near, border) == ("two, stretch", "2 of 3", "1", "50%", "50%")
    assert (ratio, held, beta) == ("0.70 to 1.10", "0.67, 0.83", "0.80")
