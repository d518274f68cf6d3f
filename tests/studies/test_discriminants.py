"""The study of discriminant analyses: the share that scikit-learn's get, and differences as own less theirs."""

import numpy as np
import pytest
from sklearn.discriminant_analysis import QuadraticDiscriminantAnalysis

from studies import discriminants
from tests.stages.squeeze.trials import blobs


def test_theirs_takes_the_share_of_the_least_log_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two round clouds of few trials, whose own covariances say little."""
    table = blobs(classes=2, each=8, columns=6, apart=2.0, seed=1)
    points, target = table.modalities["touch"], table.target
    monkeypatch.setattr(discriminants, "SHARES", (0.001, 1.0))
    found = discriminants.theirs("qda", points, target, points, np.arange(len(target)) % 5)
    wide = QuadraticDiscriminantAnalysis(solver="eigen", shrinkage=1.0, priors=[0.5, 0.5])
    expected = wide.fit(points, target).predict_proba(points)
    np.testing.assert_allclose(np.exp(found), expected, atol=1e-8)


def test_the_report_has_the_mean_and_its_error() -> None:
    tried = [[discriminants.Difference("touch", "qda", right, 0.0)] for right in (0.1, 0.3)]
    said = discriminants.report(discriminants.DiscriminantsConfig(trials=2), 1.0, tried)
    assert said.json == {
        "splits": 2,
        "differences": [{"method": "qda", "modality": "touch", "right": [0.2, pytest.approx(0.1)], "log_loss": [0, 0]}],
    }
