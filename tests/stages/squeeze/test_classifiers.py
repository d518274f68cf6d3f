"""Components and classifiers against scikit-learn's, and where classes are too small for them."""

import numpy as np
import pytest
from sklearn.base import BaseEstimator
from sklearn.covariance import empirical_covariance, ledoit_wolf, shrunk_covariance
from sklearn.datasets import load_digits
from sklearn.decomposition import PCA
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis, QuadraticDiscriminantAnalysis
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.squeeze.classifiers import (
    NAMES,
    SHARES,
    Neighbours,
    fit,
    fit_linear,
    fit_quadratic,
    folds_of,
    linear_share,
    neighbour_count,
)
from deformscope.stages.squeeze.components import fit_scaling, loadings, project
from tests.stages.squeeze.trials import blobs


def sides(count: int = 240, columns: int = 64) -> tuple[FloatArray, IntArray, FloatArray, IntArray]:
    digits = load_digits()
    x, y = digits.data[:count, :columns], digits.target[:count]
    return x[: count * 2 // 3], y[: count * 2 // 3], x[count * 2 // 3 :], y[count * 2 // 3 :]


def test_scaling_and_components_are_scikit_learns_of_the_training_side() -> None:
    train, _, test, _ = sides()
    scaling = fit_scaling(train)
    space = project(scaling.apply(train), scaling.apply(test))
    scaler = StandardScaler().fit(train[:, scaling.used])
    pca = PCA(0.8).fit(scaler.transform(train[:, scaling.used]))
    theirs = pca.transform(scaler.transform(test[:, scaling.used]))
    assert not scaling.used.all()  # the corners of digits are blank
    assert space.kept == pca.n_components_
    np.testing.assert_allclose(np.abs(space.test[:, : space.kept]), np.abs(theirs), atol=1e-8)


def test_components_from_inner_products_are_those_from_columns() -> None:
    rng = np.random.default_rng(0)
    train, test = rng.normal(size=(20, 50)), rng.normal(size=(8, 50))
    space = project(train, test)
    directions, variance = loadings(train)
    np.testing.assert_allclose(np.abs(space.train), np.abs((train - train.mean(axis=0)) @ directions), atol=1e-9)
    np.testing.assert_allclose(np.abs(space.test), np.abs((test - train.mean(axis=0)) @ directions), atol=1e-9)
    assert space.train.shape == (20, 19)
    assert variance.sum() == pytest.approx(train.var(axis=0).sum())
    # No distance to a training point is lost in the components, but for what is the same for all of them.
    apart = ((test[:, None] - train) ** 2).sum(axis=2) - ((space.test[:, None] - space.train) ** 2).sum(axis=2)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[:, :1], apart.shape), atol=1e-9)


def test_what_was_not_measured_becomes_the_mean_of_the_training_side() -> None:
    scaling = fit_scaling(np.array([[1.0, 5.0], [3.0, np.nan], [np.nan, 7.0]]))
    np.testing.assert_allclose(scaling.mean, [2.0, 6.0])
    np.testing.assert_allclose(scaling.apply(np.array([[np.nan, 8.0]])), [[0.0, 2.0]])


class Pooled(BaseEstimator):
    """A class's covariance weighed with the pooled one, for scikit-learn's QDA."""

    def __init__(self, pooled: FloatArray, weight: float) -> None:
        self.pooled, self.weight = pooled, weight

    def fit(self, x: FloatArray) -> None:
        scatter = empirical_covariance(x) * len(x)
        self.covariance_ = (scatter + self.weight * self.pooled) / (len(x) - 1 + self.weight)


class Unbiased(BaseEstimator):
    """A class's covariance with a share of the unit matrix, for scikit-learn's LDA."""

    def __init__(self, share: float) -> None:
        self.share = share

    def fit(self, x: FloatArray) -> None:
        self.covariance_ = shrunk_covariance(np.cov(x.T), self.share)


@pytest.mark.parametrize("name", ["knn", "qda", "linear"])
@pytest.mark.parametrize("columns", [12, 90])
def test_the_pipelines_are_scikit_learns_with_the_same_shrinkage(name: str, columns: int) -> None:
    # more and fewer columns than the 45 training points; classes of equal size, as scikit-learn's LDA weighs by class
    table = blobs(classes=3, each=25, columns=columns, apart=1.0, seed=6)
    x, y = table.modalities["touch"], table.target
    inside = np.tile(np.arange(25) < 15, 3)
    train, truth, test = x[inside], y[inside], x[~inside]
    scaling = fit_scaling(train)
    space = project(scaling.apply(train), scaling.apply(test))
    one, other = space.train[:, : space.kept], space.test[:, : space.kept]

    reduction = make_pipeline(StandardScaler(), PCA(0.8, svd_solver="full")).fit(train)
    theirs_one, theirs_other = reduction.transform(train), reduction.transform(test)
    np.testing.assert_allclose(other, np.sign((one * theirs_one).sum(axis=0)) * theirs_other, atol=1e-9)
    even = np.full(3, 1 / 3)
    if name == "knn":
        ours = Neighbours(one, truth, 5, 3).log_posterior(other)
        weights = 1.0 + 1e-3 * 0.5 ** np.arange(5)
        knn = KNeighborsClassifier(5, weights=lambda distance: np.tile(weights, (len(distance), 1)))
        share = knn.fit(theirs_one, truth).predict_proba(theirs_other)
        expected = (share * weights.sum() + 1 / 3) / (weights.sum() + 1)
    elif name == "qda":
        ours = fit_quadratic(one, truth, 3).log_posterior(other)
        about = np.concatenate([theirs_one[truth == c] - theirs_one[truth == c].mean(axis=0) for c in range(3)])
        size = theirs_one.shape[1]
        pooled = ledoit_wolf(about, assume_centered=True)[0] * len(truth) / (len(truth) - 3)
        pooled += 1e-9 * np.trace(pooled) / size * np.eye(size)
        qda = QuadraticDiscriminantAnalysis(
            solver="eigen", covariance_estimator=Pooled(pooled, size + 2.0), priors=even, tol=0.0
        )
        expected = qda.fit(theirs_one, truth).predict_proba(theirs_other)
    else:
        ours = fit_linear(one, truth, 3, 0.2).log_posterior(other)
        lda = LinearDiscriminantAnalysis(solver="lsqr", covariance_estimator=Unbiased(0.2), priors=even)
        expected = lda.fit(theirs_one, truth).predict_proba(theirs_other)

    assert np.ptp(expected, axis=0).min() > 0.3
    assert expected.min() > 1e-8  # none that ours would raise to its least posterior
    np.testing.assert_allclose(np.exp(ours), expected, rtol=0.0, atol=1e-9)


def test_the_number_of_neighbours_is_the_thesis_or_what_does_best_on_points_left_out() -> None:
    line, fold = np.arange(24.0)[:, None], np.arange(24) % 2
    target = np.repeat(np.arange(4), 6)
    assert neighbour_count(line, target % 3, 3, fold) == 3
    assert neighbour_count(line, target, 5, fold) == 5
    assert neighbour_count(line, target, 4, fold) == 1
    noisy = blobs(classes=2, each=60, apart=0.8)
    assert neighbour_count(noisy.modalities["touch"], noisy.target, 2, folds_of(noisy.target, None)) > 1


def test_of_many_points_the_gaussians_are_scikit_learns() -> None:
    table = blobs(classes=3, each=3000, columns=4, apart=1.5, seed=2)
    points, target = table.modalities["touch"], table.target
    prior = np.full(3, 1 / 3)
    quadratic = QuadraticDiscriminantAnalysis(priors=prior).fit(points, target)
    linear = LinearDiscriminantAnalysis(solver="lsqr", priors=prior).fit(points, target)
    ours = np.exp(fit_quadratic(points, target, 3).log_posterior(points))
    np.testing.assert_allclose(ours, quadratic.predict_proba(points), atol=0.01)
    # The clouds' covariance is the unit matrix, to which ours is shrunk; theirs has the errors of the sample.
    ours = np.exp(fit_linear(points, target, 3).log_posterior(points))
    np.testing.assert_allclose(ours, linear.predict_proba(points), atol=0.04)


def test_the_share_of_the_unit_matrix_is_that_of_the_least_loss_when_points_are_left_out_one_by_one() -> None:
    table = blobs(classes=3, each=9, columns=14, apart=3.0, seed=4)
    points, target = table.modalities["touch"], table.target
    points[:, 0] *= 5.0
    loss = []
    for share in SHARES:
        one_by_one = []
        for row in range(len(points)):
            others = np.arange(len(points)) != row
            fitted = fit_linear(points[others], target[others], 3, share)
            one_by_one.append(-fitted.log_posterior(points[row : row + 1])[0, target[row]])
        loss.append(np.mean(one_by_one))
    assert linear_share(points, target, 3) == SHARES[int(np.argmin(loss))]
    assert 0 < int(np.argmin(loss)) < len(SHARES) - 1


@pytest.mark.parametrize("name", NAMES)
def test_classes_of_one_point_or_none_are_no_accident(name: str) -> None:
    rng = np.random.default_rng(1)
    target = np.array([0, 0, 0, 0, 2, 3, 3])
    points = rng.normal(size=(7, 12)) + 8.0 * target[:, None]
    logs = fit(name, points, target, 5).log_posterior(points)  # type: ignore[arg-type]
    assert np.isfinite(logs).all()
    np.testing.assert_allclose(np.exp(logs).sum(axis=1), 1.0)
    assert not set(logs.argmax(axis=1)) & {1, 4}
    assert logs[4].argmax() == (2 if name != "knn" else logs[4].argmax())
