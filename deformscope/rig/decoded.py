"""Recorded bytes decoded again, with the drivers' own decoders, and compared with the recorded frames."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.frames import ArmFrame, Frame, HealthReport, Item, LinkChange, RawBytes, SessionNote, Stream, host_ns
from deformscope.rig.measured import state_of, to_frame
from deformscope.rig.rig_file import Rig
from deformscope_drivers.arm.wrench import ZERO_READINGS, ArmWrench, ArmWrenchConfig
from deformscope_drivers.device import RAW_DROPPED
from deformscope_drivers.framing import Skipped
from deformscope_drivers.health import Description, Health, Link
from deformscope_drivers.interface import DRIVERS, Redecoder

OWN, MOST_STATES = ("counts", "usable", "overload", "force_n"), 1000
"""Fields of an arm's own force, which are compared; states that wait for its frames."""


@dataclass(frozen=True, slots=True)
class DeviceComparison:
    """How a device's recorded frames compare with its bytes.

    frames: recorded; compared: how many frames were decoded again; left_out: parts without a comparison, and why;
    difference: the first difference, in words; empty = none"""

    device: str
    driver: str
    frames: int
    compared: int
    left_out: str = ""
    difference: str = ""


def compare_with_bytes(rig: Rig | None, streams: Sequence[Stream], items: Iterable[Item]) -> list[DeviceComparison]:
    """Decode every device's recorded bytes again and compare with its recorded frames, to the last bit.

    rig: the rig, None for the laboratory and for frames of others, which have no bytes; items: items of the recording,
    in order of time. Raises InputError where the rig lacks a device that was recorded"""
    configs = {} if rig is None else {entry.name: entry.config for entry in rig.devices}
    missing = [one.device for one in streams if one.driver in DRIVERS and one.device not in configs]
    if missing and rig is not None:
        raise InputError(f"a rig with {missing[0]}, which was recorded", "one without")
    checks = {stream.device: _Check(stream, configs.get(stream.device)) for stream in streams}
    own: dict[str, _OwnCheck] = {}
    for arm in (one for one in streams if one.kind == "arm" and one.device in configs):
        of, chain = configs[arm.device], DRIVERS[arm.driver].chain(configs[arm.device], arm.urdf)
        for one in streams:
            if isinstance(config := configs.get(one.device), ArmWrenchConfig):
                again = ArmWrench(replace(config, rate_hz=of.state_hz))
                own[one.device] = _OwnCheck(one, again, chain, checks[arm.device])
    checks |= own
    for item in items:
        if isinstance(item, HealthReport):
            for name, health in item.devices:
                if name in checks:
                    checks[name].health = health
        elif not isinstance(item, SessionNote) and item.device in checks:
            checks[item.device].take(item)
            for waiting in own.values() if isinstance(item, ArmFrame) else ():
                waiting.take(item)
    return [check.result() for check in checks.values()]


def redecoder_of(stream: Stream, config: object) -> Redecoder | None:
    """What makes readings from a device's bytes. None: its driver exchanges none, or its package is not installed."""
    if config is None or stream.driver not in DRIVERS:
        return None
    driver = DRIVERS[stream.driver]
    config = driver.complete(config) if stream.simulated else config
    said = Description(channels=stream.channels, torques=stream.torques, pads=stream.pads, urdf=stream.urdf)
    return None if driver.redecoder is None else driver.redecoder(config, said, stream.device)


class _Check:
    """One device's bytes and frames, which belong together by their time of arrival. of: devices of which it reads"""

    def __init__(self, stream: Stream, config: object, *of: "_Check") -> None:
        self.health: Health | None = None
        self._stream, self._of = stream, (self, *of)
        self._again = redecoder_of(stream, config)
        self._decoder = None if self._again is None else self._again.begin()
        self._now_ns = 0
        self._recorded: deque[Frame] = deque()
        self._decoded: list[Frame] = []
        self._frames = self._compared = self._pieces = self._skipped = 0
        self._difference = ""
        self._steady = True

    def take(self, item: Frame | RawBytes | LinkChange) -> None:
        if host_ns(item) > self._now_ns:
            self._settle()
            self._now_ns = host_ns(item)
        if isinstance(item, Frame):
            self._frames += 1
            self._recorded.append(item)
        elif self._again is None or self._decoder is None:
            return
        elif isinstance(item, LinkChange):
            if item.event.link is not Link.CONNECTED:
                self._decoder = self._again.begin()
                self._steady &= item.event.link is Link.CLOSED
            elif item.event.reason:
                self._again.resume()
        elif item.sent:
            self._again.send(item.data)
        else:
            self._pieces += 1
            for event in self._decoder.feed(item.data) if self._again.listening else ():
                if isinstance(event, Skipped):
                    self._skipped += event.count
                elif (reading := self._again.measure(event, self._now_ns)) is not None:
                    stream = self._stream
                    self._decoded.append(to_frame(stream.kind, reading, 0, stream.device, self._again.device()))

    def result(self) -> DeviceComparison:
        """The comparison of all that was taken, once nothing more comes."""
        self._settle()
        if self._recorded:  # their bytes never came
            self._now_ns = self._recorded[-1].stamp.arrived_ns
            self._settle()
        stream = self._stream
        left_out = self._again.left_out if self._again else "" if self._compared else "its driver gives no bytes"
        if stream.driver and stream.driver not in DRIVERS:
            left_out = f"no package of driver {stream.driver} is installed"
        elif self._again is not None and not self._pieces:
            left_out = "its bytes were not recorded"
        elif self._again is not None and self.health is not None:
            counted = self.health.skipped_bytes
            # what a lost link cuts off is counted or not, and late answers are counted by another way
            other = self._skipped > counted if self._again.late_answers else self._skipped != counted
            if self._steady and other and not self._difference:
                self._difference = f"{self._skipped} bytes of {stream.device} outside any frame; {counted} were counted"
        known = [one.health for one in self._of if one.health is not None]
        dropped = sum(one.dropped + one.extra.get(RAW_DROPPED, 0) for one in known)
        if dropped and self._difference:
            left_out = f"data after {self._difference}: {dropped:g} readings or pieces of bytes were dropped"
            self._difference = ""
        return DeviceComparison(stream.device, stream.driver, self._frames, self._compared, left_out, self._difference)

    def _settle(self) -> None:
        """Compare the items of one moment. Frames of a device with corrected stamps come before their bytes."""
        recorded, decoded, self._decoded = [], self._decoded, []
        while self._recorded and self._recorded[0].stamp.arrived_ns <= self._now_ns:
            recorded.append(self._recorded.popleft())
        if self._again is None or self._difference or not self._pieces:
            return
        at = f"{self._stream.device} at {self._now_ns} ns"
        for frame, other in zip(recorded, decoded, strict=False):
            self._compared += 1
            if name := _other(frame, other, self._again.compares):
                self._difference = f"another {name} of frame {frame.index} of {at}"
                return
        if len(recorded) > len(decoded):
            self._difference = f"frame {recorded[len(decoded)].index} of {at}, which its bytes do not contain"
        elif len(decoded) > len(recorded) and not self._again.late_answers:
            self._difference = f"a frame in the bytes of {at}, which was not recorded"


class _OwnCheck(_Check):
    """The same for an arm's own force, which comes of the states of the arm. arm: the arm's check"""

    def __init__(self, stream: Stream, own: ArmWrench, chain: Any, arm: _Check) -> None:
        super().__init__(stream, None, arm)
        self._own, self._chain = own, chain
        self._states: deque[ArmFrame] = deque(maxlen=MOST_STATES)

    def take(self, item: Frame | RawBytes | LinkChange) -> None:
        if isinstance(item, ArmFrame):
            self._states.append(item)
        elif isinstance(item, Frame):
            self._frames += 1
            self._recorded.append(item)
        while self._states and self._recorded and not self._difference:
            self._compare(self._states.popleft(), self._recorded[0])

    def _compare(self, state: ArmFrame, frame: Frame) -> None:
        device, before_ns = self._stream.device, frame.stamp.arrived_ns - state.stamp.arrived_ns
        if before_ns:  # nobody read the first states
            missing = f"frame {frame.index} of {device}, before which a frame or a state of the arm is missing"
            self._difference = missing if self._compared or before_ns < 0 else ""
            return
        self._recorded.popleft()
        self._compared += 1
        (reading,) = self._own.readings_of([state_of(state)], self._chain)
        wrong = _other(frame, to_frame("wrench", reading, 0, device, None), OWN)
        if wrong == OWN[-1] and self._compared > ZERO_READINGS:  # unless its zero was taken here: that is not recorded
            wrong = _other(frame, to_frame("wrench", self._own.zeroed(reading), 0, device, None), OWN)
        self._difference = wrong and f"another {wrong} of frame {frame.index} of {device}"


def _other(frame: Frame, again: Frame, names: Sequence[str]) -> str:
    """The first of these fields that differs, stamp before; empty = none."""
    late_ns = frame.stamp.late_ns
    if frame.stamp != (again.stamp if late_ns is None else again.stamp.put_back(late_ns)):
        return "stamp"
    return next((name for name in names if not _same(getattr(frame, name), getattr(again, name))), "")


def _same(one: object, other: object) -> bool:
    """Whether two values are equal to the last bit, where nan equals nan."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.shape != other.shape or one.dtype != other.dtype:
            return False
        return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))
    return bool(one == other)
