"""A simulated table for devices on the host's clock, each with its own thread.

It is the table of a rig file with `double = true` and `[surface] scene`: the code that moves a real arm then moves a
simulated one. The table is simulated in separate processes, because a real one does not wait for this program's
threads. `touch_lab` is the laboratory for studies: its clock is simulated, and its runs are repeatable.

Its scene has a closed form: quick enough for the host's clock, where finite elements would cause delays. It is for
trying robots and rigs, not for studies: linear elasticity on an axis, without finite elements' shapes of a contact."""

import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_CYCLE_NS, ArmContact
from deformscope.lab.arms import arm_in_lab
from deformscope.lab.depth_view import DepthView
from deformscope.lab.randomized_rig import BoardPicture, RandomizedRig
from deformscope.lab.ray_camera import DepthViewConfig
from deformscope.lab.scenes import Scene, built_in
from deformscope.processes import SPAWN, child_process
from deformscope.rig.rig_file import RigDevice
from deformscope.robot.by_hand import Person
from deformscope.robot.description import AS_CAPSULES, RobotDescription, arm_shape
from deformscope.robot.placement import Placement
from deformscope.robot.robot import sleep_until
from deformscope.robot.setup import Truth
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.arm.wrench import ArmWrenchConfig
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.depth_camera import SyntheticDepthCamera, View
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS, ArmBody
from deformscope_drivers.pacing import SENDING, be_prompt
from deformscope_drivers.wires import reaching, wire_for

PARKED_M = 0.18
PICTURES_HZ = 10
CYCLE_S = ARM_CYCLE_NS / 1e9
START_S = 60.0
TOOL_N = 0.6
"""Weight of stick and ball on the sensor of a rig whose geometry is hidden [N]."""
CAMERA = DepthViewConfig(width=320, height=240, azimuth_deg=-90.0)
BLUR_M = 0.012
"""Radius of the foam around a touch that affects it."""
SPOTS = 16
RIGID_N_PER_M = 2e6
NEWTON_STEPS, LEAST_SLOPE = 6, 0.1
"""From above and below the steps converge to the last bit of a force in four; the slope is bounded above 0 in a layer
so thin that the law ends."""


class LayerWorld:
    """A ball on a scene's layers; each place has the mean log modulus of its surroundings.

    A half-space below Hertz's ball (Johnson 1985, eq. 4.22) sinks by its own depth's displacement. The displacement at
    the depth of the table, which does not move, is subtracted (Steinbrenner 1934; on the axis of a point load, Johnson
    1985, eq. 3.18).

    pressed: (3,) place and depth of the ball: x, y, depth [m]"""

    def __init__(self, scene: Scene, radius_m: float) -> None:
        if any(piece.relaxes or piece.keeps or piece.plateau_exponent for piece in scene.pieces):
            raise InputError(
                "foam that neither creeps nor yields, on the host's clock", scene.name, f"explore lab:{scene.name}"
            )
        self.scene = scene
        self._radius_m = radius_m
        angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(SPOTS)
        self._around_m = (
            BLUR_M
            * np.sqrt((np.arange(SPOTS) + 0.5) / SPOTS)[:, None]
            * np.column_stack([np.cos(angle), np.sin(angle)])
        )
        self.pressed: FloatArray = np.zeros(3)

    def press(self, center_m: FloatArray) -> FloatArray:
        """Force (3,) [N] on a ball with this middle (3,) [m], surface frame."""
        scene, center = self.scene, np.asarray(center_m, dtype=np.float64)
        normal = scene.normal(center[:2])
        foot = np.append(center[:2], scene.foam_height_m(center[:2]))
        depth = self._radius_m - float((center - foot) @ normal)
        outside = bool(((center[:2] < 0.0) | (center[:2] > scene.size_m)).any())
        table_n = RIGID_N_PER_M * max(0.0, self._radius_m - float(center[2]))
        if depth <= 0.0 or outside:
            self.pressed = np.array([*center[:2], 0.0])
            return np.array([0.0, 0.0, table_n])
        modulus = float(np.exp(np.log(scene.modulus_pa(center[:2] + self._around_m)).mean()))
        # force over Young's modulus [N/Pa] at a depth: with a = how deep Hertz's ball would be, depth = a - held
        # a^(3/2)
        thickness_m = float(foot[2])
        poisson = self.scene.poisson
        hertz = 4.0 / 3.0 / (1.0 - poisson**2) * np.sqrt(self._radius_m)
        held = hertz * (1.0 + poisson) * (3.0 - 2.0 * poisson) / (2.0 * np.pi * thickness_m)
        alone_m = depth
        for _ in range(NEWTON_STEPS):
            off_m = alone_m - held * alone_m**1.5 - depth
            alone_m -= off_m / max(1.0 - 1.5 * held * np.sqrt(alone_m), LEAST_SLOPE)
        newtons = modulus * float(hertz * alone_m**1.5)
        self.pressed = np.array([*center[:2], depth])
        return np.asarray(newtons * normal + np.array([0.0, 0.0, table_n]))

    def displaced_m(self, places_m: npt.NDArray[np.floating]) -> FloatArray:
        """(n, 3) displacement of the surface at places (n, 2) [m], that of a half-space below Hertz's pressure (Johnson
        1985, eq. 3.42)."""
        middle, depth = self.pressed[:2], float(self.pressed[2])
        moved = np.zeros((len(places_m), 3))
        if depth > 0.0:
            contact = np.sqrt(self._radius_m * depth)
            share = np.linalg.norm(places_m - middle, axis=1) / contact
            inside, out = share <= 1.0, np.maximum(share, 1.0)
            around = ((2.0 - out**2) * np.arcsin(1.0 / out) + np.sqrt(out**2 - 1.0)) / np.pi
            moved[:, 2] = -depth * np.where(inside, 1.0 - 0.5 * share**2, around)
        return moved


@dataclasses.dataclass(frozen=True, slots=True)
class _Table:
    """The processes' description of the table."""

    scene: str
    seed: int
    placement: Placement
    T_surface_camera: npt.NDArray[np.floating] | None
    randomized: RandomizedRig | None = None
    described: RobotDescription = AS_CAPSULES


class _Shared:
    """Values that the processes share, each with one writer.

    wrench: (6,) on the arm's end; center_m: (3,) centre of the tip; pressed: x, y, depth [m] of the dent; max_force_n
    finger_n: (3,) force of a person's finger on the tip, surface frame; board: a person has fixed it to the arm"""

    def __init__(self, T_base_links: FloatArray) -> None:
        self._shape = T_base_links.shape
        self._links = SPAWN.RawArray("d", T_base_links.ravel().tolist())
        self._version = SPAWN.RawValue("Q", 0)
        self.wrench = SPAWN.RawArray("d", 6)
        self.center_m = SPAWN.RawArray("d", 3)
        self.pressed = SPAWN.RawArray("d", 3)
        self.max_force_n = SPAWN.RawValue("d", 0.0)
        self.finger_n = SPAWN.RawArray("d", 3)
        self.board = SPAWN.RawValue("b", 0)
        self._over = SPAWN.RawValue("b", 0)

    @property
    def T_base_links(self) -> FloatArray:
        """(k, 4, 4) where the arm's joints and its end are: never half of one moment and half of another."""
        while True:
            version = self._version.value
            links = np.array(self._links).reshape(self._shape)
            if version % 2 == 0 and version == self._version.value:
                return links

    def put_links(self, T_base_links: FloatArray) -> None:
        """Write the poses of the arm's links, (k, 4, 4) in the base frame [m]; by one writer alone."""
        links = T_base_links.ravel().tolist()  # first: who reads waits for what comes between
        self._version.value += 1
        self._links[:] = links
        self._version.value += 1

    @property
    def over(self) -> bool:
        """Whether the table is to be taken away."""
        return bool(self._over.value)

    def end(self) -> None:
        """Take the table away."""
        self._over.value = 1


class LiveLab:
    """The table, the arm over it, and their state (`robot.setup.SimulatedTable`).

    view: the camera; arm: the simulated arm, and the person who places it"""

    runs_itself, opener, clock, wait_until = True, None, staticmethod(monotonic_ns), staticmethod(sleep_until)

    def __init__(
        self,
        scene: Scene,
        placement: Placement,
        arm: RigDevice,
        *,
        T_surface_camera: npt.NDArray[np.floating] | None = None,
        randomized: RandomizedRig | None = None,
        described: RobotDescription = AS_CAPSULES,
    ) -> None:
        """arm, described: sections [arm] and [shape] of the rig file; T_surface_camera: (4, 4), default where the scene
        is seen well; randomized: where things truly are; None = as placement and T_surface_camera say"""
        if randomized is not None:
            placement, T_surface_camera = randomized.placement, randomized.T_surface_camera
        self.size_m, self.truth = scene.size_m, Truth(scene.regions)
        self._table = _Table(scene.name, scene.seed, placement, T_surface_camera, randomized, described)
        self.arm = arm_in_lab(arm.driver.name, arm.config, placement, start_places_m(scene), seed=scene.seed)
        self.view = DepthView(scene, CAMERA, T_surface_camera)
        self._shared = _Shared(self.arm.body.T_base_links)

    @property
    def person(self) -> Person | None:
        """The person who places the arm; None = an arm with motors."""
        return self.arm.person

    @property
    def T_surface_camera(self) -> FloatArray:
        """(4, 4) pose of the camera [m]."""
        return np.asarray(self.view.T_world_camera, np.float64)

    @property
    def max_force_n(self) -> float:
        """The largest true contact force so far [N]."""
        return float(self._shared.max_force_n.value)

    @property
    def body(self) -> ArmBody:
        """The simulated arm, which a person may move by hand."""
        return self.arm.body

    def push_tip(self, force_n: npt.NDArray[np.floating]) -> None:
        """From now on a finger pushes the tip, (3,) [N] in the surface frame."""
        self._shared.finger_n[:] = [float(value) for value in force_n]

    def show_board(self, there: bool) -> None:
        """Fix the board to the arm's end, or take it off."""
        self._shared.board.value = int(there)

    @contextlib.contextmanager
    def devices(self, entries: Sequence[RigDevice]) -> Iterator[dict[str, Device[Any]]]:
        """Devices of drivers over the doubles, not opened, by name; the table exists until the end of the context."""
        made: dict[str, Device[Any]] = {}
        with contextlib.ExitStack() as stack:
            stack.enter_context(until_done("simulated arm", self._move))
            if self.arm.wire is not None:
                stack.enter_context(self.arm.wire)
            try:
                for entry in entries:
                    made[entry.name] = self._device(entry, stack)
                yield made
            finally:
                self._shared.end()  # before anything waits for threads and processes

    def _device(self, entry: RigDevice, stack: contextlib.ExitStack) -> Device[Any]:
        config = entry.config
        if entry.driver.kind == "arm":
            return self.arm.arm
        if entry.driver.kind == "wrench":
            config, name = entry.driver.complete(config), entry.driver.name
            pipe = stack.enter_context(child_process("simulated table", _feel, self._table, self._shared, name, config))
            port = first_message(pipe, "table")
            return entry.driver.make(reaching(config, port) if port else config)
        rate_hz = float(config.fps or PICTURES_HZ)
        pipe = stack.enter_context(child_process("simulated table", _look, self._table, self._shared, rate_hz))
        synthetic = SyntheticDepthConfig(
            name="simulated table", missing=0.02, seed=self._table.seed, intrinsics=self.view.intrinsics, silence_s=5.0
        )
        camera = SyntheticDepthCamera(None, synthetic)
        first_message(pipe, "table")
        stack.enter_context(
            until_done("simulated pictures", lambda: pass_pictures(pipe, camera, lambda: self._shared.over))
        )
        return camera

    def _move(self) -> None:
        """The table gets the pose of the arm, and the arm its pushes."""
        be_prompt(SENDING)
        shared = self._shared
        while not shared.over:
            shared.put_links(self.arm.body.T_base_links)
            self.arm.body.push(list(shared.wrench))
            time.sleep(0.5 * CYCLE_S)


def start_places_m(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Initial place (3,) of the tip's centre, and its place at a touch below that [m]."""
    parked = np.array([scene.size_m[0] / 2, scene.size_m[1] / 2, PARKED_M])
    return parked, np.array([*parked[:2], scene.thickness_m])


class _RemoteArm:
    """The arm in the table's process."""

    def __init__(self, shared: _Shared) -> None:
        self._shared = shared

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) pose of the arm's end [m]."""
        return np.asarray(self._shared.T_base_links[-1])

    def push(self, wrench: npt.ArrayLike) -> None:
        self._shared.wrench[:] = [float(value) for value in np.asarray(wrench)]


def _goes_on(shared: _Shared, due_s: float) -> bool:
    """Wait until then; whether the table is still in use."""
    time.sleep(max(due_s - time.monotonic(), 0.0))
    return not shared.over


def _feel(pipe: Connection, table: _Table, shared: _Shared, driver: str, config: Any) -> None:
    """The process of the table that is touched, and of the force sensor. driver, config: of the sensor"""
    scene = built_in(table.scene, table.seed)
    world = LayerWorld(scene, table.placement.tool.radius_m)
    contact = ArmContact(world, _RemoteArm(shared), table.placement, monotonic_ns)

    def load(time_s: float) -> FloatArray:
        """(6,) force and torque on the sensor in the tip's frame [N, N m], with its faults where the table has any."""
        load_n = contact.load(time_s) + contact.tool_load_n(TOOL_N if table.randomized is not None else 0.0)
        sensed_n = load_n if table.randomized is None else table.randomized.sensed(load_n, time_s)
        return np.concatenate([sensed_n, np.zeros(3)])

    make, own = DRIVERS[driver].double, isinstance(config, ArmWrenchConfig)
    if make is None and not own:
        raise InputError("a force sensor with a byte-exact double", f"driver {driver} without", where=driver)
    with contextlib.ExitStack() as stack:  # no bus: it would be another process's
        wire = make and stack.enter_context(wire_for(make(config, load), reaching(config, config.port)))
        pipe.send(wire.port if wire is not None else "")
        due = time.monotonic()
        while _goes_on(shared, due):
            contact.finger_n = np.array(shared.finger_n[:])
            contact.feel()
            shared.center_m[:] = [float(value) for value in contact.center_m]
            shared.pressed[:] = [float(value) for value in world.pressed]
            shared.max_force_n.value = contact.max_force_n
            due = max(due + CYCLE_S, time.monotonic())


def _look(pipe: Connection, table: _Table, shared: _Shared, rate_hz: float) -> None:
    """The process of the camera's view."""
    scene = built_in(table.scene, table.seed)
    view = DepthView(scene, CAMERA, table.T_surface_camera)
    world = LayerWorld(scene, table.placement.tool.radius_m)
    board = BoardPicture()
    pipe.send("")
    due = time.monotonic()
    while _goes_on(shared, due):
        world.pressed = np.array(shared.pressed[:])
        moved = world.displaced_m(view.places_m) if world.pressed[2] > 0.0 else None
        center = np.array(shared.center_m[:])
        links = shared.T_base_links
        capsules = arm_shape(table.placement, links, center, description=table.described)
        exact = view.render(moved, capsules, table.described.solids(table.placement, links))
        if table.randomized is not None and shared.board.value:
            T_surface_board = table.placement.T_surface_base @ links[-1] @ table.randomized.T_ee_board
            board.put_into(exact.color, view.intrinsics, np.linalg.inv(view.T_world_camera) @ T_surface_board)
        try:
            pipe.send(View(exact.depth_m, exact.color))
        except OSError:  # nobody looks any more
            return
        due = max(due + 1.0 / rate_hz, time.monotonic())


def first_message(pipe: Connection, what: str) -> Any:
    """First message of a process when it is ready. Raises InputError if it sends none, or an error."""
    with contextlib.suppress(EOFError):
        if pipe.poll(START_S):
            if isinstance(message := pipe.recv(), InputError):
                raise message
            return message
    raise InputError(f"a simulated {what} that starts", "none", "run it again")


def pass_pictures(pipe: Connection, camera: SyntheticDepthCamera, over: Callable[[], bool]) -> None:
    """Pass pictures that another process has drawn to the camera, until the end."""
    while not over():
        try:
            if not pipe.poll(0.1):
                continue
            view: View = pipe.recv()
        except (EOFError, OSError):
            return
        with contextlib.suppress(DeviceError):  # not open yet, or not any more
            camera.push(view)


@contextlib.contextmanager
def until_done(name: str, work: Callable[[], None]) -> Iterator[None]:
    """Run a thread that ends without a request, and join it at the end of the context."""
    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        thread.join()
