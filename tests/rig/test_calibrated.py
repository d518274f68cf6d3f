"""Dates and intervals in the rig file, how old they are, and that writing them changes nothing else."""

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deformscope.errors import InputError
from deformscope.rig.rig_edit import edited, lines_of
from deformscope.rig.rig_file import parse_rig
from deformscope.rig.sections import CalibratedSection, CalibrationEntry

RIG = """# my rig
[devices.tip]   # the stick's sensor
driver = "optoforce"
double = true

[tool]
length_m = 0.12   # measured with a ruler
T_ee_tip = [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 0.12], [0, 0, 0, 1],
]
# below it: the ball
radius_m = 0.01

# the end
"""
TIP = ((1.0, 0.0, 0.0, 0.001), (0.0, 1.0, 0.0, -0.002), (0.0, 0.0, 1.0, 0.11), (0.0, 0.0, 0.0, 1.0))
DAY = datetime.date(2026, 3, 1)


def test_values_are_written_and_all_else_stays() -> None:
    made = edited(
        RIG,
        {
            "tool": {"T_ee_tip": TIP, "compliance_sd": 2e-05},
            "calibrated.tip": {"date": DAY, "half_m": [0.0004, 0.0004, 0.0005]},
        },
    )
    rig = parse_rig(made, "rig.toml")
    assert rig.tool.T_ee_tip == TIP
    assert rig.tool.length_m == 0.12
    assert rig.tool.compliance_sd == 2e-05
    assert rig.calibrated.tip == CalibrationEntry(DAY, (0.0004, 0.0004, 0.0005))
    for kept in ("# my rig", "# the stick's sensor", "# measured with a ruler", "# below it: the ball", "# the end"):
        assert kept in made
    assert edited(made, {"calibrated.tip": {"date": DAY}}) == made


def test_an_empty_file_gets_its_sections() -> None:
    values = {"workspace": {"low_m": [0.0, 1.0, -2.0]}, "surface": {"scene": 'a "b" \\ c'}}
    assert edited("", values).strip() == lines_of(values).replace("[surface]", "\n[surface]")


@pytest.mark.parametrize("text", ["tool = { length_m = 0.1 }\n", "tool.length_m = 0.1\n", '["tool"]\nlength_m = 0.1\n'])
def test_what_cannot_be_changed_safely_is_left_and_the_lines_are_given(text: str) -> None:
    with pytest.raises(InputError, match=r"length_m = 0\.2"):
        edited(text, {"tool": {"length_m": 0.2}})


@given(st.floats(-10, 10), st.integers(-5, 5), st.text(st.characters(min_codepoint=32, max_codepoint=126)))
def test_any_value_comes_back(number: float, count: int, text: str) -> None:
    import tomllib

    read = tomllib.loads(edited(RIG, {"camera": {"x": [number, 1.0], "n": count, "t": text}}))["camera"]
    assert read == {"x": [pytest.approx(number, rel=1e-8, abs=1e-300), 1.0], "n": count, "t": text}


def test_ages() -> None:
    section = CalibratedSection(place=CalibrationEntry(DAY), tip=CalibrationEntry(DAY, oldest_days=5))
    ages = section.ages(DAY + datetime.timedelta(days=10))
    assert {name: (age.days, age.young) for name, age in ages.items()} == {"place": (10, True), "tip": (10, False)}
    assert section.ages(DAY - datetime.timedelta(days=1))["tip"].days == 0


@pytest.mark.parametrize(
    "lines", ["[calibrated.tip]\ndate = 12", "[calibrated.tip]\nhalf_m = [1.0]", "[calibrated.ear]\ndate = 2026-01-01"]
)
def test_a_section_that_is_wrong_is_an_error(lines: str) -> None:
    with pytest.raises(InputError, match="calibrated"):
        parse_rig(RIG + lines, "rig.toml")
