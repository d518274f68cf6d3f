"""Sentences about data come from the data: other results, other sentences; and no study holds such a sentence ready."""

import ast
import dataclasses
from pathlib import Path

import studies
from studies.reproduce.thesis_rules import HOLDS, FoamDent, Scenario, to_text
from tests.studies.reproduce.test_chapter4 import made_foam, made_scenario

ROOT = Path(studies.__file__).parent
SAYS = sorted({*ROOT.glob("*.py"), *ROOT.glob("reproduce/*.py")})
QUOTED = "FindingComparison"
"""Its first argument is the thesis's statement; the second is computed."""
METHOD = ("The thesis squeezed real cartons. These are simulated ones",)
"""How sentences begin that say what was done, whatever came of it."""


def ready_made(source: str) -> list[str]:
    """Whole sentences in code that no number enters: string constants that end as one does."""
    tree = ast.parse(source)
    left_out = {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}  # docstrings
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            left_out |= {id(part) for part in node.values}
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == QUOTED:
            left_out.add(id(node.args[0]))
    strings = [one for one in ast.walk(tree) if isinstance(one, ast.Constant) and id(one) not in left_out]
    sentences = [str(one.value) for one in strings if isinstance(one.value, str) and len(one.value.split()) >= 5]
    return [one for one in sentences if one.rstrip().endswith(".") and not one.startswith(METHOD)]


def test_no_study_has_a_sentence_about_data_ready() -> None:
    assert len(SAYS) > 40
    assert {path.name: found for path in SAYS if (found := ready_made(path.read_text()))} == {}


def test_a_sentence_that_is_ready_is_seen() -> None:
    assert ready_made('WHY = ("With layers below, rigid pieces are found.",)') == [
        "With layers below, rigid pieces are found."
    ]
    assert ready_made('f"With layers, {right} of {n} have as many regions as there are."') == []


def with_betas(foam: FoamDent, beta: float) -> FoamDent:
    return dataclasses.replace(foam, betas=tuple(dataclasses.replace(one, beta=beta) for one in foam.betas))


def with_field_betas(scenario: Scenario, betas: tuple[float, ...], regions: int) -> Scenario:
    fields = {name: dataclasses.replace(one, touches=betas, regions=regions) for name, one in scenario.fields.items()}
    return dataclasses.replace(scenario, fields=fields)


def test_chapter_4_in_words_follows_its_numbers() -> None:
    found = [made_scenario("two-150-rigid", 4)]
    foams = [made_foam(30), made_foam(60), made_foam(150)]
    falling = to_text([with_betas(foam, 3.0 / foam.hardness_n) for foam in foams], found)
    rising = to_text([with_betas(foam, 0.004 * foam.hardness_n) for foam in foams], found)
    same, one = to_text(foams, found), to_text(foams[:1], found)
    of_hold = [next(line for line in words if line.startswith(f"By {HOLDS[0]},")) for words in (falling, rising, same)]
    assert "falls with firmness at 5 of 5 cluster sizes" in of_hold[0]
    assert "rises with firmness at 5 of 5 cluster sizes" in of_hold[1]
    assert "is the same for all at 5 of 5 cluster sizes" in of_hold[2]
    assert "Figure 4.5 has 1 foam: a trend of beta with hardness needs two." in one
    assert not any("firmness" in line for line in one)


def test_chapter_4_says_where_betas_are_at_the_sweeps_end() -> None:
    found = made_scenario("two-150-rigid", 4)
    apart, ended = to_text([], [found]), to_text([], [with_field_betas(found, (0.0, 0.0, 0.0, 0.0), 1)])
    assert "As many touches as in the thesis in 1 of 1 explorations." in apart
    assert "With layers, 1 of 1 explorations find the true number of regions; beta is 0.00 to 0.70." in apart
    (layers,) = [line for line in ended if line.startswith("With layers")]
    assert "0 of 1 explorations" in layers
    assert "the end of the sweep for all touches" in layers
