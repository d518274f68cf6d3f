"""The laboratory's touch: an arm, a force sensor and a camera around one world, on one clock.

The doubles use the real drivers: the arm's pose presses the world, the world's force goes into the force sensor's scene
and onto the arm. There are no threads: `wait_until` lets time pass, so every run is the same."""

import contextlib
import ctypes
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_CYCLE_NS, ARM_STIFFNESS_N_M, ArmContact, World
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope_drivers.arm.kinematics import FloatArray, damped_joint_rates, jacobian_of
from deformscope_drivers.arm.wrench import ArmWrench, ArmWrenchConfig
from deformscope_drivers.depth_camera import SyntheticDepthCamera
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig, View
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import ArmInLab
from deformscope_drivers.jaco import Jaco, JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.structures import AngularInfo, PositionType, actuator_values
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.optoforce import Optoforce, OptoforceConfig
from deformscope_drivers.optoforce.double import OMD_20_SE_40N, OptoforceDouble, Sensors
from deformscope_drivers.optoforce.protocol import Decoder, Reading, encode

READY_NEAR_DEG = (270.0, 200.0, 100.0, 200.0, 90.0, 90.0)
"""First joint angles of the arm above the table, in the configuration that reaches the whole table."""
READY_M = (0.3, 0.2, 0.2)
POLL_NS = 2_000_000
OWN_ERRORS = 0.1, 0.02
"""Noise of a Jaco's joint torques [Nm], and share of gravity left in them, if its own force is used. Chosen."""


class TouchLab:
    """The doubles of a laboratory, devices for them that are not opened, and their faults.

    arm, force, camera: the real drivers' devices, which `open` opens; body: body of the simulated arm; contact: its
    tip in the world; on_cycle: called once in each of the arm's cycles; call_s: how long a call to the arm takes;
    arm_late_s: time between two runs of the arm's driver, long on a busy host; arm_faults: as in `ArmInLab`"""

    def __init__(
        self,
        world: World,
        clock: SimulatedClock | None = None,
        *,
        tool: Tool | None = None,
        T_base_surface: npt.ArrayLike = T_BASE_SURFACE,
        arm_stiffness_n_m: float = ARM_STIFFNESS_N_M,
        sensed: Callable[[FloatArray, float], npt.NDArray[np.floating]] | None = None,
        view: Callable[[float], View] | None = None,
        camera_config: SyntheticDepthConfig | None = None,
        arm_model: str = "j2n6s300",
        arm_config: JacoConfig | None = None,
        arm: ArmInLab | None = None,
        force_config: OptoforceConfig | None = None,
        start_deg: npt.ArrayLike | None = None,
        seed: int = 0,
        goes_on: bool = False,
        own_wrench: ArmWrenchConfig | None = None,
    ) -> None:
        """arm_stiffness_n_m, goes_on: as in `ArmContact`; own_wrench: the arm's own force in place of the force sensor

        sensed: output of the force sensor for a force on it (3,) [N] at a time [s]; default the same

        arm: any simulated arm, on `clock`, in place of a Jaco with arm_model and arm_config

        start_deg: (n,) first angles of the Jaco; default: the six-joint arm ready above the middle of the table

        view: the camera's view at a time since its opening [s]; None = no camera"""
        self.clock = clock if clock is not None else SimulatedClock()
        self.placement = Placement(np.asarray(T_base_surface, dtype=float), tool if tool is not None else Tool())
        self._jaco: tuple[JacoDouble, Spoiled] | None = None
        if arm is None:
            if start_deg is None:
                ready = self.placement.T_base_ee(READY_M, (0, 0, 1))
                start_deg = CHAINS["j2n6s300"].inverse(ready, READY_NEAR_DEG).joints_deg
            double = JacoDouble(arm_model, self.clock, start_deg=start_deg)
            self._jaco = double, Spoiled(double, self.placement.T_ee_center)
            self._jaco[1].waits = self._call
            config = arm_config if arm_config is not None else JacoConfig(state_hz=100.0)
            arm = ArmInLab(Jaco(config, self.functions, clock=self.clock), double)
        self.arm, self.body, self.arm_faults = arm.arm, arm.body, arm.faults
        self.contact = ArmContact(
            world, self.body, self.placement, self.clock, arm_stiffness_n_m=arm_stiffness_n_m, goes_on=goes_on
        )
        self._sensed = sensed
        sensors = Sensors(scene=self._load, sensitivity=OMD_20_SE_40N, seed=seed)
        self.sensor_double = OptoforceDouble(sensors)
        self.wire = SpoiledWire(self.sensor_double, self.clock, seed)
        self.force: Optoforce | ArmWrench = Optoforce(
            force_config if force_config is not None else OptoforceConfig(sensitivity=OMD_20_SE_40N),
            transport=self.wire,
            clock=self.clock,
        )
        if own_wrench is not None:
            if self._jaco is not None:
                self._jaco[0].blur_torques(*OWN_ERRORS)
            self.force = ArmWrench(own_wrench)
            self.force.attach(self.arm)
        self.camera: SyntheticDepthCamera | None = None
        if view is not None:
            self.camera = SyntheticDepthCamera(view, camera_config, clock=self.clock)
        self._cycle = -1
        self._arm_ns = 0
        self.call_s = self.arm_late_s = 0.0
        self.scheduled: list[tuple[int, Callable[[], None]]] = []
        self.on_cycle: Callable[[], None] | None = None

    @property
    def arm_double(self) -> JacoDouble:
        """The simulated Jaco. Raises InputError where the arm is another."""
        if self._jaco is None:
            raise InputError("the Jaco of the laboratory, for a fault of the arm", self.arm.name, "without --arm")
        return self._jaco[0]

    @property
    def functions(self) -> "Spoiled":
        """Functions of the arm's vendor, which can be disturbed; raises InputError as `arm_double` does."""
        self.arm_double  # noqa: B018
        assert self._jaco is not None
        return self._jaco[1]

    def open(self) -> None:
        """Open the devices on the laboratory's clock, and set the force sensor's zero."""
        if isinstance(self.force, Optoforce):
            self.force.open(own_thread=False)
            self.force.zero()
        self.wait_until((self.clock() // ARM_CYCLE_NS + 1) * ARM_CYCLE_NS)  # its slots are then those of its double
        self.arm.open(own_thread=False)
        if isinstance(self.force, ArmWrench):
            self.force.open(own_thread=False)
            self.force.zero()
        if self.camera is not None:
            self.camera.open(own_thread=False)

    def close(self) -> None:
        """Close all devices. Raises NotStopped, as a real arm's driver does, if the arm does not answer."""
        with contextlib.ExitStack() as stack:
            for device in (self.arm, self.force, self.camera):
                if device is not None:
                    stack.callback(device.close)

    def __enter__(self) -> "TouchLab":
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _call(self) -> None:
        """While the arm is called, time passes for the others."""
        self.wait_until(self.clock() + round(self.call_s * 1e9), arm_waits=False)

    def wait_until(self, until_ns: int, *, arm_waits: bool = True) -> None:
        """Let time pass: every device is polled at its moments; arm_waits: the arm too, as it is not being called."""
        while (now_ns := self.clock()) < until_ns:
            then_ns = min((now_ns // POLL_NS + 1) * POLL_NS, until_ns)
            if self.scheduled and self.scheduled[0][0] <= then_ns:
                moment_ns, action = self.scheduled.pop(0)
                self.clock.advance_to(moment_ns)
                action()
                continue
            self.clock.advance_to(then_ns)
            # once in each of the arm's cycles: the contact at its new pose
            cycle = self.clock() // ARM_CYCLE_NS
            if cycle != self._cycle:
                self._cycle = cycle
                if self.on_cycle is not None:
                    self.on_cycle()
                self.contact.feel()
            if arm_waits and self.clock() >= self._arm_ns and self.arm.is_open:
                every_ns = POLL_NS if self._jaco is None else ARM_CYCLE_NS
                late_ns = round(self.arm_late_s * 1e9)
                self._arm_ns = max((self.clock() // every_ns + 1) * every_ns, self.clock() + late_ns)
                _poll(self.arm)
            for device in (self.force, self.camera):
                if device is not None and device.is_open:
                    _poll(device)

    def _load(self, time_s: float) -> FloatArray:
        """(3,) output of the force sensor for its load [N]."""
        load = self.contact.load(time_s)
        return load if self._sensed is None else np.asarray(self._sensed(load, time_s), np.float64)

    def push_tip(self, force_n: FloatArray) -> None:
        """From now on a finger pushes the tip, (3,) [N] in the surface frame."""
        self.contact.finger_n = force_n

    # Faults ----------------------------------------------------------------------------------------------------------

    def schedule(self, moment_ns: int, action: Callable[[], None]) -> None:
        """Call a function at a time of the clock, between two control periods."""
        self.scheduled.append((moment_ns, action))
        self.scheduled.sort(key=lambda one: one[0])


def _poll(device: Device[Any]) -> None:
    """One round; a lost link reports itself."""
    try:
        device.poll(0.0)
    except DeviceError:
        return


class SpoiledWire(MemoryTransport):
    """A wire from the force sensor that can be spoiled: a share of its bytes, or everything repeated or held back.

    spoiled: probability that a byte is changed; frozen: counts are repeated, in complete frames whose counter advances,
    for all axes or for those that are `stuck`"""

    def __init__(self, double: OptoforceDouble, clock: SimulatedClock, seed: int = 0) -> None:
        super().__init__(double, clock, "simulated force sensor")
        self.spoiled = 0.0
        self.frozen = False
        self.stuck: tuple[int, ...] = (0, 1, 2)
        self._decoder = Decoder()
        self._held: Reading | None = None
        self._random = np.random.default_rng([seed, 0x51])

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        if data and not self.frozen:
            self._held = None
        elif data:
            data = b"".join(
                encode(self._again(event)) for event in self._decoder.feed(data) if isinstance(event, Reading)
            )
        if self.spoiled and data:
            values = np.frombuffer(data, np.uint8).copy()
            hit = self._random.random(len(values)) < self.spoiled
            values[hit] ^= self._random.integers(1, 256, np.count_nonzero(hit), dtype=np.uint8)
            return values.tobytes()
        return data

    def _again(self, reading: Reading) -> Reading:
        """A reading with the counts of the first that froze, in the axes that are stuck."""
        if self._held is None:
            self._held = reading
        held = [
            tuple(old if axis in self.stuck else new for axis, (old, new) in enumerate(zip(*rows, strict=True)))
            for rows in zip(self._held.counts, reading.counts, strict=True)
        ]
        return dataclasses.replace(reading, counts=tuple(held))


class Spoiled:
    """The vendor's functions, whose results and arguments can be changed.

    invalid: poses and joint angles are NaN; frozen: every reading is the one before; waits: called before each call,
    which takes its time; turning_rad_s: (3,) rotation of the arm's end in addition to each point of joint rates, about
    the tip's centre, in the base frame"""

    def __init__(self, arm: JacoDouble, T_ee_center: FloatArray) -> None:
        """T_ee_center: (4, 4) the tip's centre in the frame of the arm's end [m]"""
        self.where = arm.where
        self.invalid = False
        self.frozen = False
        self.waits: Callable[[], None] = lambda: None
        self.turning_rad_s: FloatArray = np.zeros(3)
        self._arm, self._T_ee_center = arm, T_ee_center
        self._last: dict[str, bytes] = {}

    def function(self, name: str) -> Callable[..., int]:
        """See `JacoDouble.function`."""
        asked = self._arm.function(name)

        def called(*arguments: object) -> int:
            self.waits()
            if name == "SendBasicTrajectory" and np.any(self.turning_rad_s):
                self._turn(_structure(arguments[0]))
            code = asked(*arguments)
            if name in ("GetAngularPosition", "GetCartesianPosition") and arguments:
                answer = _structure(arguments[0])
                size = ctypes.sizeof(answer)
                if self.frozen and name in self._last:
                    ctypes.memmove(ctypes.byref(answer), self._last[name], size)
                else:
                    self._last[name] = ctypes.string_at(ctypes.addressof(answer), size)
                if self.invalid:
                    values = (ctypes.c_float * (size // 4)).from_buffer(answer)
                    values[0] = values[1] = math.nan
            return code

        return called

    def _turn(self, point: Any) -> None:
        """Joint rates of a point, with those that turn the arm's end besides."""
        rates_deg_s = actuator_values(point.Position.Actuators, self._arm.chain.joint_count)
        if point.Position.Type != PositionType.ANGULAR_VELOCITY or not any(rates_deg_s):
            return
        links = self._arm.chain.forward(self._arm.joints_deg)
        lever_m = links[-1, :3, :3] @ self._T_ee_center[:3, 3]
        twist = np.concatenate([-np.cross(self.turning_rad_s, lever_m), self.turning_rad_s])
        more_deg_s = np.degrees(damped_joint_rates(jacobian_of(links), twist))
        point.Position.Actuators = AngularInfo(*(np.array(rates_deg_s) + more_deg_s))


def _structure(argument: Any) -> ctypes.Structure:
    """Object of a by-reference argument."""
    structure: ctypes.Structure = getattr(argument, "_obj", argument)
    return structure
