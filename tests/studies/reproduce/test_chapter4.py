"""Chapter 4 by the thesis's rules: what makes its trend, and its figures."""

from pathlib import Path

import numpy as np
import pytest

from deformscope.stages.regions.touches import MapGrid
from studies.__main__ import main
from studies.reproduce import thesis_rules
from studies.reproduce.chapter4 import _format_row, _row
from studies.reproduce.chapter4_figures import draw_betas, draw_clouds, draw_dents, draw_fields
from studies.reproduce.thesis_dent import SeenDent

PNG = b"\x89PNG"


def made_foam(hardness_n: float) -> thesis_rules.FoamDent:
    grid = MapGrid((0.15, 0.15), 0.01)
    before = np.column_stack([grid.centres_m, np.full(225, 0.05)])
    after = before.copy()
    after[112, 2] -= 0.3 / hardness_n
    betas = tuple(
        thesis_rules.HeldBeta(hold, size, 0.5, None if hold == thesis_rules.HOLDS[-1] else 1e-4)
        for hold in thesis_rules.HOLDS
        for size in thesis_rules.CLUSTER_SIZES
        if size is not None or hold != thesis_rules.HOLDS[-1]
    )
    return thesis_rules.FoamDent(hardness_n, 0.3 / hardness_n, SeenDent(before, after, grid.shape), betas)


def made_scenario(scene: str, touches: int) -> thesis_rules.Scenario:
    truth = np.zeros((80, 120), dtype=np.int64)
    truth[:, 60:] = 1
    mean = np.where(truth, 0.0, 0.7) + np.linspace(0.0, 0.05, 120)
    field = thesis_rules.BetaField((0.7, 0.0), mean, np.array([0.35]), truth, 2, 1.0)
    contacts = np.column_stack([np.linspace(0.1, 0.5, touches), np.full(touches, 0.2)])
    fields = {"layers": field, "single layer": field}
    rigid = np.zeros(touches, dtype=bool)
    hardness = ("150", "rigid")
    return thesis_rules.Scenario(
        scene, 0, contacts, rigid, "budget", truth, hardness, 0.005, np.full(truth.shape, 0.05), fields
    )


@pytest.mark.slow  # matplotlib at the size of a page; `reproduce chapter4` is looked at
def test_figures_are_drawn(tmp_path: Path) -> None:
    foams = [made_foam(60), made_foam(150)]
    draw_clouds(foams[0], tmp_path / "44.png")
    draw_betas(foams, tmp_path / "45.png")
    draw_dents(foams, tmp_path / "46.png")
    draw_fields([made_scenario("two-150-rigid", 3), made_scenario("two-60-150", 1)], tmp_path / "47.png")
    for name in ("44", "45", "46", "47"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)


def test_a_row_of_table_4_1_has_the_thesis_beside_ours() -> None:
    row = _row("two-150-rigid", [made_scenario("two-150-rigid", count) for count in (4, 6)])
    assert (row["thesis_touches"], row["touches"]) == (4, [4, 6])
    assert _format_row(row).startswith("n = 4, 6 [4]; layers: regions 2, 2 [2], IoU 1.00")


@pytest.mark.slow  # whole touches, many sweeps
def test_beta_falls_with_firmness_by_the_exact_surface_and_not_in_a_single_layer() -> None:
    soft, firm = (thesis_rules.press_foam(thesis_rules.TouchedFoam(one, cluster_sizes=(2, 3))) for one in (30, 150))
    found = {(one.hold, one.cluster_size): [one.beta] for one in soft.betas}
    for one in firm.betas:
        found[one.hold, one.cluster_size].append(one.beta)
    first, second = found[thesis_rules.HOLDS[2], 2]
    assert first > second + 0.1
    assert max(found[thesis_rules.HOLDS[0], 3]) < 0.1


@pytest.mark.slow  # whole explorations
def test_where_is_touched_does_not_depend_on_beta_and_one_foam_takes_three() -> None:
    found = thesis_rules.explore_scenario(thesis_rules.ScenarioCase("homogeneous-60", 0))
    assert len(found.contacts_m) == 3
    assert found.stop_reason == "nothing above the threshold"
    for field in found.fields.values():
        assert len(field.touches) == 3
        assert (field.regions, field.iou) == (1, 1.0)


@pytest.mark.slow  # one foam, one scenario
def test_the_command_writes_what_it_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "chapter4", "--quick", "--jobs", "1", "--out", str(tmp_path)]) == 0
    assert "homogeneous-60  n = 3 [3]" in capsys.readouterr().out
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"figure44.png", "figure45.csv", "figure45.png", "figure46.png", "figure47.png", "table41.csv"}
