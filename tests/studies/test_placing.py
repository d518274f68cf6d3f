"""What `python -m studies placing` counts."""

import pytest

from studies.placing import PlacedRun, PlacingCase, PlacingStudyConfig, report, trials, try_placing


def run(disturbed: str, stop: str, changes: tuple[str, ...], closed: bool) -> PlacedRun:
    case = PlacingCase("kuka", 0, disturbed)
    return PlacedRun(case, "box-01", stop, "", 1, (), changes, "moved" if disturbed else "", 20.0, closed)


@pytest.mark.parametrize(
    ("disturbed", "stop", "changes", "closed", "noticed"),
    [
        ("travel", "container moved", ("moved",), False, "image"),
        ("approach", "force above the soft stop", (), False, "force"),
        ("approach", "no contact", ("hidden",), True, ""),  # its fingers have closed beside it
        ("travel", "arm frozen", (), False, ""),  # for another reason
        ("retreat", "", ("stands", "toppled"), True, "image"),
        ("retreat", "", ("stands", "hidden"), True, ""),
        ("retreat", "", ("stands", "stands"), True, ""),
    ],
)
def test_what_counts_as_noticed(
    disturbed: str, stop: str, changes: tuple[str, ...], closed: bool, noticed: str
) -> None:
    assert run(disturbed, stop, changes, closed).noticed == noticed


def test_what_is_not_noticed_is_counted_with_its_interval() -> None:
    well, missed = run("travel", "container moved", ("moved",), False), run("retreat", "", ("stands", "hidden"), True)
    placed = [run("", "", ("stands", "stands"), True), run("", "no grasp is reached", (), False)]
    found = report(PlacingStudyConfig(arm="kuka"), 1.0, placed, [well, well, missed])
    assert found.json["placed"] == 1  # type: ignore[index]
    assert found.json["noticed"] == 2  # type: ignore[index]
    assert "noticed 2 of 3 (0.09 to 0.99)" in found.tables[1].caption
    assert found.tables[0].rows[0][1] == "1 of 2 (0.01 to 0.99)"


def test_disturbances_come_in_all_phases_and_on_other_seeds() -> None:
    still, moved = trials(PlacingStudyConfig(trials=4, disturbed=6))
    assert {one.disturbed for one in moved.cases} == {"travel", "approach", "retreat"}
    assert not {one.seed for one in still.cases} & {one.seed for one in moved.cases}


@pytest.mark.slow
def test_a_container_that_is_toppled_on_the_way_is_noticed() -> None:
    found = try_placing(PlacingCase("jaco", 97, "approach"))  # it lay, and only its upper side was seen
    assert found.struck
    assert found.noticed == "image"
