"""From a bag of another robot that poked foam to contact, stiffness with its interval, surface and map."""

import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.recording.items import read_results, read_stage_results
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate, TouchEstimate
from tests.cli.quick_scene import use_coarse_maps
from tests.imports.test_importing import answered, inspected
from tests.imports.touched_bag import GEOMETRY, SIZE_M, THICKNESS_M, stiffness_n_per_mm, write_touched_bag
from tests.verified import verify_here

PLACES_M = [(0.05, 0.05), (0.19, 0.11), (0.06, 0.12), (0.18, 0.04), (0.15, 0.08)]


def imported(folder: Path, *flags: str) -> Path:
    """The recording that a bag of touches became."""
    bag = write_touched_bag(folder / "bag", PLACES_M)
    text = answered(inspected(bag), ('parent = "?"', 'parent = "base"'), ('child = "?"', 'child = "tool0"'))
    (folder / "map.toml").write_text(text + GEOMETRY)
    run = folder / "run.rrd"
    assert main(["import", str(bag), "--map", str(folder / "map.toml"), "--record", str(run), *flags]) == 0
    return run


@pytest.mark.slow
def test_stages_run_on_what_is_imported_and_are_replayed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = imported(tmp_path, "--stage", "contact", "--stage", "surface")
    results = read_stage_results(run)
    felt = [one.result for one in results if isinstance(one.result, TouchEstimate)]
    assert len(felt) == len(PLACES_M)
    for (x, _), one in zip(PLACES_M, felt, strict=True):
        low, high = one.stiffness_interval
        assert low < stiffness_n_per_mm(x) < high
    seen = [one.result for one in results if isinstance(one.result, SurfaceEstimate)]
    assert len(seen) > 20
    np.testing.assert_allclose(np.median(seen[0].height_m), THICKNESS_M, atol=5e-4)
    assert main(["replay", str(run)]) == 0
    assert "identical" in "".join(capfd.readouterr())


@pytest.mark.slow  # recorded touches become a map in `tests/experiments/explore/test_recorded_touches.py` too
def test_recorded_touches_become_a_map(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    use_coarse_maps(monkeypatch)
    made = tmp_path / "map.rrd"
    flags = ["--beta-model", "none", "--record", str(made), "--json", str(tmp_path / "found.json")]
    assert main(["explore", str(imported(tmp_path)), *flags]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert len(found["touches"]) == len(PLACES_M)
    for (x, y), one in zip(PLACES_M, found["touches"], strict=True):
        np.testing.assert_allclose(one["xy_m"], [x, y], atol=2e-4)
        low, high = one["apparent_stiffness_interval"]
        assert low < stiffness_n_per_mm(x) < high
        assert high / low < 1.5
    assert found["region_count"] == 2
    results = [row.item for row in read_results(made)]
    surface = next(one for one in results if isinstance(one, SurfaceEstimate))
    assert np.abs(surface.height_m - THICKNESS_M)[4:-4, 4:-4].max() < 1.5e-3
    maps = [one for one in results if isinstance(one, MapEstimate)][-1]
    rows, columns = maps.stiffness_n_per_mm.shape
    for x, y in PLACES_M:
        cell = int(y / SIZE_M[1] * rows), int(x / SIZE_M[0] * columns)
        np.testing.assert_allclose(maps.stiffness_n_per_mm[cell], stiffness_n_per_mm(x), rtol=0.15)
    assert verify_here(made) == 0
    assert main(["replay", str(made)]) == 0
    assert "identical" in "".join(capfd.readouterr())
