"""When a hand that squeezes must stop: at the first reading that says so, and not before."""

import pytest

from deformscope.rig.sections import ContainerSection, SqueezeSection
from deformscope.robot.squeeze_plan import GripShape
from deformscope.robot.squeeze_supervisor import SqueezeFault, SqueezeObservation, SqueezeSupervisor

PERIOD_NS = 20_000_000
OPEN = GripShape.of(ContainerSection(), SqueezeSection()).open_deg


def closed_by(angle_deg: float) -> tuple[float, ...]:
    """Both proximal axes closed so far from the pre-shape."""
    return tuple(angle + angle_deg * (axis in (1, 5)) for axis, angle in enumerate(OPEN))


def seen(now_ns: int, angle_deg: float = 0.0, peak: int = 0, **changes: object) -> SqueezeObservation:
    given: dict[str, object] = {
        "hand_ns": (now_ns,),
        "position_deg": (closed_by(angle_deg),),
        "tactile_ns": (now_ns,),
        "peak_counts": (peak,),
    }
    return SqueezeObservation(now_ns, **(given | changes))  # type: ignore[arg-type]


@pytest.fixture
def supervisor() -> SqueezeSupervisor:
    return SqueezeSupervisor(SqueezeSection(over_squeeze_m=0.01), (0, 2), 0)


def test_a_squeeze_that_is_well_goes_on(supervisor: SqueezeSupervisor) -> None:
    for period in range(1, 100):
        assert supervisor.judge(seen(period * PERIOD_NS, 0.1 * period, 4094)).fault is SqueezeFault.NONE


def test_a_saturated_texel_stops_it(supervisor: SqueezeSupervisor) -> None:
    verdict = supervisor.judge(seen(PERIOD_NS, peak=4095))
    assert (verdict.fault, verdict.time_ns) == (SqueezeFault.SATURATED, PERIOD_NS)
    assert "4095 counts" in verdict.reason


def test_the_way_counts_from_the_first_contact_on(supervisor: SqueezeSupervisor) -> None:
    supervisor.judge(seen(PERIOD_NS, 12.0))
    assert supervisor.verdict.fault is SqueezeFault.NONE
    supervisor.in_contact()
    assert supervisor.judge(seen(2 * PERIOD_NS, 13.0)).fault is SqueezeFault.NONE  # 2 x 2.7 mm
    assert supervisor.judge(seen(3 * PERIOD_NS, 14.5)).fault is SqueezeFault.OVER_SQUEEZED


@pytest.mark.parametrize(
    ("missing", "fault"),
    [
        ({"hand_ns": (), "position_deg": ()}, SqueezeFault.HAND_SILENT),
        ({"tactile_ns": (), "peak_counts": ()}, SqueezeFault.TACTILE_SILENT),
    ],
)
def test_silence_stops_it_in_time_but_not_one_late_look(missing: dict[str, object], fault: SqueezeFault) -> None:
    late = SqueezeSupervisor(SqueezeSection(), (0, 2), 0)
    assert late.judge(seen(10 * round(1e9 * SqueezeSection().hand_silent_s), **missing)).fault is SqueezeFault.NONE
    supervisor = SqueezeSupervisor(SqueezeSection(), (0, 2), 0)
    for period in range(1, 50):
        verdict = supervisor.judge(seen(period * PERIOD_NS, **missing))
        if verdict.fault is not SqueezeFault.NONE:
            break
    assert verdict.fault is fault
    assert verdict.time_ns <= 0.4e9


@pytest.mark.parametrize(("silent_s", "stopped_s"), [(0.2, 0.22), (0.8, 0.82)])
def test_the_rig_file_says_how_long_the_hand_may_be_silent(silent_s: float, stopped_s: float) -> None:
    supervisor = SqueezeSupervisor(SqueezeSection(hand_silent_s=silent_s), (0, 2), 0)
    period = 0
    while supervisor.verdict.fault is SqueezeFault.NONE:
        period += 1
        supervisor.judge(seen(period * PERIOD_NS, hand_ns=(), position_deg=()))
    assert supervisor.verdict.time_ns == round(1e9 * stopped_s)


def test_the_first_fault_stays(supervisor: SqueezeSupervisor) -> None:
    supervisor.stop(SqueezeFault.ASKED, "Ctrl-C", 5)
    verdict = supervisor.judge(seen(PERIOD_NS, peak=4095))
    assert (verdict.fault, verdict.reason, verdict.time_ns) == (SqueezeFault.ASKED, "Ctrl-C", 5)


def test_a_hand_that_opens_needs_no_arrays_and_may_come_from_the_end_of_its_range() -> None:
    opening = SqueezeSupervisor(SqueezeSection(), (0, 2), 0, closing=False)
    for period in range(1, 50):
        now = seen(period * PERIOD_NS, tactile_ns=(), peak_counts=(), position_deg=(closed_by(106.5),))
        assert opening.judge(now).fault is SqueezeFault.NONE
    closing = SqueezeSupervisor(SqueezeSection(), (0, 2), 0)
    assert closing.judge(seen(PERIOD_NS, 106.5)).fault is SqueezeFault.JOINT_RANGE
