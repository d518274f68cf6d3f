"""Doubles that replace devices, for a rig file with `double = true`."""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from deformscope.errors import InputError
from deformscope.processes import child_process
from deformscope.rig.driver_table import DRIVERS
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.depth_camera import Realsense, SyntheticDepthCamera
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.doubles import Double
from deformscope_drivers.dsa import DsaDouble
from deformscope_drivers.jaco import Jaco, JacoDouble, JacoState
from deformscope_drivers.kuka import KukaDouble, UdpWire, open_kuka
from deformscope_drivers.kuka.port import free_port
from deformscope_drivers.manual_arm import ManualArm
from deformscope_drivers.optoforce.double import OMD_20_SE_40N, OptoforceDouble, Sensors
from deformscope_drivers.optoforce.protocol import Kind
from deformscope_drivers.sdh.double import Port
from deformscope_drivers.webcam import SyntheticCamera, SyntheticCameraConfig
from deformscope_drivers.wires import LOOPBACK, CanWire, PtyWire, TcpWire, Wire

if TYPE_CHECKING:
    from deformscope_drivers.depth_camera import DepthCameraConfig
    from deformscope_drivers.dsa import DsaConfig
    from deformscope_drivers.jaco import JacoConfig
    from deformscope_drivers.kuka import KukaConfig
    from deformscope_drivers.optoforce import OptoforceConfig
    from deformscope_drivers.sdh import SdhConfig
    from deformscope_drivers.webcam import WebcamConfig
import math
import threading
import time

from deformscope_drivers.jaco.structures import TrajectoryPoint
from deformscope_drivers.sdh.double import SdhDouble

_numbers = itertools.count(1)


@contextlib.contextmanager
def double_device(driver: str, config: object) -> Iterator[Device[Any]]:
    """A device of this driver, not opened, whose other end is a double that runs until the end of the context.

    config: as for the real device; the double has the address in it, and needs neither hardware nor a CAN interface of
    the kernel"""
    if driver in WIRED and config_bus(config):  # python-can's virtual buses are within a process
        with wire_of(driver, config, f"virtual:double-{next(_numbers)}") as wire:
            yield DRIVERS[driver].make(reaching(config, wire.port, is_bus=wire.is_bus))
    elif driver in WIRED:
        with _wire_process(driver, config) as port:
            yield DRIVERS[driver].make(reaching(config, port))
    else:
        with _IN_PROCESS[driver](_of_any_serial(config)) as device:
            yield device


@contextlib.contextmanager
def wire_of(driver: str, config: Any, bus: str) -> Iterator[Wire]:
    """A running double of a byte-stream device, connected by a CAN bus or a socket if the configuration names one, else
    by a pseudo terminal.

    bus: replacement of the CAN bus that the configuration names"""
    double = WIRED[driver](config)
    wire: Wire
    if config_bus(config):
        wire = CanWire(double, bus, receive_id=config.receive_id, send_id=config.send_id, bitrate=config.bitrate)
    elif config.port.startswith("socket:"):
        wire = TcpWire(double)
    else:
        wire = PtyWire(double)
    with wire:
        yield wire


@contextlib.contextmanager
def _wire_process(driver: str, config: object) -> Iterator[str]:
    """The same behind a pseudo terminal or a socket, in a process of its own, as a device does not take this one's time
    either. Yields its port."""
    with child_process(f"double of {driver}", serve, driver, config) as pipe:
        try:
            port: str = pipe.recv()
        except EOFError as error:
            raise InputError(f"a double of {driver} in a process of its own", "one that ended immediately") from error
        yield port


def serve(pipe: Connection, driver: str, config: object) -> None:
    """Send the port of a running double, and run it until the pipe ends."""
    with wire_of(driver, config, "") as wire, contextlib.suppress(EOFError, OSError):
        pipe.send(wire.port)
        pipe.recv()


def reaching(config: object, port: str, *, is_bus: bool = False) -> Any:
    """The configuration with the address of the double at the other end of a wire."""
    links = {"port": port}
    if hasattr(config, "bus"):
        links = {"port": "", "bus": port} if is_bus else {"port": port, "bus": ""}
    return dataclasses.replace(_of_any_serial(config), **links)


def _of_any_serial(config: Any) -> Any:
    """The configuration, for a device with any serial number: a double has its own."""
    return dataclasses.replace(config, serial=type(config)().serial) if hasattr(config, "serial") else config


def config_bus(config: object) -> str:
    """The CAN bus that a configuration names; empty without one."""
    return str(getattr(config, "bus", ""))


# What each double is like ---------------------------------------------------------------------------------------------


def _optoforce(config: "OptoforceConfig") -> Double:
    """Sensors on a stick that presses foam now and then, as many and as sensitive as the rig file says. They begin at
    rest, so that they can be zeroed when they are opened."""
    from deformscope.lab.bench_scene import PRESS_S, loads

    sensitivities = config.sensitivities or (OMD_20_SE_40N,)
    axes = sensitivities[0].axes
    kind = Kind.FOUR_CHANNEL if len(sensitivities) > 1 else Kind.SIX_AXIS if axes == 6 else Kind.THREE_AXIS
    pressed_s = monotonic_ns() / 1e9 - PRESS_S

    def scene(time_s: float) -> tuple[float, ...]:
        return (*loads(time_s - pressed_s), *(0.0,) * (axes - 3))

    return OptoforceDouble(Sensors(kind, scene, sensitivities))


def _dsa(config: "DsaConfig") -> Double:
    return DsaDouble(bytes_per_s=None) if config.port.startswith("socket:") else DsaDouble()


def _sdh(config: "SdhConfig") -> Double:
    return GraspingHand(Port.RS232 if config.checksummed() else Port.CAN)


@contextlib.contextmanager
def _jaco(config: "JacoConfig") -> Iterator[Device[Any]]:
    arm = JacoDouble(config.model or "j2n6s300")
    with moved_by_hand(arm) as let_go:

        class Led(Jaco):
            """Whoever leads it lets go of it before it goes home."""

            def home(self, timeout_s: float = 60.0) -> JacoState:
                let_go()
                return super().home(timeout_s)

        yield Led(config, arm)


@contextlib.contextmanager
def _kuka(config: "KukaConfig") -> Iterator[Device[Any]]:
    port = free_port()
    with UdpWire(KukaDouble(config.model, cycle_s=config.cycle_s, again_s=0.5), port):
        yield open_kuka(dataclasses.replace(config, address=LOOPBACK, port=port, controller=""))


@contextlib.contextmanager
def _webcam(config: "WebcamConfig") -> Iterator[Device[Any]]:
    from deformscope.lab.bench_scene import side

    yield SyntheticCamera(side, SyntheticCameraConfig(rate_hz=config.fps))


@contextlib.contextmanager
def _depth_camera(config: "DepthCameraConfig") -> Iterator[Device[Any]]:
    from deformscope.lab.bench_scene import view

    yield SyntheticDepthCamera(view, SyntheticDepthConfig(rate_hz=config.fps or 30.0))


WIRED: dict[str, Callable[[Any], Double]] = {"optoforce": _optoforce, "dsa": _dsa, "sdh": _sdh}
"""Byte-exact doubles by driver: they work with any wire."""

_IN_PROCESS: dict[str, Callable[[Any], contextlib.AbstractContextManager[Device[Any]]]] = {
    "jaco": _jaco,
    "kuka": _kuka,
    "placed": lambda config: contextlib.nullcontext(ManualArm(config)),
    "webcam": _webcam,
    "depth_camera": _depth_camera,
    "realsense": lambda config: contextlib.nullcontext(
        Realsense(config, library="deformscope_drivers.realsense.double")
    ),
}
"""Doubles behind the driver's own interface."""

CYCLE_S = 0.01
ANGULAR_VELOCITY = 8
SWINGS = ((12.0, 9.0), (8.0, 7.0), (-9.0, 6.0), (6.0, 5.0), (-8.0, 4.0), (14.0, 3.0))
"""For each joint: the greatest rate [deg/s] and the period [s]; each swings to and fro and goes nowhere."""


@contextlib.contextmanager
def moved_by_hand(arm: JacoDouble) -> Iterator[Callable[[], None]]:
    """Swing the arm's joints to and fro until the end of the context, as a joystick would: one point every 10 ms.
    Yields the reason if the motion ended earlier."""
    ended = threading.Event()

    def move() -> None:
        send = arm.function("SendBasicTrajectory")
        start = time.monotonic()
        for cycle in range(1 << 62):
            due = start + cycle * CYCLE_S
            if ended.wait(max(due - time.monotonic(), 0.0)):
                return
            time_s = cycle * CYCLE_S
            point = TrajectoryPoint()
            point.Position.Type = ANGULAR_VELOCITY
            for number, (rate_deg_s, period_s) in enumerate(SWINGS, start=1):
                rate = rate_deg_s * math.cos(2 * math.pi * time_s / period_s)
                setattr(point.Position.Actuators, f"Actuator{number}", rate)
            send(point)

    mover = threading.Thread(target=move, name="operator", daemon=True)
    mover.start()

    def let_go() -> None:
        ended.set()
        mover.join()

    try:
        yield let_go
    finally:
        let_go()


GRASP_PERIOD_NS = 4_000_000_000
OPEN_DEG = (0.0, -30.0, 10.0, -30.0, 10.0, -30.0, 10.0)
CLOSED_DEG = (0.0, 5.0, 40.0, 5.0, 40.0, 5.0, 40.0)
GRASP_DEG_S = 40.0


class GraspingHand(SdhDouble):
    """A hand that another operator closes and opens, every 4 s in turn."""

    def __init__(self, port: Port) -> None:
        super().__init__(port)
        self._turn_ns: int | None = None
        self._closes = True

    def due(self, now_ns: int) -> bytes:
        sent = super().due(now_ns)
        if self._turn_ns is None or now_ns >= self._turn_ns:
            self._turn_ns = now_ns + GRASP_PERIOD_NS
            for axis in range(len(OPEN_DEG)):
                self.motion.power(axis, True)
            self.motion.advance(now_ns)
            self.motion.start(CLOSED_DEG if self._closes else OPEN_DEG, [GRASP_DEG_S] * len(OPEN_DEG))
            self._closes = not self._closes
        return sent
