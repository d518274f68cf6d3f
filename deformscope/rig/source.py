"""A rig as a source: its devices opened together, and all their items since the last call, in order of time."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from deformscope.errors import InputError
from deformscope.frames import HealthReport, Item, LinkChange, RawBytes, Stream, host_ns
from deformscope.rig.alarms import SensorAlarms
from deformscope.rig.measured import describe, to_frame
from deformscope_drivers.arm import Arm
from deformscope_drivers.arm.wrench import ArmWrench
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import Device, RawChunk
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import LinkEvent
from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.subscription import Subscription

HEALTH_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class RigMember:
    """device: not yet opened; simulated: a double replaces it; late_ns: calibrated delay, subtracted from its stamps"""

    name: str
    driver: DeviceDriver
    device: Device[Any]
    simulated: bool = False
    late_ns: int = 0


@dataclass(slots=True)
class _Opened:
    """An open device, its queues, and the index of its next frame."""

    member: RigMember
    readings: Subscription[Any]
    raw: Subscription[RawChunk] | None
    events: Subscription[LinkEvent]
    index: int = 0
    failure: str = ""


class RigSource:
    """`with RigSource(members) as source: while ...: items = source.take(0.1)`.

    Every item of a device between opening and closing is given or counted as dropped by its queue.
    raw: give also the bytes of every wire; clock: clock of the devices' stamps
    wait_until: waits until a time of that clock [ns]; None = of the host's clock
    opener: opens the devices; None = they open in parallel, each with a thread (a laboratory does not)
    latest_ns: correction of the stamps of the device with the largest delay; start_ns: start of the session, earlier by
    that; open: no frame is older"""

    def __init__(
        self,
        members: Sequence[RigMember],
        *,
        raw: bool = True,
        clock: Clock = monotonic_ns,
        opener: Callable[[], None] | None = None,
        wait_until: Callable[[int], None] | None = None,
    ) -> None:
        self.start_ns = 0
        self.latest_ns = max((member.late_ns + member.device.delay_ns for member in members), default=0)
        self._clock = clock
        self._opener = opener
        self._wait_until = wait_until
        self._members = tuple(members)
        arms = [member.device for member in members if isinstance(member.device, Arm)]
        for member in members:
            if isinstance(member.device, ArmWrench):
                if len(arms) != 1:
                    raise InputError('one arm, for driver = "arm"', f"{len(arms)}", "the rig file", member.name)
                member.device.attach(arms[0])
        self._raw = raw
        self._alarms: SensorAlarms | None = None
        self._opened: list[_Opened] = []
        self._health_at = 0.0

    def __enter__(self) -> "RigSource":
        """Open all devices side by side; the first that fails closes them all. Raises InputError naming it."""
        self.start_ns = self._clock() - self.latest_ns
        for member in self._members:  # before they open, so that nothing is missed
            device = member.device
            device.late_ns = member.late_ns + device.delay_ns
            raw = device.raw() if self._raw else None
            self._opened.append(_Opened(member, device.readings(), raw, device.events()))
        if self._opener is not None:
            self._opener()
            return self
        failures: dict[str, Exception] = {}

        def open_one(member: RigMember) -> None:
            try:
                member.device.open()
            except Exception as error:
                failures[member.name] = error

        try:
            with ThreadPoolExecutor(max_workers=max(len(self._members), 1)) as pool:
                list(pool.map(open_one, self._members))
        except BaseException:  # Ctrl-C: without an __exit__ to come, nobody else would close them
            self.close()
            raise
        if failures:
            self.close()
            name = next(member.name for member in self._members if member.name in failures)  # not whichever is first
            error = failures[name]
            if not isinstance(error, DeviceError | OSError):
                raise error
            raise InputError.about(error, f"device {name}") from error
        return self

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        self.close()

    def device(self, name: str) -> Device[Any]:
        """One of the devices."""
        return next(member.device for member in self._members if member.name == name)

    @property
    def streams(self) -> tuple[Stream, ...]:
        """Descriptions of every device; only while open."""
        return tuple(
            describe(member.name, member.driver, member.device, simulated=member.simulated) for member in self._members
        )

    @property
    def ended(self) -> bool:
        """Whether no device can give any more items: files at their end, links given up."""
        return bool(self._opened) and all(opened.readings.ended for opened in self._opened)

    @property
    def failures(self) -> dict[str, str]:
        """Devices that ended finally, with the reasons."""
        return {opened.member.name: opened.failure for opened in self._opened if opened.failure}

    def take(self, wait_s: float) -> list[Item]:
        """Wait, then return all items since the last call, in order of time. From time to time they include the health
        of all devices, and notes on stuck or saturated readings, which the health reports as well."""
        if wait_s > 0.0 and self._wait_until is not None:
            self._wait_until(self._clock() + round(wait_s * 1e9))
        elif wait_s > 0.0:
            time.sleep(wait_s)
        items = self.rest()
        now_s = self._clock() / 1e9
        if now_s - self._health_at >= HEALTH_PERIOD_S:
            self._health_at = now_s
            items.append(self.look())
        if self._alarms is None:
            configs = {member.name: getattr(member.device, "config", None) for member in self._members}
            after_s = {name: getattr(config, "stuck_after_s", None) for name, config in configs.items()}
            self._alarms = SensorAlarms(self.streams, after_s)
        items += self._alarms.look(items)
        return sorted(items, key=host_ns)

    def look(self) -> HealthReport:
        """Health of all devices."""
        looks = []
        for member in self._members:
            health = member.device.health()  # copied, so that no later count changes the report
            health = dataclasses.replace(health, refused=dict(health.refused), extra=dict(health.extra))
            if self._alarms is not None:
                health = dataclasses.replace(health, alarms=self._alarms.of(member.name))
            looks.append((member.name, health))
        return HealthReport(self._clock(), tuple(looks))

    def close(self) -> None:
        """Close all devices, even if some of them fail; their last items can still be taken."""
        for opened in self._opened:
            try:
                opened.member.device.close()
            except Exception as error:  # an arm that was not stopped must not pass in silence
                opened.failure = " ".join(str(error).split()) or type(error).__name__

    def rest(self) -> list[Item]:
        """Remaining items of the queues, in order of time, without waiting and without health."""
        items: list[Item] = []
        for opened in self._opened:
            member = opened.member
            for reading in _all(opened.readings, opened):
                items.append(to_frame(member.driver.kind, reading, opened.index, member.name, member.device))
                opened.index += 1
            items += [LinkChange(event, member.name) for event in _all(opened.events, opened)]
            if opened.raw is not None:
                items += [RawBytes(c.host_ns, c.data, c.sent, member.name) for c in _all(opened.raw, opened)]
        return sorted(items, key=host_ns)


def _all(queue: Subscription[Any], opened: _Opened) -> list[Any]:
    """All waiting items; the reason for the device's end follows once there are none."""
    try:
        return queue.take()
    except Exception as error:
        opened.failure = " ".join(str(error).split()) or type(error).__name__
        return []
