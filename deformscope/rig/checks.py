"""Conditions on values of a rig file, beyond their types."""

from __future__ import annotations

import math

import numpy as np

from deformscope.errors import InputError


def check(right: object, expected: str, came: object) -> None:
    if not right:
        raise InputError(expected, str(came))


def check_transform(name: str, rows: tuple[tuple[float, ...], ...]) -> None:
    """A rigid 4x4: rows of a rotation, a translation within 10 m, and 0 0 0 1."""
    check(len(rows) == 4 and all(len(row) == 4 for row in rows), f"{name} of 4 rows of 4 numbers", rows)
    check(all(math.isfinite(value) for row in rows for value in row), f"{name} of finite numbers", rows)
    check(tuple(rows[3]) == (0, 0, 0, 1), f"{name} whose last row is 0 0 0 1", rows[3])
    turn = np.array(rows, np.float64)[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers beyond all use
        turned, mirrored = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3, np.linalg.det(turn) <= 0
    check(turned, f"{name} whose rotation is one", f"rows {turn.tolist()}")
    check(not mirrored, f"{name} that is no mirror image", f"rows {turn.tolist()}")
    check(max(abs(row[3]) for row in rows[:3]) < 10, f"{name} in metres", [row[3] for row in rows[:3]])


def check_orthogonal(name: str, rows: tuple[tuple[float, ...], ...]) -> None:
    """A 3x3 matrix of axes at right angles, mirrored or not."""
    check(len(rows) == 3 and all(len(row) == 3 for row in rows), f"{name} of 3 rows of 3 numbers", rows)
    check(all(math.isfinite(value) for row in rows for value in row), f"{name} of finite numbers", rows)
    axes = np.array(rows, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        check(np.abs(axes @ axes.T - np.eye(3)).max() < 1e-3, f"{name} of axes at right angles", axes.tolist())
