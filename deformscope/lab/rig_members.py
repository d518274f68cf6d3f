"""Devices made from a rig file, with doubles where it asks for them."""

import contextlib
from collections.abc import Iterator
from typing import Any

from deformscope.lab.double_device import double_device
from deformscope.rig.rig_file import Rig, RigDevice
from deformscope.rig.source import RigMember
from deformscope.robot.squeeze_setup import SqueezeParts
from deformscope_drivers.device import Device


@contextlib.contextmanager
def members_of(rig: Rig) -> Iterator[tuple[RigMember, ...]]:
    """The rig's devices, not opened; doubles run for those with double = true, until the end of the context.

    Members of a rig; in lab:containers a container is between the doubles."""
    with contextlib.ExitStack() as stack:
        around: dict[str, Device[Any]] = {}
        if rig.name == "lab:containers":
            from deformscope.lab.container_setup import rig_container

            parts = SqueezeParts.of(rig, 0)
            around = stack.enter_context(rig_container(parts, "", "", "lab-0", 0).simulated.devices(parts.around))
        yield tuple(
            RigMember(one.name, one.driver, around[one.name], simulated=True)
            if one.name in around
            else stack.enter_context(member_of(one))
            for one in rig.devices
        )


@contextlib.contextmanager
def member_of(entry: RigDevice) -> Iterator[RigMember]:
    """One device of a rig, not yet opened; its double, if requested, runs until the end of the context.

    Raises InputError if there is no such double."""
    stands_in = double_device(entry.driver.name, entry.config) if entry.double else contextlib.nullcontext(entry.make())
    with stands_in as device:
        yield RigMember(entry.name, entry.driver, device, simulated=entry.double, late_ns=entry.late_ns)
