"""Scales come from a sensor's own report, and none is made up; settings that a DAQ lacks are refused at once."""

import numpy as np
import pytest

from deformscope_drivers.clock import Stamp
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.optoforce import ForceMeasurement, Kind, OptoforceConfig, Sensitivity, Status


def measurement(kind: Kind, counts, per_count=None, offset=None) -> ForceMeasurement:
    return ForceMeasurement(Stamp(0, 0), kind, Status(0), counts, per_count, offset)


@pytest.mark.parametrize(
    ("report", "counts", "force_n"),
    [  # the sensors whose reports public drivers contain
        (Sensitivity((16037.0,) * 3, (40.0,) * 3), (401, -401, 8019), (1.000, -1.000, 20.001)),
        (Sensitivity((4000.0,) * 3, (10.0,) * 3), (400, 0, -4000), (1.0, 0.0, -10.0)),
        (Sensitivity((7925.0, 8641.0, 6049.0), (300.0, 300.0, 2000.0)), (7925, -8641, 6049), (300, -300, 2000)),
        (Sensitivity((10000.0, 10000.0, 6000.0), (150.0, 150.0, 1000.0)), (1000, 2000, 600), (15, 30, 100)),
    ],
)
def test_counts_become_newtons_by_the_sensors_own_report(report, counts, force_n) -> None:
    measured = measurement(Kind.THREE_AXIS, (counts,), report.per_count[None])
    assert measured.force_n == pytest.approx(np.array([force_n]), abs=6e-4)
    assert measured.torque_nm is None


def test_torques_have_their_own_scale() -> None:
    report = Sensitivity((1000.0, 1000.0, 2000.0, 500.0, 500.0, 250.0), (100.0, 100.0, 400.0, 5.0, 5.0, 5.0))
    measured = measurement(Kind.SIX_AXIS, ((100, -100, 100, 50, -50, 50),), report.per_count[None])
    assert measured.force_n == pytest.approx(np.array([[10.0, -10.0, 20.0]]))
    assert measured.torque_nm == pytest.approx(np.array([[0.5, -0.5, 1.0]]))


def test_without_a_report_there_are_counts_and_no_forces() -> None:
    measured = measurement(Kind.THREE_AXIS, ((1, 2, 3),))
    assert measured.counts == ((1, 2, 3),)
    with pytest.raises(DeviceError, match=r"a sensitivity report.*differs from sensor to sensor.*OptoforceConfig"):
        _ = measured.force_n


def test_an_offset_is_taken_away() -> None:
    measured = measurement(Kind.THREE_AXIS, ((10, 20, 30),), np.ones((1, 3)), np.array([[1.5, 0.0, -1.0]]))
    assert measured.force_n == pytest.approx(np.array([[8.5, 20.0, 31.0]]))


@pytest.mark.parametrize(
    ("counts", "nominal"),
    [((1.0, 2.0), (1.0, 2.0)), ((1.0,) * 3, (1.0,) * 6), ((0.0, 1.0, 1.0), (1.0,) * 3), ((1.0,) * 3, (1.0, -1.0, 1.0)),
     ((1.0, 1.0, float("nan")), (1.0,) * 3), ((), ())],
)  # fmt: skip
def test_a_report_that_is_none_is_refused(counts, nominal) -> None:
    with pytest.raises(ValueError, match="expected"):
        Sensitivity(counts, nominal)


def test_settings_that_the_daq_lacks_are_refused() -> None:
    with pytest.raises(ValueError, match="expected a rate of 1000, 333, 100, 30, 10, 0 Hz; got 500"):
        OptoforceConfig(port="x", rate_hz=500)
    with pytest.raises(ValueError, match=r"expected a filter of 500, 150, 50, 15, 5, 1\.5, 0 Hz; got 100"):
        OptoforceConfig(port="x", filter_hz=100)
    assert OptoforceConfig(port="x", rate_hz=333, filter_hz=1.5)
