"""Pictures: what they show changes with what was found, whatever its shape; they are PNG files of a sensible size."""

import dataclasses

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from deformscope.pictures import evidence
from deformscope.pictures import evidence as pictures
from deformscope.stages.fit.estimate import Comparison, Estimate, Posterior, PushCurve
from tests.log import synthetic
from tests.pictures.test_closeup import poked


def posterior(middle: float, deviation: float) -> Posterior:
    at = np.linspace(max(middle - 8 * deviation, 0.0), min(middle + 8 * deviation, 1.0), 301)
    density = np.exp(-0.5 * ((at - middle) / deviation) ** 2)
    return Posterior(at, density / np.trapezoid(density, at))


def estimate(unit: str = "m", verdict: str = "identified") -> Estimate:
    return dataclasses.replace(synthetic.estimate(verdict, unit), posterior=posterior(0.62, 0.04))


def decoded(png: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture.std() > 15
    return picture


def in_pixels() -> Comparison:
    grid = synthetic.lattice()
    seen = np.ones(len(grid.rest_px), dtype=bool)
    seen[[3, 60]] = False
    observed = grid.rest_px.copy()
    observed[~seen] = np.nan
    return synthetic.compare(grid.rest_px, observed, seen, synthetic.SHAPE, 4)


CASES = {
    "plane": synthetic.pair_in_plane(),
    "space": synthetic.pair_in_space(),
    "surface": poked(),
    "pixels": in_pixels(),
}


@pytest.mark.parametrize(
    "name", ["pixels", *(pytest.param(name, marks=pytest.mark.slow) for name in ("space", "plane", "surface"))]
)
def test_each_kind_of_body(name: str) -> None:
    comparison = CASES[name]
    image = np.tile(np.arange(400, dtype=np.uint8), (330, 1)) if name == "pixels" else None
    result = evidence.Result(estimate(comparison.unit), (comparison,), ("a.npz",), image)
    assert decoded(evidence.results_png([result])).shape[1] == 1870
    exact = dataclasses.replace(comparison, simulated=np.where(comparison.seen[:, None], comparison.observed, 0.0))
    perfect = dataclasses.replace(result, comparisons=(exact,))
    for draw in (evidence.particles_png, evidence.errors_png):
        drawn = draw(result, 0)
        assert draw(perfect, 0) != drawn
        assert max(decoded(drawn).shape) < 800


def test_the_heat_map_is_bright_where_the_error_is() -> None:
    pair = synthetic.pair_in_plane()
    right = pair.rest[:, 0] > 0.05
    pair = dataclasses.replace(pair, observed=pair.rest, simulated=pair.rest + np.outer(right, [0.005, 0.0]))
    picture = decoded(evidence.errors_png(evidence.Result(estimate(), (pair,), ("",)), 0)).astype(int)
    yellow = np.flatnonzero(np.abs(picture - [33, 249, 240]).max(axis=2).min(axis=0) < 12)
    violet = np.flatnonzero(np.abs(picture - [135, 8, 13]).max(axis=2).min(axis=0) < 12)
    bar = 0.75 * picture.shape[1]  # the colour bar stands to the right of the body
    assert violet.min() < yellow[yellow < bar].min()
    assert violet[violet < bar].max() < yellow[yellow < bar].max()


def test_a_posterior_that_peaks_elsewhere_than_the_lowest_error_says_so() -> None:
    said = []
    for middle, low in ((estimate().value, 0.2), (0.25, 0.2), (0.25, 0.3)):
        axes = Figure().subplots()
        found = dataclasses.replace(estimate(), posterior=posterior(middle, 0.1), interval=(low, 0.7))
        evidence._draw_posterior(axes, found, 11)
        legend = axes.get_legend()
        said.append([] if legend is None else [text.get_text() for text in legend.get_texts()])
    assert said[0] == []
    assert any("most likely" in one and "0.25" in one for one in said[1])
    assert any(f"estimate: {estimate().value:.3g}" in one for one in said[1])
    assert said[2] == []  # what the interval leaves out is not marked


def test_evidence_with_and_without_posterior_and_very_narrow() -> None:
    with_it = estimate()
    narrow = dataclasses.replace(with_it, interval=(0.6195, 0.6205), posterior=posterior(0.62, 3e-4))
    pictures = [evidence.evidence_png(one) for one in (with_it, narrow, dataclasses.replace(with_it, posterior=None))]
    assert len({decoded(png).shape for png in pictures}) == 1  # one size, as a viewer needs
    assert len(set(pictures)) == 3
    unfinished = dataclasses.replace(with_it, converged=False)
    assert evidence.verdict_color(with_it) != evidence.verdict_color(unfinished)
    assert "NOT CONVERGED" in evidence.headline(unfinished)
    assert "0.56 to 0.69" in evidence.headline(with_it)


def test_the_force_over_the_depth_is_drawn_with_the_line_of_its_stiffness() -> None:
    curve = PushCurve(np.array([0.0, 0.004, 0.01]), np.array([0.0, 1.9, 5.1]))
    pushed = dataclasses.replace(
        estimate(), force=(5.1, (4.9, 5.3)), contact_stiffness=(0.5, (0.4, 0.6)), force_curve=curve
    )
    single = dataclasses.replace(pushed, force_curve=None)
    for one, depth_mm in ((pushed, [0.0, 4.0, 10.0]), (single, [10.2])):
        axes = Figure().subplots()
        pictures._draw_force(axes, one, 10)
        drawn = {line.get_label(): line for line in axes.get_lines()}
        np.testing.assert_allclose(drawn["measured"].get_xdata(), depth_mm)
        fitted = next(line for line in axes.get_lines() if line.get_linestyle() == "--")
        np.testing.assert_allclose(fitted.get_ydata(), 0.5 * np.asarray(fitted.get_xdata()))
        assert axes.get_legend().get_texts()[0].get_text() == "0.5 N/mm, 90% interval"
    plain, tall = (decoded(evidence.evidence_png(one)) for one in (estimate(), pushed))
    assert tall.shape[0] > plain.shape[0]
    whole = [evidence.Result(one, (synthetic.pair_in_plane(),), ("",)) for one in (pushed, single)]
    assert (decoded(evidence.results_png(whole[:1])) != decoded(evidence.results_png(whole[1:]))).any()


@pytest.mark.slow  # many pictures
def test_several_pairs_are_rows_and_the_worst_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = synthetic.pair_in_plane()
    better = dataclasses.replace(pair, simulated=pair.observed)
    one, good = evidence.Result(estimate(), (pair,), ("a.npz",)), evidence.Result(estimate(), (better,), ("b.npz",))
    together = evidence.Result(estimate(), (pair, better), ("a.npz", "b.npz"))
    apart = evidence.results_png([one, good])
    assert decoded(apart).shape == decoded(evidence.results_png([together])).shape
    assert decoded(apart).shape[0] > decoded(evidence.results_png([one])).shape[0]
    monkeypatch.setattr(pictures, "MOST_ROWS", 1)
    assert pictures._rows([good, one, good]) == [(1, 0)]
    assert pictures._rows([together]) == [(0, 0)]
    assert decoded(evidence.results_png([good, one])).shape[0] < decoded(apart).shape[0]


def test_errors_and_where_the_model_is_wrong() -> None:
    pair = synthetic.pair_in_plane()
    simulated = pair.observed.copy()
    simulated[10] += [0.003, 0.004]
    seen = pair.seen.copy()
    seen[20] = False
    found = dataclasses.replace(pair, simulated=simulated, seen=seen)
    error = evidence.errors(found)
    assert error[10] == pytest.approx(0.005)
    assert np.isnan(error[20])
    assert np.nansum(error) == pytest.approx(0.005)
    said = evidence.where_wrong(found)
    place = ", ".join(f"{1e2 * v:.3g}" for v in pair.rest[10])
    assert f"The largest error is 5 mm, at the particle with rest position ({place}) cm" in said
    assert "2% of the particles have half" in said
    assert evidence.where_wrong(dataclasses.replace(pair, seen=np.zeros_like(seen))) == "No particle was observed."


def test_the_same_result_is_the_same_picture() -> None:
    result = evidence.Result(estimate(), (synthetic.pair_in_plane(),), ("a.npz",))
    assert evidence.results_png([result]) == evidence.results_png([result])
