"""A simulated container for devices on the host's clock, each with its own thread.

The same doubles as in `squeeze_lab`, behind pseudo terminals, in a child process: a real hand does not wait for this
program's threads either. That process also draws the pictures. Here a call may wait for a motion.

A laboratory of squeezes: a hand with tactile pads around a filled container, and a depth camera, on one clock.

    with SqueezeLab(ContainerCase("rice", "box-07", seed=3)) as lab:
        lab.hand.set_current_limits(0.3)
        lab.hand.move(dict.fromkeys(CLOSING_AXES, CLOSED_DEG), velocity_deg_s=10.0, wait=False)
        lab.wait_until(lab.clock() + 2_000_000_000)
        print(lab.truth())

Hand, pads and camera are the real drivers' devices over doubles in memory that speak the real bytes. Nothing runs by
itself: `wait_until` lets time pass, so that the same run comes every time, and many times faster than real. A motion is
started with `wait=False`; a call that waits for one hand's reading would leave the other devices unread meanwhile.
`lab:containers` is this laboratory.

Frames: the hand is fixed, and its frame is the world's (`deformscope_drivers.sdh.kinematics`: z away from the wrist, x
from finger 2 to finger 0; y is upwards here). A container's frame: origin in the middle of its body, x along the
squeeze, z upwards."""

import contextlib
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab import container_constants as constants
from deformscope.lab.container_constants import PA_PER_COUNT
from deformscope.lab.container_shell import BOX, CYLINDER, ContainerShape
from deformscope.lab.container_view import CAMERA, ContainerView, camera_pose
from deformscope.lab.container_world import LOADED, SQUEEZING, ContainerDraw, ContainerWorld
from deformscope.lab.live_lab import first_message, pass_pictures, until_done
from deformscope.lab.ray_camera import DepthViewConfig
from deformscope.processes import SPAWN, child_process
from deformscope.rig.rig_file import RigDevice
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.robot import sleep_until
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.depth_camera import SyntheticDepthCamera, View
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.dsa import Dsa, DsaConfig, DsaDouble
from deformscope_drivers.dsa.pads import Pad, Part
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.images import Intrinsics
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.sdh import Sdh, SdhConfig
from deformscope_drivers.sdh.double import Port, SdhDouble
from deformscope_drivers.sdh.motion import AMBIENT_C, CYCLE_NS
from deformscope_drivers.wires import PtyWire, reaching

POLL_NS: Final = 5_000_000
OPEN_DEG: Final = (90.0, -17.3, 5.3, -70.0, 0.0, -17.3, 5.3)
"""First pose of the hand: fingers 0 and 2 face each other, upright when they touch a box by closing their proximal
joints alone; the thumb is out of the way."""
CLOSING_AXES: Final = (1, 5)
CLOSED_DEG: Final = 10.0
"""Proximal angle of a command to close: containers stop the fingers before it."""
STILL_DEG_S: Final = 0.2
"""Speed below which a finger's joints count as still."""
NAMES: Final = ("hand", "pads", "camera")


@dataclass(frozen=True, slots=True, eq=False)
class ContainerTruth:
    """The simulated truth, up to now.

    content, container: their names; fill: share of the height; mass_kg: mass of all that is squeezed
    contact_ns: when a finger first pressed the wall; steady_ns: when the pressing joints began to turn less than
    `STILL_DEG_S` until they were opened again, or until now; None without such a time
    T_hand_container, T_hand_camera: (4, 4); force_n, dent_m: (2,) force of finger 0 and finger 2, and the largest
    inward displacement of the wall below each; inward_m: (nodes along s, along z) depth of the wall within the
    undeformed container; its content bulges it even before contact"""

    content: str
    container: str
    fill: float
    mass_kg: float
    contact_ns: int | None
    steady_ns: int | None
    T_hand_container: FloatArray
    T_hand_camera: FloatArray
    force_n: FloatArray
    dent_m: FloatArray
    inward_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ContainerCase:
    """The content of the laboratory.

    container: its name begins with its kind, `box` or `cylinder`; others of a kind have other walls
    seed: seed of grasp, fill, temperatures and noise; session: seed of the room's temperature
    grasp: (4, 4) container to hand as planned, from which the true pose differs a little; None = a random one
    alike: every content has the physics of water, whatever its name"""

    content: str
    container: str = "box-01"
    seed: int = 0
    session: int = 0
    grasp: FloatArray | None = None
    alike: bool = False
    camera: DepthViewConfig = CAMERA


class SqueezedContainer:
    """The world of the doubles: a container between the fingers of a simulated hand, in a camera's view.

    hand, pads: the doubles; shape, world, view: the container's form, the pressed body, the camera"""

    def __init__(self, case: ContainerCase, clock: Clock, port: Port) -> None:
        """clock: that the hand's double runs on; port: the hand's port"""
        if case.content not in constants.CONTENTS:
            raise InputError(f"a content of {', '.join(constants.CONTENTS)}", repr(case.content))
        self.case, self._clock = case, clock
        self.shape, instance = container_of(case.container)
        self.draw = ContainerDraw.draw(self.shape, case.seed, instance, case.session, case.grasp)
        self.world = ContainerWorld(
            self.shape, constants.WATER if case.alike else constants.CONTENTS[case.content], self.draw
        )
        self.view = ContainerView(self.shape, self.world.nodes_m, self.draw.T_hand_container, case.camera)
        self._contact_ns: int | None = None
        self._speeds: list[tuple[int, float]] = []
        self.hand = SdhDouble(port)
        self.hand.place(OPEN_DEG)
        self.hand.press(self)
        drift = 1.0 + constants.PAD_DRIFT_PER_K * self.draw.room_k
        own = np.random.default_rng(0x19)  # the hand is always the same
        self._gain = drift * (1.0 + constants.TEXEL_GAIN_SD * own.standard_normal(self.world.pressure_pa.shape))
        self.pads = DsaDouble(
            scene=self._pressures,
            pa_per_count=constants.PA_PER_COUNT,
            noise_counts=constants.NOISE_COUNTS,
            seed=case.seed,
        )

    def truth(self) -> ContainerTruth:
        """The simulated truth, up to now."""
        # from the end of the pressing backwards, the first cycle of those in which the joints are still
        steady_ns: int | None = None
        pressed = list(self._speeds)
        opened = next((i for i, (_, speed) in enumerate(pressed) if speed < -STILL_DEG_S), len(pressed))
        for at_ns, speed in reversed(pressed[:opened]):
            if abs(speed) >= STILL_DEG_S:
                break
            steady_ns = at_ns
        return ContainerTruth(
            content=self.case.content,
            container=self.case.container,
            fill=self.draw.fill,
            mass_kg=self.world.mass_kg,
            contact_ns=self._contact_ns,
            steady_ns=steady_ns,
            T_hand_container=self.world.T_hand_container,
            T_hand_camera=self.view.T_world_camera,
            force_n=self.world.force_n,
            dent_m=self.world.dent_m,
            inward_m=self.world.inward_m(),
        )

    def seen(self) -> View:
        """The camera's present scene, without the camera's errors."""
        position = np.array([axis.position_deg for axis in self.hand.motion.axes])
        exact = self.view.render(self.world.inward_m(), self.world.T_hand_container, position)
        flat = np.abs(exact.facing) < np.sin(np.radians(self.view.config.grazing_deg))
        return View(np.where(flat, np.nan, exact.depth_m), exact.color)

    def reach_deg(
        self, position_deg: Sequence[float], wanted_deg: Sequence[float], current_a: Sequence[float], step_s: float
    ) -> Sequence[float]:
        """The hand's double presses the container (`deformscope_drivers.sdh.motion.Compliance`)."""
        warm_k = np.array([axis.temperature_c for axis in self.hand.motion.axes]) - AMBIENT_C
        loss = self.draw.gear_loss + constants.GEAR_LOSS_PER_K * (warm_k + self.draw.room_k)
        torque_nm = np.array(constants.TORQUE_NM_PER_A) * current_a * (1.0 - loss)
        before = np.array(position_deg)
        reached = self.world.reach_deg(before, np.array(wanted_deg), torque_nm, step_s)
        now_ns = self._clock() // CYCLE_NS * CYCLE_NS
        if self._contact_ns is None and self.world.force_n.any():
            self._contact_ns = now_ns
        if self._contact_ns is not None:
            turned = (reached - before)[list(LOADED)] / step_s
            self._speeds.append((now_ns, float(turned[np.argmax(np.abs(turned))])))
        return [float(angle) for angle in reached]

    def _pressures(self, _: float) -> list[npt.NDArray[np.float64]]:
        """Pressures (rows, columns) on the six pads [Pa]."""
        pads: list[npt.NDArray[np.float64]] = [
            np.zeros((matrix.cells_y, matrix.cells_x)) for matrix in self.pads.matrices
        ]
        for finger, pressure, gain in zip(SQUEEZING, self.world.pressure_pa, self._gain, strict=True):
            pads[Pad(finger, Part.DISTAL).matrix] = np.asarray(pressure * gain, np.float64)
        return pads


class SqueezeLab:
    """The laboratory with one container in it, closed.

    hand, pads, camera: the real drivers' devices, which `open` opens; simulated: the world behind them"""

    def __init__(self, case: ContainerCase, camera_hz: float = 30.0) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.simulated = self._made(case)
        self.hand = Sdh(
            SdhConfig(port="socket://simulated-hand:23", rate_hz=50.0),
            transport=MemoryTransport(self.simulated.hand, self.clock, "simulated hand"),
            clock=self.clock,
        )
        self.pads = Dsa(
            DsaConfig(port="simulated-pads", calibration=(constants.PA_PER_COUNT,)),
            transport=MemoryTransport(self.simulated.pads, self.clock, "simulated pads"),
            clock=self.clock,
        )
        self.camera = SyntheticDepthCamera(
            lambda _: self.simulated.seen(),
            camera_config(self.simulated.view.intrinsics, camera_hz, case.seed),
            clock=self.clock,
        )

    def _made(self, case: ContainerCase) -> SqueezedContainer:
        """Configuration of the devices."""
        return SqueezedContainer(case, self.clock, Port.TCP)

    @property
    def shape(self) -> ContainerShape:
        """The container's outer form."""
        return self.simulated.shape

    @property
    def view(self) -> ContainerView:
        """The camera's view, without errors."""
        return self.simulated.view

    def open(self) -> None:
        """Open the devices on the laboratory's clock."""
        for device in self._three:
            device.open(own_thread=False)

    def close(self) -> None:
        """Close all devices."""
        with contextlib.ExitStack() as stack:
            for device in self._devices:
                stack.callback(device.close)

    def __enter__(self) -> "SqueezeLab":
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def source(self) -> RigSource:
        """The devices as a source, named as in `NAMES`; entering it opens them."""
        return RigSource(members(*self._three), clock=self.clock, opener=self.open)

    def wait_until(self, until_ns: int) -> None:
        """Let time pass: the hand moves in each of its cycles, and every device is polled at its moments."""
        while (now_ns := self.clock()) < until_ns:
            self.clock.advance_to(min((now_ns // POLL_NS + 1) * POLL_NS, until_ns))
            self.simulated.hand.position_deg(self.clock())
            self._poll(self._three)

    def _poll(self, devices: Iterable[Device[Any]]) -> None:
        for device in devices:
            if device.is_open:
                with contextlib.suppress(DeviceError):  # a link that is lost is reported by its device
                    device.poll(0.0)

    def truth(self) -> ContainerTruth:
        """The simulated truth, up to now."""
        return self.simulated.truth()

    @property
    def _three(self) -> tuple[Device[Any], Device[Any], Device[Any]]:
        return self.hand, self.pads, self.camera

    @property
    def _devices(self) -> tuple[Device[Any], ...]:
        return self._three


def members(hand: Device[Any], pads: Device[Any], camera: Device[Any]) -> list[RigMember]:
    """Simulated devices as members of a rig, named as in `NAMES`."""
    kinds = ("sdh", "dsa", "depth_camera")
    return [
        RigMember(name, DRIVERS[kind], device, simulated=True)
        for name, kind, device in zip(NAMES, kinds, (hand, pads, camera), strict=True)
    ]


def camera_config(intrinsics: Intrinsics, rate_hz: float, seed: int) -> SyntheticDepthConfig:
    """Errors that the camera's double adds to a view."""
    return SyntheticDepthConfig(
        name="simulated camera", rate_hz=rate_hz, missing=0.02, seed=seed, intrinsics=intrinsics
    )


def container_of(name: str) -> tuple[ContainerShape, int]:
    """The form of a container by its name, and the number of its instance. Raises InputError."""
    for kind, shape in (("box", BOX), ("cylinder", CYLINDER)):
        if name.startswith(kind):
            return shape, zlib.crc32(name.encode())
    raise InputError("a container named after its kind, as box-07 or cylinder-02", repr(name))


PICTURES_HZ = 10.0


class LiveSqueezeLab:
    """`with LiveSqueezeLab(case) as lab:` makes its devices, which are not opened; `lab.source()` opens them.

    hand, pads, camera: the real drivers' devices; clock, wait_until: those of the host. `devices` makes the devices of
    a rig file (`deformscope.robot.squeeze_setup.SimulatedContainer`)"""

    runs_itself, opener, clock, wait_until = True, None, staticmethod(monotonic_ns), staticmethod(sleep_until)

    def __init__(self, case: ContainerCase, camera_hz: float = PICTURES_HZ) -> None:
        self.intrinsics, self.camera_hz = case.camera.intrinsics, camera_hz
        self.T_hand_camera = camera_pose(case.camera)
        self._case = case
        self._configs = SdhConfig(), DsaConfig()
        self._over = threading.Event()

    def __enter__(self) -> "LiveSqueezeLab":
        with contextlib.ExitStack() as stack:
            pictures, theirs = SPAWN.Pipe(duplex=False)
            given = self._case, self.camera_hz, theirs
            self._questions = stack.enter_context(child_process("simulated container", _stand, *given))
            theirs.close()
            stack.callback(pictures.close)
            hand_port, pads_port = first_message(self._questions, "container")
            hand, pads = self._configs
            self.hand = Sdh(replace(reaching(hand, hand_port), checksum=None))
            self.pads = Dsa(replace(reaching(pads, pads_port), calibration=(PA_PER_COUNT,)))
            config = camera_config(self.intrinsics, self.camera_hz, self._case.seed)
            self.camera = SyntheticDepthCamera(None, config)
            passing = partial(pass_pictures, pictures, self.camera, self._over.is_set)
            stack.enter_context(until_done("simulated pictures", passing))
            stack.callback(self._over.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def source(self) -> RigSource:
        """The devices as a source, named as in `squeeze_lab.NAMES`; entering it opens them."""
        return RigSource(members(self.hand, self.pads, self.camera))

    @contextlib.contextmanager
    def devices(self, entries: Sequence[RigDevice]) -> Iterator[dict[str, Device[Any]]]:
        """The devices by their names in a rig file, with its settings, not opened; the container is present until the
        end of the context."""
        configs = {entry.driver.name: entry.config for entry in entries}
        self._configs = configs["sdh"], configs["dsa"]
        with self:
            made: dict[str, Device[Any]] = {"hand": self.hand, "tactile": self.pads, "depth": self.camera}
            yield {entry.name: made[entry.driver.kind] for entry in entries}

    def truth(self) -> ContainerTruth:
        """The simulated truth, up to now, on the host's clock. Raises InputError if its process has ended."""
        try:
            self._questions.send(None)
            answer = self._questions.recv()
        except (EOFError, OSError) as error:
            raise InputError("a simulated container that answers", "its process has ended", "run it again") from error
        assert isinstance(answer, ContainerTruth)
        return answer


def _stand(answers: Connection, case: ContainerCase, camera_hz: float, pictures: Connection) -> None:
    """The process: wires with their threads, pictures at their rate, answers, until all callers have ended."""
    try:
        simulated = SqueezedContainer(case, monotonic_ns, Port.RS232)
    except InputError as error:
        answers.send(error)
        return
    with PtyWire(simulated.hand) as hand, PtyWire(simulated.pads) as pads, contextlib.suppress(EOFError, OSError):
        answers.send((hand.port, pads.port))
        due = time.monotonic()
        while True:
            with contextlib.suppress(OSError):  # nobody looks any more
                pictures.send(simulated.seen())
            due = max(due + 1.0 / camera_hz, time.monotonic())
            while (left := due - time.monotonic()) > 0.0:
                if answers.poll(left):
                    answers.recv()
                    answers.send(simulated.truth())
