"""One runner for all studies: outcomes in their order, kept as they come, and taken from where they were kept."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from deformscope.arrays import FloatArray
from deformscope.cli import with_flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from studies.quantities import Quantity, Rate, by, number, rows, share, table
from studies.runner import Study, StudyOptions, StudyReport, Trials, run, tried

CALLED: list[int] = []


@dataclass(frozen=True, slots=True)
class Square:
    """Of an even number."""

    number: int
    square: float
    ends: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Odd:
    """A number that is none."""

    number: int


def square(number: int) -> Square | Odd:
    """Of even numbers; not finite for 0, as numpy has it for 2."""
    CALLED.append(number)
    if number == 13:
        raise KeyboardInterrupt
    if number % 2:
        return Odd(number)
    return Square(number, math.nan if number == 0 else np.float64(number) ** 2, (-math.inf, 0.1 * number))


def report(options: StudyOptions, seconds: float, found: Sequence[Square | Odd]) -> StudyReport:
    return StudyReport([Table([(one.number,) for one in found], ("number",), "Squares")], {"found": found})


def study(numbers: Sequence[int]) -> Study:
    return Study(StudyOptions, lambda options: [Trials("numbers", square, numbers)], report)


def called(numbers: Sequence[int], *flags: str) -> list[int]:
    """Which numbers are computed by a command with these flags."""
    CALLED.clear()
    one = study(numbers)
    with_flags(one.options, lambda options: run(one, options), ["--jobs", "1", *flags], "python -m studies squares")
    return list(CALLED)


@dataclass(frozen=True, slots=True)
class Grid:
    """Arrays within a result. seen: (2, n); image: (2, 2)"""

    seen: FloatArray
    image: npt.NDArray[np.uint8]


def grid(number: int) -> Grid:
    CALLED.append(number)
    return Grid(np.array([[math.nan, 0.1 * number], [-math.inf, 1.0]]), np.full((2, 2), number, np.uint8))


def test_arrays_are_kept_to_the_last_bit(tmp_path: Path) -> None:
    options, found = StudyOptions(1, tmp_path / "kept.jsonl"), list[list[Grid]]()

    def report(options: StudyOptions, seconds: float, grids: list[Grid]) -> StudyReport:
        found.append(grids)
        return StudyReport([Table([], (), "Grids")], {})

    CALLED.clear()
    for _ in range(2):
        run(Study(StudyOptions, lambda options: [Trials("grids", grid, [3, 7])], report), options)
    assert CALLED == [3, 7]
    for made, read in zip(*found, strict=True):
        assert (read.seen.dtype, read.image.dtype) == (np.float64, np.uint8)
        assert (read.seen.tobytes(), read.image.tobytes()) == (made.seen.tobytes(), made.image.tobytes())
        assert (read.seen.shape, read.image.shape) == ((2, 2), (2, 2))


def test_outcomes_that_are_kept_are_not_computed_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept, found = tmp_path / "kept.jsonl", tmp_path / "found.json"
    flags = ["--resume", str(kept), "--json", str(found)]
    assert called([0, 1, 2], *flags) == [0, 1, 2]
    first = (json.loads(found.read_text()), capsys.readouterr().out)
    assert called([0, 1, 2], *flags) == []
    assert (json.loads(found.read_text()), capsys.readouterr().out) == first
    assert called([2, 3, 0], *flags) == [3]
    assert [one["number"] for one in json.loads(found.read_text())["found"]] == [2, 3, 0]
    with pytest.raises(KeyboardInterrupt):
        called([4, 13], *flags)
    with kept.open("a") as file:
        file.write('["numbers", 5, "Od')  # cut off
    assert called([4, 5], *flags) == [5]
    kept.write_text("no JSON\n")
    with pytest.raises(InputError, match=r"kept\.jsonl:1"):
        called([4], *flags)


def test_outcomes_are_in_the_order_of_their_cases() -> None:
    kept: list[int] = []
    trials = Trials("numbers", square, [0, 2, 4])
    found = tried(trials, StudyOptions(1), {1: Odd(-1)}, lambda case, outcome: kept.append(case))
    assert [one.number for one in found] == [0, -1, 4]
    assert kept == [0, 4]


def test_a_quantity_is_declared_once_for_the_table_and_the_json() -> None:
    quantities: tuple[Quantity[Sequence[int]], ...] = (
        Quantity("last", lambda some: some[0] % 10, {"ends in": int}),
        Quantity("mean", lambda some: float(np.mean(some)), {"mean": number(1)}),
        Quantity("large", lambda some: Rate.of(one > 10 for one in some), {"large": share(2), "of": lambda r: r.cases}),
        Quantity("many", len),
    )
    lines = rows(by([12, 3, 2], lambda one: one % 10).values(), quantities)
    assert [(row["last"], row["mean"], row["large"].hits, row["many"]) for row in lines] == [(2, 7, 1, 2), (3, 3, 0, 1)]
    shown = table(lines, quantities, "Numbers", {"mean": "mean", "ends in": "last digit"})
    assert (shown.names, list(shown.rows)) == (("mean", "last digit"), [("7.0", 2), ("3.0", 3)])
    assert table(lines, quantities, "All").names == ("ends in", "mean", "large", "of")
