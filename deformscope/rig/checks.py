"""What values of a rig file must be, beyond their types."""

from __future__ import annotations

import math

from deformscope.errors import InputError


def check(right: bool, expected: str, came: object) -> None:
    if not right:
        raise InputError(expected, str(came))


def check_transform(name: str, rows: tuple[tuple[float, ...], ...]) -> None:
    """A rigid 4x4: rows of a rotation, a translation within 10 m, and 0 0 0 1."""
    check(len(rows) == 4 and all(len(row) == 4 for row in rows), f"{name} of 4 rows of 4 numbers", rows)
    check(all(math.isfinite(value) for row in rows for value in row), f"{name} of finite numbers", rows)
    check(tuple(rows[3]) == (0, 0, 0, 1), f"{name} whose last row is 0 0 0 1", rows[3])
    turn = [row[:3] for row in rows[:3]]
    for first in range(3):
        for second in range(3):
            product = sum(a * b for a, b in zip(turn[first], turn[second], strict=True))
            check(abs(product - (first == second)) < 1e-3, f"{name} whose rotation is one", f"rows {turn}")
    (a, b, c), (d, e, f), (g, h, i) = turn
    turns_right = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    check(turns_right, f"{name} that is no mirror image", f"rows {turn}")
    check(max(abs(row[3]) for row in rows[:3]) < 10, f"{name} in metres", [row[3] for row in rows[:3]])
