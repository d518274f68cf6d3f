"""How fields of stiffness are scored."""

import dataclasses

import numpy as np
import pytest

from studies.field import FieldBody, FieldOutcome, field_rows, try_field
from studies.independent.orthotropic_elements import OrthotropicLaw, PlateWay, deformed_plate


def test_a_row_counts_what_was_right_and_how_near() -> None:
    good = FieldOutcome("two, stretch", 0, "materials", True, 1.1, True, 1.0, 1.0, 0.1, 0.8)
    far = dataclasses.replace(good, ratio=0.7, border=3.0, covered=False, held=0.5)
    silent = dataclasses.replace(good, verdict="unidentified", right=False, ratio=9.0)
    wrong = dataclasses.replace(silent, verdict="gradual", claims=True, reasons=("smooth-error",), directions=1.2)
    ((kind, right, unidentified, near, ratio, border, held, *more, beta),) = field_rows([good, far, silent])
    assert (kind, right, unidentified, near, border) == ("two, stretch", "2 of 3", "1", "50%", "50%")
    assert (ratio, held, beta) == ("0.70 to 1.10", "0.67, 0.83", "0.80")
    assert more == ["0 of 3", "0", "-"]
    assert field_rows([good, wrong])[0][-4:-1] == ("1 of 2", "1", "1.20 to 1.20")


@pytest.mark.parametrize("way", ["stretch", "shear"])
def test_own_elements_of_two_materials_share_a_stretch_by_their_stiffness(way: PlateWay) -> None:
    """In series, without Poisson's ratio: the softer half of ratio 3 takes three quarters of it. One material looks the
    same when it is turned by half a circle."""
    law = OrthotropicLaw(stiff=1.0, soft=1.0, nu=0.0, shear=0.5, angle=0.0)
    rest, moved = deformed_plate((9, 5), law, lambda at: np.where(at[:, 0] < 0.04, 3.0, 1.0), way, 0.05)
    off = moved - rest
    if way == "stretch":
        assert off[np.isclose(rest[:, 0], 0.04), 0] == pytest.approx(0.25 * 0.05 * 0.08)
        assert off[:, 1] == pytest.approx(0.0, abs=1e-12)
    plain = deformed_plate((9, 5), law, lambda at: np.ones(len(at)), way, 0.05)[1] - rest
    assert plain + plain[::-1] == pytest.approx(np.tile(plain[-1], (len(plain), 1)), abs=1e-12)


def test_an_independent_body_is_tried_as_the_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.field.INDEPENDENT_BODIES", {"small": FieldBody((7, 5), "shear", None, 1, camera=True)})
    outcome = try_field(("small", 2999))
    assert (outcome.kind, outcome.covered, outcome.held) == ("small", True, 1.0)
    assert not outcome.claims
