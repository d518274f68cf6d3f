"""Measurements of a rig's set-up: places where the arm was held, pushes, taps and views of a board.

A person follows each request, frames are recorded for a moment, and the next request follows. Nothing here commands a
robot: the arm is moved by its joystick, by `deformscope arm jog`, or by the laboratory."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, Frame, Item, WrenchFrame
from deformscope.session import Answer, RigExperiment, Step
from deformscope.stages.setup.board import CharucoSpec, SeenBoard, find_board
from deformscope.stages.setup.hand_eye import LEAST_SPREAD_RAD, check_turns, next_pose, turned_about
from deformscope_drivers.arm.kinematics import rotation_from_euler_xyz, transform

FrameT = TypeVar("FrameT", bound=Frame)

HOLD_S = 0.6
"""Time for which the arm is held."""
PUSH_S, REST_S, TAP_S = 1.5, 8.0, 8.0
LOADS = 4
"""Number of times that the known load is applied."""
STILL_M, STILL_DEG = 0.0008, 0.3
"""Greatest motion within that of an arm that is held."""
TRIES = 5
PATIENCE = 400
"""Largest number of steps of 0.05 s without a frame."""


@dataclass(frozen=True, slots=True)
class SetupRequest:
    """A request to a person.

    kind: corner, tilt, push, load, rest, tap or view; number: count within its kind, from 0; words: text for the person
    axis: for a push, the direction of the finger's force on the tip, surface frame; for a load, its force [N]"""

    kind: Literal["corner", "tilt", "push", "load", "rest", "tap", "view"]
    number: int
    words: str
    axis: tuple[float, float, float] | None = None


Assistant = Callable[[SetupRequest], RigExperiment[None]]
"""Carries out requests, while frames continue to come."""


CORNER_WORDS = (
    "the corner of the origin",
    "the corner at the end of the x edge",
    "the corner at the end of the y edge",
    "the far corner",
)
TILT_WORDS = (
    "to the left",
    "to the right",
    "towards you",
    "away from you",
    "half left and towards you",
    "half right and away",
)
PUSHES: tuple[tuple[str, tuple[float, float, float]], ...] = (
    ("along the table's x edge, away from the origin", (1.0, 0.0, 0.0)),
    ("along the table's y edge, away from the origin", (0.0, 1.0, 0.0)),
    ("straight up, from below", (0.0, 0.0, 1.0)),
    ("along the table's x edge, towards the origin", (-1.0, 0.0, 0.0)),
    ("along the table's y edge, towards the origin", (0.0, -1.0, 0.0)),
)


@dataclass(frozen=True, slots=True, eq=False)
class HeldArm:
    """T_base_ee: (4, 4) mean pose; joints_deg: (n,) mean; moved_m, moved_deg: how far it went meanwhile"""

    T_base_ee: FloatArray
    joints_deg: FloatArray
    moved_m: float
    moved_deg: float


def held(frames: Sequence[ArmFrame]) -> HeldArm:
    """Poses of the arm at rest."""
    places = np.array([frame.position_m for frame in frames])
    joints = np.array([frame.joint_deg for frame in frames])
    middle = frames[len(frames) // 2]
    pose = transform(rotation_from_euler_xyz(*map(float, middle.rotation_rad)), places.mean(axis=0))
    moved_m = float(np.linalg.norm(np.ptp(places, axis=0)))
    return HeldArm(np.asarray(pose), joints.mean(axis=0), moved_m, float(np.ptp(joints, axis=0).max()))


def _frames(seconds: float, wanted: dict[str, type[Frame]]) -> RigExperiment[dict[str, list[Frame]]]:
    """The frames of devices, by name, until all of them have given this number of seconds of them."""
    taken: dict[str, list[Frame]] = {name: [] for name in wanted}
    given: Sequence[Item] | Answer | None = yield Step(batch_s=0.05)  # what waited is from before
    for _ in range(PATIENCE):
        given = yield Step(batch_s=0.05)
        _sort(given, wanted, taken)
        if all(_span_s(frames) >= seconds for frames in taken.values()):
            return taken
        if seconds == 0.0 and all(taken.values()):
            return taken
    silent = [name for name, frames in taken.items() if not frames]
    raise InputError(f"frames of {', '.join(wanted)} for {seconds:g} s", f"none of {', '.join(silent) or 'enough'}")


def _sort(given: Sequence[Item] | Answer | None, wanted: dict[str, type[Frame]], taken: dict[str, list[Frame]]) -> None:
    """Append the received items of the requested devices."""
    if given is None or isinstance(given, Answer):
        return
    for item in given:
        if isinstance(item, Frame) and item.device in taken and isinstance(item, wanted[item.device]):
            taken[item.device].append(item)


def _span_s(frames: Sequence[Frame]) -> float:
    return (frames[-1].stamp.host_ns - frames[0].stamp.host_ns) / 1e9 if len(frames) > 1 else -1.0


def _held(operator: Assistant, request: SetupRequest, arm: str, note: Callable[[str], None]) -> RigExperiment[HeldArm]:
    """Pose of the arm, held after a request; requested again while it moves."""
    for _ in range(TRIES):
        yield from operator(request)
        frames = yield from _frames(HOLD_S, {arm: ArmFrame})
        found = held([one for one in frames[arm] if isinstance(one, ArmFrame)])
        if found.moved_m < STILL_M and found.moved_deg < STILL_DEG:
            return found
        note(f"the arm moved by {1e3 * found.moved_m:.1f} mm: again")
    raise InputError("an arm at rest", f"one that moved, {TRIES} times", "let go of the joystick")


def touch_corners(
    operator: Assistant, arm: str, corners: Sequence[int], note: Callable[[str], None]
) -> RigExperiment[FloatArray]:
    """(n, 4, 4) poses of the arm's end with the tip on each corner."""
    poses = []
    for turn, number in enumerate(corners):
        place = f"touch {turn + 1} of {len(corners)}: bring the tip down onto {CORNER_WORDS[number]}"
        words = f"{place}, the stick upright, until it just touches"
        poses.append((yield from _held(operator, SetupRequest("corner", number, words), arm, note)).T_base_ee)
    return np.array(poses)


def tilt_about_tip(operator: Assistant, arm: str, count: int, note: Callable[[str], None]) -> RigExperiment[FloatArray]:
    """(n, 4, 4) poses of the arm's end that turn it about a ball at a fixed place."""
    poses = []
    for number in range(count):
        way = TILT_WORDS[number % len(TILT_WORDS)]
        words = f"tilt {number + 1} of {count}: the ball in its cone, tilt the stick {way} by 20 degrees or more"
        poses.append((yield from _held(operator, SetupRequest("tilt", number, words), arm, note)).T_base_ee)
    return np.array(poses)


@dataclass(frozen=True, slots=True, eq=False)
class ForceReadings:
    """time_s: (n,) from the first; force_n: (n, 3) force in the sensor's axes [N]"""

    time_s: FloatArray
    force_n: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PushedTip:
    """T_base_ee: (4, 4) pose of the arm's end; free: readings in free air

    force_n, axis: (n, 3) for each push, the measured force relative to free air [N], and the force of the finger on the
    tip, surface frame
    tilted: (m, 4, 4) other poses in which it was held in free air; tilted_n: (m, 3) forces in these poses [N]
    load_n: the known load, None = none; loaded_n: (k, 3) forces under the load relative to free air [N]"""

    T_base_ee: FloatArray
    free: ForceReadings
    force_n: FloatArray
    axis: FloatArray
    tilted: FloatArray
    tilted_n: FloatArray
    load_n: float | None = None
    loaded_n: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def push_tip(
    operator: Assistant,
    arm: str,
    wrench: str,
    repeats: int,
    tilts: int,
    note: Callable[[str], None],
    load_n: float | None = None,
) -> RigExperiment[PushedTip]:
    """The sensor's forces in free air, while a finger pushes the tip along the table's axes, under a known load [N],
    and in free air with the stick tilted several times."""
    yield from operator(SetupRequest("rest", 0, "keep the tip free of contact, the stick upright"))
    rest = yield from _frames(REST_S, {wrench: WrenchFrame})
    free = _forces(rest[wrench])
    where = yield from _frames(HOLD_S, {arm: ArmFrame})
    pose = held([one for one in where[arm] if isinstance(one, ArmFrame)]).T_base_ee
    tare_n = free.force_n.mean(axis=0)
    forces_n, axes = [], []
    for number in range(repeats * len(PUSHES)):
        words, axis = PUSHES[number % len(PUSHES)]
        turn = f"push {number + 1} of {repeats * len(PUSHES)}"
        words = f"{turn}: push the tip with a finger {words}, with 2 N or more, and hold"
        request = SetupRequest("push", number, words, axis)
        yield from operator(request)
        frames = yield from _frames(PUSH_S, {wrench: WrenchFrame})
        forces_n.append(np.median(_forces(frames[wrench]).force_n, axis=0) - tare_n)
        axes.append(axis)
        note(f"  {np.linalg.norm(forces_n[-1]):.1f} N")
    loaded: list[FloatArray] = []
    for number in range(LOADS if load_n is not None else 0):
        yield from operator(SetupRequest("rest", 1 + number, "keep the tip free of contact"))
        before_n = _forces((yield from _frames(PUSH_S, {wrench: WrenchFrame}))[wrench]).force_n
        words = (
            f"press the tip down onto a scale until it shows {load_n:g} N ({(load_n or 0.0) / 9.80665:.3f} kg), hold"
        )
        yield from operator(SetupRequest("load", number, words, (0.0, 0.0, load_n or 0.0)))
        under_n = _forces((yield from _frames(PUSH_S, {wrench: WrenchFrame}))[wrench]).force_n
        loaded.append(np.asarray(np.median(under_n, axis=0) - np.median(before_n, axis=0)))
        note(f"  {np.linalg.norm(loaded[-1]):.2f} N")
    weighed = yield from weigh_tool(operator, arm, wrench, tilts, note)
    under = np.array(loaded).reshape(-1, 3)
    both = weighed.T_base_ee, weighed.force_n
    return PushedTip(pose, free, np.array(forces_n), np.array(axes), *both, load_n, under)


@dataclass(frozen=True, slots=True, eq=False)
class WeighedTool:
    """T_base_ee: (n, 4, 4) poses of the arm's end, in free air; force_n, torque_nm: (n, 3) mean readings in them, in
    the sensor's axes [N, N m]; torque_nm: None for a sensor of three axes"""

    T_base_ee: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray | None = None


def weigh_tool(
    operator: Assistant, arm: str, wrench: str, count: int, note: Callable[[str], None]
) -> RigExperiment[WeighedTool]:
    """The sensor's readings with the stick tilted several times, in free air."""
    poses, forces, torques = [], [], []
    for number in range(count):
        words = f"keep the tip free of contact, tilt the stick {TILT_WORDS[number % len(TILT_WORDS)]} by 30 degrees"
        poses.append((yield from _held(operator, SetupRequest("tilt", number, words), arm, note)).T_base_ee)
        frames = (yield from _frames(PUSH_S, {wrench: WrenchFrame}))[wrench]
        forces.append(_forces(frames).force_n.mean(axis=0))
        if all(isinstance(one, WrenchFrame) and one.torque_nm is not None for one in frames):
            torques.append(np.mean([one.torque_nm[0] for one in frames], axis=0))  # type: ignore[union-attr,index]
    torque_nm = np.array(torques) if torques else None
    return WeighedTool(np.array(poses).reshape(-1, 4, 4), np.array(forces).reshape(-1, 3), torque_nm)


def _forces(frames: Sequence[Frame]) -> ForceReadings:
    used = [one for one in frames if isinstance(one, WrenchFrame)]
    time_s = np.array([one.stamp.host_ns for one in used], np.float64) / 1e9
    force_n = np.array([one.force_n[0] for one in used], np.float64)
    if not np.isfinite(force_n).all():
        raise InputError("forces in newtons", "counts alone", "sensitivity of the force sensor, in the rig file")
    return ForceReadings(time_s - time_s[0], force_n)


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """Two signals by the host's clock: x_time_s, x: (n,) of the force; y_time_s, y: (m,) those of the other device"""

    x_time_s: FloatArray
    x: FloatArray
    y_time_s: FloatArray
    y: FloatArray


def tap_tip(operator: Assistant, wrench: str, other: str, kind: type[Frame]) -> RigExperiment[Taps]:
    """Readings of the force sensor and another device during taps on the tip."""
    words = "within the next eight seconds tap the tip from below with a finger, firmly, five times at uneven times"
    wanted: dict[str, type[Frame]] = {wrench: WrenchFrame, other: kind}
    frames: dict[str, list[Frame]] = {name: [] for name in wanted}
    asked = operator(SetupRequest("tap", 0, words))
    with contextlib.suppress(StopIteration):
        step = next(asked)
        while True:  # somebody may tap while they are asked
            given = yield step
            _sort(given, wanted, frames)
            step = asked.send(given)
    more = yield from _frames(TAP_S, wanted)
    for name, some in frames.items():
        some += more[name]
    end_ns = more[wrench][-1].stamp.arrived_ns
    forces, others = ([one for one in frames[name] if end_ns - one.stamp.arrived_ns < 2e9 * TAP_S] for name in wanted)
    return taps_of(forces, others)


def taps_of(forces: Sequence[Frame], others: Sequence[Frame]) -> Taps:
    """Taps from frames of a force sensor and another device, by arrival: their stamps contain an offset that was
    measured before."""
    start_ns = forces[0].stamp.arrived_ns
    x = np.array([np.linalg.norm(one.force_n[0]) for one in forces if isinstance(one, WrenchFrame)])
    times = [np.array([one.stamp.arrived_ns - start_ns for one in some]) / 1e9 for some in (forces, others)]
    return Taps(times[0], x, times[1], moved_signal(others))


def moved_signal(frames: Sequence[Frame]) -> FloatArray:
    """(n,) signal of a tap in a device's frames: an arm's joint torques, or a camera's picture, relative to their usual
    values."""
    if isinstance(frames[0], ArmFrame):
        values = np.array([one.joint_torque_nm for one in frames if isinstance(one, ArmFrame)])
    else:
        values = np.array([_small(one) for one in frames if isinstance(one, ColorFrame | DepthFrame)])
    off = np.asarray(values - np.median(values, axis=0))
    way = np.linalg.svd(off, full_matrices=False)[2][0]  # what moves most, along which every tap goes the same way
    along = off @ way
    return np.asarray(along * np.sign(along[np.argmax(np.abs(along))]))


def _small(frame: ColorFrame | DepthFrame) -> FloatArray:
    image = frame.image if isinstance(frame, ColorFrame) else frame.depth
    return np.asarray(image[::16, ::16], np.float64).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """T_base_ee: (n, 4, 4) pose of the arm's end in each view; seen: the board in each view; size_px: (width,
    height)"""

    T_base_ee: FloatArray
    seen: tuple[SeenBoard, ...]
    size_px: tuple[int, int]


def view_board(
    operator: Assistant, arm: str, camera: str, board: CharucoSpec, count: int, note: Callable[[str], None]
) -> RigExperiment[BoardViews]:
    """The requested number of views of a board that the arm carries, and more until the arm has turned about two axes;
    views without the board do not count."""
    poses: list[FloatArray] = []
    seen: list[SeenBoard] = []
    size_px = (0, 0)
    for number in range(TRIES * count):
        way = "hold the board so that the camera sees all of it" if not poses else next_pose(np.array(poses))[1]
        pose = yield from _held(operator, SetupRequest("view", number, way), arm, note)
        frames = yield from _frames(0.0, {camera: ColorFrame | DepthFrame})  # type: ignore[dict-item]
        frame = frames[camera][-1]
        image = frame.image if isinstance(frame, ColorFrame) else frame.color if isinstance(frame, DepthFrame) else None
        if image is None:
            raise InputError(
                "a camera with colour images", "depth alone", "colour = true, or --measured with touched places"
            )
        image = np.asarray(image, np.uint8)
        found = find_board(image, board)
        if found is None:
            note("  the camera did not find the board in this view")
            continue
        poses.append(pose.T_base_ee)
        seen.append(found)
        size_px = (image.shape[1], image.shape[0])
        note(f"  view {len(seen)} of {count}: {len(found.number)} corners")
        if len(seen) >= count and turned_about(np.array(poses)) >= LEAST_SPREAD_RAD:
            return BoardViews(np.array(poses), tuple(seen), size_px)
        if len(seen) >= count:
            note("  turned about one axis only so far: more views, as the next request says")
    if len(seen) >= count:
        check_turns(np.array(poses))
    raise InputError(f"{count} views of the board", f"{len(seen)}", "more light, the board flat and whole in view")
