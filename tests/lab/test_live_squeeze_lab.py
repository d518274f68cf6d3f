"""The laboratory of squeezes on the host's clock: real transports, real pace."""

import pytest

from deformscope.errors import InputError
from deformscope.frames import DepthFrame, HandFrame, TactileFrame
from deformscope.lab.live_squeeze_lab import CLOSED_DEG, CLOSING_AXES, ContainerCase, LiveSqueezeLab
from deformscope_drivers.sdh.results import Outcome


@pytest.mark.realtime
def test_a_hand_behind_a_terminal_closes_on_a_container_and_all_devices_report() -> None:
    with LiveSqueezeLab(ContainerCase("rice", "box-07", seed=3)) as lab, lab.source() as source:
        lab.hand.set_current_limits(0.3)
        done = lab.hand.move(dict.fromkeys(CLOSING_AXES, CLOSED_DEG), velocity_deg_s=20.0, timeout_s=60.0)
        truth = lab.truth()
        items = source.take(0.3)
    assert done.outcome is Outcome.BLOCKED
    assert done.blocked == CLOSING_AXES
    assert source.start_ns < truth.contact_ns
    assert truth.force_n == pytest.approx([4.3, 4.2], abs=0.5)
    kinds = {type(item) for item in items}
    assert {HandFrame, TactileFrame, DepthFrame} <= kinds
    felt = [item.counts.max() for item in items if isinstance(item, TactileFrame)]
    assert felt[0] < 100 < felt[-1]


def test_what_cannot_stand_there_is_refused_in_this_process() -> None:
    with pytest.raises(InputError, match="sand"), LiveSqueezeLab(ContainerCase("sand")):
        pass
