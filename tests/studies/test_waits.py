"""Costs of commands: builds in turn, growth by exponents of known laws. No time is asserted."""

from pathlib import Path

import pytest

from deformscope.cli import EXIT_INPUT
from studies.__main__ import main
from studies.waits import Cost, WaitsOptions, report, run, trials
from tests.cases import Capture

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_the_exponent_of_a_known_growth_comes_back_without_its_constant(power: float) -> None:
    options = WaitsOptions(only=("recordings",))
    (sizes,) = trials(options)
    costs = [[Cost("catalog many", 3.0 + 0.01 * case.size**power, 5.0, 200.0)] for case in sizes.cases]
    table = report(options, 0.0, costs).tables[0]
    (row,) = table.rows
    assert row[4] == ", ".join([f"{power:.2f}"] * 3)


def test_builds_take_turns_and_their_costs_are_divided_round_by_round(tmp_path: Path) -> None:
    (tmp_path / "deformscope").mkdir()
    (tmp_path / "deformscope" / "__main__.py").touch()
    options = WaitsOptions(only=("fit",), against=tmp_path, rounds=2)
    (runs,) = trials(options)
    assert [case.build for case in runs.cases] == [str(ROOT), str(tmp_path)] * 2
    costs = [[Cost("fit", seconds, 1.0, memory)] for seconds, memory in ((2, 90), (4, 80), (3, 70), (10, 60))]
    (row,) = report(options, 0.0, costs).tables[0].rows
    assert row[1:4] == ("2.5", "7", "0.400 (0.300 to 0.500)")
    assert row[5:] == ("90", "80")


def test_children_count_and_a_command_that_fails_is_named(tmp_path: Path, capsys: Capture) -> None:
    line = "flow nothing.png nowhere.png --out f.npz"
    with pytest.raises(Exception, match=r"status 2.*nothing\.png"):
        run(str(ROOT), line, tmp_path)
    assert main(["waits", "--only", "fit", "--against", str(tmp_path)]) == EXIT_INPUT
    assert "__main__.py" in capsys.readouterr().err
    assert run(str(ROOT), "--help", tmp_path).cpu_s > 0.0
