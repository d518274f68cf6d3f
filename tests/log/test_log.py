"""What is drawn is what was found: positions, errors and numbers, read back from the recording."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from scipy.spatial import cKDTree

from deformscope.files.sources import open_source
from deformscope.frames import InputFile
from deformscope.log.blueprint import blueprint
from deformscope.log.canvas import Canvas
from deformscope.log.layout import PAIR, PAIR_3D
from deformscope.log.over_picture import summary
from deformscope.pictures.evidence import evidence_png
from deformscope.pictures.palette import colors, readable, round_up
from deformscope.plain import plain
from deformscope.recording.items import read_estimates
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from deformscope.rows import differing
from deformscope.session import Step, run
from deformscope.stages.see.triangulation import spacing_of
from tests.log import synthetic
from tests.pictures.test_closeup import poked


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.rrd"
    with open_source(["sample:tension"]) as source, Recorder(path) as made:
        run(source, synthetic.calibration(), made)
    return path


def values(path: Path, entity: str, component: str, frame: int | None = None) -> Any:
    """One component of an entity at a frame, as it lies in the file."""
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        frames = [None] * chunk.num_rows if chunk.is_static else batch.column("frame").to_pylist()
        for place, at in enumerate(frames):
            if at == frame and batch.column(component)[place].is_valid:
                return batch.column(component)[place].as_py()
    raise AssertionError(f"no {component} of {entity} at frame {frame}")


def test_particles(recording: Path) -> None:
    rest = np.array(values(recording, "/particles/rest", "Points2D:positions", 0))
    np.testing.assert_allclose(rest, synthetic.lattice().rest_px, rtol=1e-6)
    assert len(values(recording, "/particles/observed", "Points2D:positions", 2)) == 154
    assert len(values(recording, "/particles/observed", "Points2D:positions", 6)) == 151
    assert len(values(recording, "/particles/lost", "LineStrips2D:strips", 6)) == 3 * 2 * 2
    assert len(values(recording, "/particles/lost", "LineStrips2D:strips", 2)) == 0
    assert values(recording, "/particles/legend/lost/label", "Points2D:labels", 6) == ["lost: 3"]
    assert sum(values(recording, "/particles/observed", "seen", 6)) == 151
    assert 2 < values(recording, "/particles/observed", "Points2D:radii", 6)[0] < 6


def test_arrows_stay_on_the_specimen(recording: Path) -> None:
    origins = np.array(values(recording, "/flow/arrows", "Arrows2D:origins", 4))
    vectors = np.array(values(recording, "/flow/arrows", "Arrows2D:vectors", 4))
    assert 50 < len(origins) < 400
    assert origins[:, 0].min() > 130
    assert origins[:, 0].max() < 260
    assert np.median(vectors[:, 1]) < 0  # pulled upwards


def test_simulated_and_residuals(recording: Path) -> None:
    grid = synthetic.lattice()
    assert np.array(values(recording, "/particles/simulated", "Points2D:positions", 6)).shape == grid.rest_px.shape
    lines = np.array(values(recording, "/residual/lines", "LineStrips2D:strips", 6))
    assert lines.shape == (151, 2, 2)
    residual = np.array(values(recording, "/residual/points", "residual", 6))
    particle = np.array(values(recording, "/residual/points", "particle", 6))
    assert set(range(154)) - set(particle) == {25, 26, 80}
    np.testing.assert_allclose(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1), residual, atol=1e-4)
    assert values(recording, "/error/aee", "Scalars:scalars", 6)[0] == pytest.approx(residual.mean())
    free = (particle >= 7) & (particle < 147)
    assert values(recording, "/error/aee_free", "Scalars:scalars", 6)[0] == pytest.approx(residual[free].mean())


def test_estimate(recording: Path) -> None:
    expected = synthetic.estimate()
    curve = expected.curve
    np.testing.assert_array_equal(values(recording, "/calibration/curve", "beta"), curve.parameter)
    np.testing.assert_array_equal(values(recording, "/calibration/curve", "aee"), curve.aee)
    assert values(recording, "/calibration/estimate", "Estimate:interval") == [0.56, 0.69]
    (found,) = read_estimates(Replay(recording))
    assert differing(found, expected) is None
    assert plain(found.as_json()) == plain(expected.as_json())
    png = bytes(values(recording, "/calibration/chart", "EncodedImage:blob")[0])
    assert cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).shape == (728, 1040, 3)
    text = values(recording, "/calibration/summary", "TextDocument:text")[0]
    assert "# beta = 0.62" in text
    assert "identified: beta is 0.56 to 0.69" in text
    assert "0.56 to 0.69" in text
    assert "| cluster_size | 3 |" in text


def test_sixteen_bits_are_shown_in_their_range(tmp_path: Path) -> None:
    dark = [
        type(frame)(frame.stamp, frame.index, (frame.image >> 6).astype(np.uint16))
        for frame in synthetic.frames(2, depth=np.uint16)
    ]
    with Recorder(tmp_path / "run.rrd") as made:
        for frame in dark:
            made.write(frame)
    jpeg = bytes(values(tmp_path / "run.rrd", "/display/image", "EncodedImage:blob", 1)[0])
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.dtype == np.uint8
    assert shown.max() > 240
    assert shown.min() < 15


@pytest.mark.parametrize("dimensions", [2, 3])
def test_pairs(tmp_path: Path, dimensions: int) -> None:
    pair = synthetic.pair_in_plane() if dimensions == 2 else synthetic.pair_in_space()
    path = tmp_path / "run.rrd"
    with Recorder(path, application=PAIR) as made:
        made.write(InputFile("pair/0", b"some bytes"))
        made.write(Step((pair, synthetic.estimate(unit="m")), frame=0))
    kind = f"Points{dimensions}D"
    for name, expected in (("rest", pair.rest), ("observed", pair.observed[pair.seen]), ("simulated", pair.simulated)):
        found = np.array(values(path, f"/particles/{name}", f"{kind}:positions", 0))
        np.testing.assert_allclose(found, expected, atol=1e-7)
    assert values(path, "/calibration/estimate", "Estimate:verdict", 0)
    assert len(RrdReader(path).blueprints()) == 1


def test_chart_of_every_verdict() -> None:
    for verdict in ("identified", "weak", "at-bound", "unidentified"):
        estimate = dataclasses.replace(synthetic.estimate(verdict), converged=verdict != "weak")
        assert evidence_png(estimate).startswith(b"\x89PNG")
        assert estimate.verdict_text() in summary(estimate)
    scaled = dataclasses.replace(synthetic.estimate(), metres_per_unit=1e-4, stiffness=(12.0, (11.0, 13.5)))
    assert "| 0.35 px, 0.035 mm |" in summary(scaled)
    assert "12 N/m (11 to 13.5)" in summary(scaled)
    gaps = synthetic.estimate()
    gaps.curve.aee[[0, 1, 5]] = np.nan
    assert evidence_png(gaps).startswith(b"\x89PNG")
    assert plain(gaps.as_json())["curve"]["aee"][0] is None
    gaps.curve.aee[:] = np.nan
    assert evidence_png(gaps).startswith(b"\x89PNG")


def test_one_chart_is_one_picture() -> None:
    assert evidence_png(synthetic.estimate()) == evidence_png(synthetic.estimate())


@pytest.mark.parametrize("size", [(100.0, 900.0), (200.0, 500.0), (640.0, 480.0), (1000.0, 200.0)])
@pytest.mark.parametrize("layout", ["images", "flow", "pair"])
def test_blueprints(size: tuple[float, float], layout: Any) -> None:
    for canvas in (Canvas((0.0, 0.0), size, 5.0, image="input/image"), Canvas((0.0, 0.0, 0.0), (*size, 3.0), 5.0)):
        blueprint(layout, canvas)


def test_scales() -> None:
    assert [round_up(value) for value in (0.0, 0.3, 1.0, 1.1, 4.9, 7.0, 1234.0)] == [1, 0.5, 1, 2, 5, 10, 2000]
    assert readable("m", 0.002) == (1e3, "mm")
    assert readable("m", 0.00002) == (1e6, "µm")
    assert readable("m", 0.0) == (1e3, "mm")
    assert readable("px", 0.002) == (1.0, "px")
    assert colors(np.array([0.0, 1.0, 7.0, np.nan])).shape == (4, 3)
    assert colors(np.zeros(0)).shape == (0, 3)


def test_spacing() -> None:
    assert spacing_of(synthetic.lattice().rest_px) == pytest.approx(14.29, abs=0.1)
    assert spacing_of(np.zeros((1, 2))) == 0.0
    assert spacing_of(np.column_stack([synthetic.lattice().rest_px, np.zeros(154)])) == pytest.approx(14.29, abs=0.1)


def test_the_canvas_follows_the_particles() -> None:
    canvas = Canvas((0.0, 0.0), (200.0, 100.0), image="input/image")
    moved = canvas.around(np.array([[10.0, 20.0], [30.0, 60.0], [np.nan, 1.0]]))
    assert moved.particles.tolist() == [[10.0, 20.0], [30.0, 60.0]]
    assert canvas.around(np.full((3, 2), np.nan)) == canvas


def decoded(path: Path, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns, 4) the heat map as it is stored, and (2, 2) its corner and its cells' sides."""
    png = bytes(values(path, "/heat/map", "EncodedImage:blob", frame)[0])
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    corner = values(path, "/heat/map", "Transform3D:translation", frame)[0][:2]
    return picture, np.array([corner, values(path, "/heat/map", "Transform3D:scale", frame)[0][:2]])


def test_the_heat_map_lies_over_the_body(recording: Path) -> None:
    error = np.array(values(recording, "/heat/map", "error", 6))
    particle = np.array(values(recording, "/heat/map", "particle", 6))
    assert len(error) == 151
    picture, (corner, side) = decoded(recording, 6)
    assert picture.shape == decoded(recording, 2)[0].shape  # a viewer takes pictures of one size alone
    observed = np.array(values(recording, "/residual/points", "Points2D:positions", 6))
    inner = (particle % 7 > 0) & (particle % 7 < 6) & (particle > 7) & (particle < 147)
    column, row = ((observed[inner] - corner) / side).astype(int).T
    found = picture[row, column]
    assert (found[:, 3] > 150).mean() > 0.9  # over the body, but for the surroundings of three lost particles
    expected = colors(error[inner] / round_up(float(error.max())))[:, ::-1].astype(int)
    shown = found[:, 3] > 150
    assert np.abs(found[shown, :3] - expected[shown]).max(axis=1).mean() < 12
    assert (picture[..., 3] == 0).mean() > 0.3  # beside the body
    assert values(recording, "/heat/legend/worst/label", "Points2D:labels", 6) == [
        f"largest error: {error.max():.3g} px"
    ]
    ring = np.array(values(recording, "/heat/worst", "LineStrips2D:strips", 6)[0])
    np.testing.assert_allclose(ring[:-1].mean(axis=0), observed[np.argmax(error)], atol=1e-3)


def test_a_pair_in_the_plane_stands_upright(tmp_path: Path) -> None:
    pair = synthetic.pair_in_plane()
    with Recorder(tmp_path / "run.rrd", application=PAIR) as made:
        made.write(Step((pair, synthetic.estimate(unit="m")), frame=0))
    for path in ("particles/rest", "particles/observed", "particles/simulated", "residual/lines", "heat/worst"):
        assert values(tmp_path / "run.rrd", f"/{path}", "Transform3D:scale", 0)[0] == [1.0, -1.0, 1.0]
    _, (corner, side) = decoded(tmp_path / "run.rrd", 0)
    assert side[0] == -side[1] > 0
    np.testing.assert_allclose(corner, pair.observed.min(axis=0) * [1, -1], atol=1e-7)


def test_a_volume_is_covered_by_its_skin(tmp_path: Path) -> None:
    pair = synthetic.pair_in_space()
    with Recorder(tmp_path / "run.rrd", application=PAIR_3D) as made:
        made.write(Step((pair, synthetic.estimate(unit="m")), frame=0))
    path = tmp_path / "run.rrd"
    place = np.array(values(path, "/heat/map", "Mesh3D:vertex_positions", 0))
    np.testing.assert_allclose(place, pair.observed[pair.seen], atol=1e-7)
    error = np.linalg.norm(pair.observed - pair.simulated, axis=1)[pair.seen]
    np.testing.assert_allclose(values(path, "/heat/map", "error", 0), error)
    triangles = np.array(values(path, "/heat/map", "Mesh3D:triangle_indices", 0))
    assert triangles.max() < len(place)
    assert np.unique(triangles).size == 9 * 9 + 9 * 9 + 32  # two faces, and the rim of the layer between
    assert values(path, "/heat/legend/label", "Points3D:labels", 0) == ["0 mm", "2.5 mm", "5 mm"]
    first = values(path, "/heat/worst", "LineStrips3D:strips", 0)[0][0]
    np.testing.assert_allclose(first, place[np.argmax(error)], atol=1e-7)


def test_a_poke_is_shown_close_and_recorded_whole(tmp_path: Path) -> None:
    first, second = poked(), poked(at=(0.4, 0.25))
    with Recorder(tmp_path / "run.rrd", application=PAIR_3D) as made:
        for frame, pair in enumerate((first, second)):
            made.write(Step((pair,), frame=frame))
        made.write(Step((synthetic.estimate(unit="m"),), frame=1))
    path = tmp_path / "run.rrd"
    for frame, pair in enumerate((first, second)):
        deepest = pair.rest[np.argmin(pair.observed[:, 2])]
        scale = np.array(values(path, "/particles/observed", "Transform3D:scale", frame)[0])
        moved = np.array(values(path, "/particles/observed", "Transform3D:translation", frame)[0])
        assert scale[2] > 1.0
        assert scale[:2].tolist() == [1.0, 1.0]
        np.testing.assert_allclose((deepest * scale + moved)[:2], 0.0, atol=1e-6)  # every poke under one eye
        assert values(path, "/particles/legend/heights/label", "Points3D:labels", frame) == [
            f"heights drawn {scale[2]:g} times"
        ]
        near = np.array(values(path, "/particles/simulated", "Points3D:positions", frame))
        beyond = np.array(values(path, "/beyond/simulated", "Points3D:positions", frame))
        assert 50 < len(near) < 400
        away, which = cKDTree(pair.simulated).query(np.concatenate([near, beyond]))
        assert away.max() < 1e-6
        assert sorted(which) == list(range(len(pair.rest)))


def test_each_pair_of_a_recording_is_drawn_its_own_way(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    pairs = (synthetic.pair_in_plane(), poked(), synthetic.pair_in_space())
    with Recorder(path, application=PAIR_3D) as made:
        for frame, pair in enumerate(pairs):
            made.write(Step((pair, synthetic.estimate(unit="m")), frame=frame))
    scales = [values(path, "/particles/observed", "Transform3D:scale", frame)[0] for frame in range(3)]
    assert scales[0] == [1.0, -1.0, 1.0]
    assert scales[1][2] > 1.0
    assert scales[2] == [1.0, 1.0, 1.0]
    assert values(path, "/particles/observed", "Transform3D:translation", 2)[0] == [0.0, 0.0, 0.0]


def test_nothing_to_compare_is_no_error(tmp_path: Path) -> None:
    pair = synthetic.pair_in_plane()
    blind = dataclasses.replace(pair, seen=np.zeros(len(pair.rest), dtype=bool))
    exact = dataclasses.replace(pair, simulated=pair.observed)
    with Recorder(tmp_path / "run.rrd", application=PAIR) as made:
        made.write(Step((blind,), frame=0))
        made.write(Step((exact,), frame=1))
    assert values(tmp_path / "run.rrd", "/heat/legend/worst/label", "Points2D:labels", 1) == ["largest error: 0 mm"]


def test_a_long_recording_stays_small(recording: Path) -> None:
    sizes = [len(values(recording, "/heat/map", "EncodedImage:blob", frame)[0]) for frame in range(1, 7)]
    assert max(sizes) < 16_000
