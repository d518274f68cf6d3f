"""An arm places the hand (Thesis ch. 2): the container is found in the depth image, and a grasp within reach is drawn.
The hand is brought there under the same supervisor as for exploring, and withdrawn after the squeeze.

`Placing` has the two halves of an experiment, before and after the squeeze; `PlacingArm` carries out its commands.

In between a container is squeezed, and the features of its content are computed. `squeeze` is an experiment
(`deformscope.session`): it commands a hand, requests the features, and yields them."""

import contextlib
import dataclasses
import datetime
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.squeeze import squeezing_hand
from deformscope.experiments.squeeze.features import SqueezeGeometry, TrialFeatures, trial_features
from deformscope.experiments.squeeze.frames import SqueezeFrames, SqueezeObserver, frame_ns
from deformscope.experiments.squeeze.squeezing_hand import HandWait, SqueezeEnded
from deformscope.experiments.squeeze.tracking import container_model, seen_m
from deformscope.files.squeeze_dataset import TrialEntry, TrialRow
from deformscope.frames import ArmFrame, DepthFrame, HandFrame, SessionNote
from deformscope.rig.source import RigSource
from deformscope.robot import placing as arm_placing
from deformscope.robot.advice import advice, where_it_stands
from deformscope.robot.checks import Check, Preflight
from deformscope.robot.description import link_capsules
from deformscope.robot.fingertip_force import FingertipForce
from deformscope.robot.latch import Action
from deformscope.robot.preflight import check
from deformscope.robot.robot import Robot, RobotStopped, TipVelocity
from deformscope.robot.squeeze_plan import GripShape, RandomGrasp, draw_grasps, hand_capsules
from deformscope.robot.squeeze_setup import SqueezeSetup
from deformscope.robot.supervisor import Fault, SafetyDecision
from deformscope.robot.travel import NotThere
from deformscope.session import Compute, Moment, RigExperiment, Step, ask
from deformscope.solid import moved
from deformscope.stages.see.cloud import Intrinsics, back_project
from deformscope.stages.squeeze.container import outline_px
from deformscope.stages.squeeze.find import MOVED_SD, compare, find_container, matches
from deformscope.stages.squeeze.patch import SIDE_PX, hand_pixels, median_of
from deformscope.stages.squeeze.placement import ContainerFit, ContainerSighting, HandPlacement
from deformscope.stages.squeeze.trial import PHYSICAL, ContentPosterior, SqueezePhase, SqueezeStop
from deformscope.version import __version__
from deformscope_drivers.arms import chains
from deformscope_drivers.errors import DeviceError

LOOK_S, LOOKS = 0.6, 3
"""Time at rest, and number of last images for a median: fewer are noisier."""
ROBOT_MARGIN_M = 0.015
"""Margin around links and fingers that is removed from an image: arms differ by about a centimetre from capsules."""
AREA_M = 0.45
"""Objects on the table further from the middle of its frame are ignored [m]: an arm's foot, other objects."""
BACK_M = 0.03
"""Distance to back away from a contact on the way."""
STUCK_S = 2.0
"""A finger whose arrays repeat the same force for this time, and not 0, is stuck: 22 frames at worst. With a shorter
time, arrays with little noise cause stops; with a longer one, the arm moves for longer with a finger that may be
dead."""
NOT_FOUND, NO_GRASP, CONTAINER = "container not found", "no grasp is reached", "container"
BEGINS_NEAR, NOT_READY = "arm begins too near the container", "checks before motion"
"""Kinds of stops; `CONTAINER` with its change: `container moved`."""
LEAVE_OUT = ("plan", "arm: reach", "force sensor: noise", "force sensor: alive")
"""Rows of the preflight that are left out: those about touches, and about sensors that are never silent, as arrays in
the air may all read 0."""
Name = Callable[[dict[str, FloatArray]], tuple[str, tuple[str, ...], FloatArray]]
"""Names a content from all features by modality: the modalities used, labels, and their probabilities (k,)."""

FEATURES_FAILED = "features not computed"


@dataclass
class Squeezed:
    """The outcome so far, valid however the squeeze ends.

    features: features and events, None if there are none; posterior: a model's classification of its content
    stop, stop_ns: why and when it ended early; untracked: why tracking of the container ended, or empty; placement,
    sightings: placement and sightings of an arm that placed the hand; withdrawal: why the arm stopped on its way back
    """

    features: TrialFeatures | None = None
    posterior: ContentPosterior | None = None
    stop: SqueezeStop | None = None
    stop_ns: int = 0
    placement: HandPlacement | None = None
    sightings: list[ContainerSighting] = field(default_factory=list)
    withdrawal: SqueezeStop | None = None
    untracked: str = ""


def squeeze(
    clock: Callable[[], int],
    observer: SqueezeObserver,
    geometry: SqueezeGeometry,
    found: Squeezed,
    name: Name | None = None,
    permitted: RigExperiment[None] | None = None,
    placed: RigExperiment[None] | None = None,
    withdrawn: RigExperiment[None] | None = None,
) -> RigExperiment[None]:
    """Pre-shape, squeeze once, compute the features; `found` collects the results.

    clock: the devices' clock [ns]; name: function that names the content, None = none
    permitted: steps before the hand may move; placed: steps before the hand closes; withdrawn: called when the hand has
    opened again. The function returns also when the hand must stop: `found.stop` has the reason."""
    frames = observer.frames
    try:
        if permitted is not None:
            yield from permitted
        yield from ask(squeezing_hand.PreShape())
        if placed is not None:
            yield from placed
        if found.placement is not None:
            frames.T_hand_container = found.placement.T_hand_container
        yield from _tracked(observer)  # what tracks has begun
        yield from ask(squeezing_hand.SqueezeOnce())
    except squeezing_hand.SqueezeEnded as ended:
        found.stop, found.stop_ns = ended.stop, ended.time_ns
        stopped = SqueezePhase(f"stopped: {ended.stop.kind}"), ended.stop
        came_to = () if found.placement is None else (found.placement,)
        yield from ask(squeezing_hand.HandWait(squeezing_hand.AFTER_S), (*stopped, *came_to), Moment(ended.time_ns))
        return
    try:
        if withdrawn is not None:
            yield from withdrawn
    except squeezing_hand.SqueezeEnded as ended:  # what was squeezed holds
        found.withdrawal = ended.stop
        came_to = () if found.placement is None else (found.placement,)
        yield Step((ended.stop, *came_to), moment=Moment(ended.time_ns))
    yield from ask(squeezing_hand.HandWait(0.0))  # what the devices gave last is taken in
    yield from _tracked(observer)
    found.untracked, tracked = observer.tracking.failed, tuple(observer.tracking.found)
    try:
        computed: TrialFeatures = yield from ask(Compute(trial_features, (frames, geometry, tracked), "features"))
        posterior = None if name is None else posterior_of(computed, name)
    except Exception as error:
        words = " ".join(str(error).split())
        reason = words if isinstance(error, InputError) else f"{type(error).__name__}: {words}"
        found.stop = SqueezeStop(FEATURES_FAILED, reason, "the recording: deformscope replay", True, True)
        found.stop_ns = clock()
        yield Step((found.stop,), moment=Moment(found.stop_ns))
        return
    found.features, found.posterior = computed, posterior
    for when_ns, results in computed.steps():
        yield Step(results, moment=Moment(when_ns))
    if posterior is not None:
        # once the last answer by touch alone was given, so that this one stays in view
        yield Step((posterior,), moment=Moment(frames.open_ns))


def _tracked(observer: SqueezeObserver) -> RigExperiment[None]:
    """Until all that came is tracked."""
    while (waiting := observer.tracking.waiting) is not None:
        with contextlib.suppress(Exception):  # `failed` then says why
            yield from ask(waiting)  # what is recorded meanwhile is taken in


def posterior_of(computed: TrialFeatures, name: Name) -> ContentPosterior:
    """A model's posterior of the content, by all features."""
    events = computed.events
    modalities, labels, probability = name(computed.modalities)
    return ContentPosterior((events.steady_ns - events.first_ns) / 1e9, modalities, labels, probability, -1)


# A squeeze as a trial of a data set, and as the settings of its recording


def feature_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings of a data set's features: features compare only if their settings are equal."""
    return {"tactile_end": setup.hand.tactile_end, "patch_px": SIDE_PX, "physical": list(PHYSICAL)}


def recorded_settings(setup: SqueezeSetup) -> dict[str, Any]:
    """Settings that a recording needs so that its results can be computed again."""
    recorded = {"names": dataclasses.asdict(setup.names), "rule": dataclasses.asdict(squeezing_hand.rule_of(setup))}
    recorded |= {"squeeze": dataclasses.asdict(setup.squeeze), "features": feature_settings(setup)}
    return {"squeezed": recorded | {"geometry": SqueezeGeometry.of(setup).as_json()}, "simulated": setup.simulated}


def entry_of(setup: SqueezeSetup, content: str, container: str, session: str, seed: int) -> TrialEntry:
    """The trial's entry before it was squeezed."""
    return TrialEntry(
        trial=f"{session}-{container or 'container'}-{seed:05d}",
        content=content,
        container=container,
        container_type=setup.container.kind,
        session=session,
        T_hand_container=tuple(map(float, setup.grasp.T_hand_container.ravel())),
        seed=seed,
        software=f"deformscope {__version__}",
        recorded_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )


def row_of(entry: TrialEntry, features: TrialFeatures | None) -> TrialRow:
    """The entry with its features, if there are any."""
    if features is None:
        return TrialRow(entry)
    return TrialRow(entry, features.modalities, features.series)


@dataclass(frozen=True, slots=True, eq=False)
class CheckArm:
    """A command: run all checks before the arm moves; its answer is a `Preflight`."""

    plan: arm_placing.GraspPlan


@dataclass(frozen=True, slots=True, eq=False)
class Carry:
    """A command: bring the hand to the grasp. preflight: the preflight that passed"""

    plan: arm_placing.GraspPlan
    preflight: Preflight


@dataclass(frozen=True, slots=True, eq=False)
class Withdraw:
    """A command: bring the hand back on the way it came."""

    plan: arm_placing.GraspPlan


class PlacingArm:
    """The arm that carries the hand, over the devices of an open source; commands run in the thread that calls them.

    begin: called with each phase when it begins; cycled: called in every control period; reached: the last phase that
    the arm reached; stands: the arm is at rest, or was never commanded"""

    def __init__(
        self, setup: SqueezeSetup, source: RigSource, begin: Callable[[str], None], cycled: Callable[[], None]
    ) -> None:
        assert setup.placing is not None
        self._setup, self._placing, self._source = setup, setup.placing, source
        self._begin, self._cycled = begin, cycled
        self._made: Robot | None = None
        self._placed: arm_placing.GraspPlan | None = None
        self._off = ""
        self.reached, self.stands = "", True

    def _robot(self, squeezing: bool = False) -> Robot:
        """squeezing: it only looks on"""
        setup, names, device = self._setup, self._setup.names, self._source.device
        return Robot(
            device(names.arm),  # type: ignore[arg-type]
            FingertipForce(device(names.tactile), squeezing=squeezing),  # type: ignore[arg-type]
            self._placing.placement,
            self._placing.limits(setup.squeeze, setup.camera.rate_hz),
            camera=None if squeezing else device(names.camera),
            clock=setup.clock,
            wait_until=setup.wait_until,
            watch=lambda looked, verdict: self._cycled(),
        )

    def do(self, command: object) -> object:
        """Carry a command out. Raises SqueezeEnded, after which the arm is at rest and accepts no further command."""
        try:
            with self._stopping():
                robot = self._made = self._made or self._robot()
                robot.start()
                while not robot.arm_seen:
                    robot.cycle()
                match command:
                    case CheckArm(plan):
                        return self._checked(robot, plan)
                    case Carry(plan, preflight):
                        robot.let_move(preflight)
                        arm_placing.carry(robot, plan, self._entered)
                        self.reached, self._placed = "grasp", plan
                    case Withdraw(plan):
                        robot.cycle()
                        while not robot.seen.arms:  # its last pose may be of before the squeeze
                            robot.cycle()
                        if off := self._off or arm_placing.strayed(robot, plan):
                            raise self._stop("arm was moved", off, Fault.ASKED)
                        self._placed = None
                        arm_placing.withdraw(robot, plan, self._entered)
                        self.reached = "retreat"
                    case _:
                        raise TypeError(f"no command of this robot: {command!r}")
        finally:
            if self._made is not None:
                self._made.rest()
        return None

    @contextlib.contextmanager
    def watched(self) -> Iterator[Callable[[], str]]:
        """Watch the arm during the hand's motion: called in each of the hand's control periods. It yields the reason to
        stop if the arm has left its pose; empty = continue.

        The arm is judged as when it moves, except for the forces of fingers that squeeze. It is not stopped here: the
        hand is stopped first, because stopping an arm that does not answer takes seconds."""
        if self._placed is None:
            yield lambda: ""
            return
        robot, plan = self._robot(squeezing=True), self._placed

        def why() -> str:
            verdict = robot.look_on()
            off = arm_placing.strayed(robot, plan) if robot.seen.arms else ""
            now = off if verdict.action is Action.GO_ON else f"{verdict.fault}: {verdict.reason}"
            self._off = self._off or now
            return now

        try:
            yield why
        finally:
            robot.rest()

    def ask_to_stop(self, reason: str) -> None:
        """Stop on a person's request: the arm is at rest within a control period."""
        if self._made is not None:
            self._made.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        """Erase points that wait in the arm; returns whether the arm received this, or was never commanded. The arm is
        no longer watched."""
        self._placed = None
        self.stands = self._made is None or self._made.halt(reason)
        return self.stands

    def _entered(self, phase: str) -> None:
        self.reached = phase
        self._begin(phase)

    def _checked(self, robot: Robot, plan: arm_placing.GraspPlan) -> Preflight:
        found = check(robot, [], calibrated={}, ages=self._placing.ages)
        robot.supervisor.axes_frozen_s = np.full(3, STUCK_S)
        rows = [
            replace(one, name=one.name.replace("force sensor", "fingers"))
            for one in found.checks
            if not one.name.startswith(LEAVE_OUT)
        ]
        detects = robot.supervisor.sees_collisions
        wanted = "joint torques or motor currents, which collisions are detected by"
        rows.append(Check("arm: collisions", detects, wanted, "reported" if detects else "none"))
        return Preflight((*rows, *arm_placing.plan_checks(plan, robot)))

    @contextlib.contextmanager
    def _stopping(self) -> Iterator[None]:
        try:
            yield
        except RobotStopped as error:
            raise self._stopped_by(error.verdict) from error
        except SqueezeEnded:
            raise
        except (InputError, DeviceError) as error:
            robot = self._made
            if robot is not None and robot.may_move and robot.supervisor.verdict.action is Action.BACK_OFF:
                verdict = robot.supervisor.verdict
                # back along the hand, away from the contact
                self._begin("back off")
                back = -robot.placement.T_surface_center(robot.pose.T_base_ee)[:3, 2] * arm_placing.APPROACH_M_S
                with contextlib.suppress(RobotStopped):
                    for _ in range(round(100 * BACK_M / arm_placing.APPROACH_M_S)):
                        robot.cycle(TipVelocity(back))
                raise self._stopped_by(verdict) from error
            kind = "arm did not come there" if isinstance(error, NotThere) else "arm did not move"
            cause = Fault.LINK if isinstance(error, DeviceError) else Fault.WORKSPACE
            raise self._stop(kind, " ".join(str(error).split()), cause) from error

    def _stopped_by(self, verdict: SafetyDecision) -> SqueezeEnded:
        return self._stop(str(verdict.fault), verdict.reason, verdict.fault, verdict.time_ns)

    def _stop(self, kind: str, reason: str, cause: Fault, time_ns: int | None = None) -> SqueezeEnded:
        self.halt(f"{kind}: {reason}")
        words = advice(cause, hand=True) if self._made is None else where_it_stands(cause, self._made)
        return SqueezeEnded(
            SqueezeStop(kind, reason, words, self.stands, True), self._setup.clock() if time_ns is None else time_ns
        )


# Looking -------------------------------------------------------------------------------------------------------------


def sight(
    images: Sequence[DepthFrame],
    arm: ArmFrame,
    hand: HandFrame,
    geometry: SqueezeGeometry,
    when: str,
    before: ContainerFit | None = None,
    near: bool = False,
) -> ContainerSighting:
    """The container in images of a robot at rest; the robot's points are left out. before: the container's earlier
    pose; near: search only close to it, also where the hand hides a part of the container"""
    camera = geometry.camera
    if camera.focal_px is None or camera.center_px is None or geometry.T_arm_camera is None:
        raise InputError("[camera] focal_px, center_px and T_arm_camera", "none")
    lens = Intrinsics(camera.focal_px, camera.center_px, camera.distortion)
    depth = np.asarray(median_of(seen_m(images)))
    T_base_camera = geometry.T_arm_camera
    assert geometry.T_arm_table is not None
    assert geometry.T_arm_hand is not None
    links = chains()[geometry.arm_model].forward(arm.joint_deg)
    capsules = link_capsules(links, np.eye(4)) + moved(
        hand_capsules(np.asarray(hand.position_deg, np.float64)), links[-1] @ geometry.T_arm_hand
    )
    covered = hand_pixels(depth, lens, moved(capsules, np.linalg.inv(T_base_camera)), ROBOT_MARGIN_M)
    T_table_camera = np.linalg.inv(geometry.T_arm_table) @ T_base_camera
    points = back_project(np.where(covered, np.nan, depth), lens, T_table_camera)
    points = points[np.abs(points[:, :2]).max(axis=1) < AREA_M]
    section, refused = geometry.container, ""
    fit: ContainerFit | None = None
    now: ContainerFit | InputError | None = None
    try:
        now = find_container(points, section.shape, expected=before if near else None)
        fit = now if near else matches(now, section.size_m)
    except InputError as error:
        refused, now = str(error), now or error  # one of another size may be the one that has toppled
    change = None if before is None else compare(before, fit or now)
    edges: FloatArray = np.zeros((0, 2, 2))
    if fit is not None:
        edges = outline_px(container_model(section), lens, np.linalg.inv(T_table_camera) @ fit.T_table_container)
    times = frame_ns(arm), frame_ns(hand)
    index = np.array([one.index for one in images], np.int64)
    return ContainerSighting(images[-1].index, index, *times, when, near, fit, refused, change, edges)


# The experiment ------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Placing:
    """An arm that places the hand, before and after the squeeze.

    grasp: along [m], tilt and turn [deg] that a person chose, None = drawn from the seed; permit: called with the
    preflight before the arm moves; returns whether it waited for a person; arm: as in `PlacingArm`
    found: collects sightings and placement"""

    setup: SqueezeSetup
    frames: SqueezeFrames
    geometry: SqueezeGeometry
    arm: PlacingArm
    seed: int
    found: Squeezed
    permit: Callable[[Preflight], RigExperiment[bool]]
    grasp: RandomGrasp | None = None
    _plan: arm_placing.GraspPlan | None = None

    def before(self) -> RigExperiment[None]:
        """Look, draw, check, carry, look again. Raises SqueezeEnded."""
        first = yield from self._look("before")
        if first.fit is None:
            raise self._ended(NOT_FOUND, first.refused, "the table, and the poses of camera and table")
        placing, grip = self.setup.placing, GripShape.of(self.setup.container, self.setup.squeeze)
        assert placing is not None
        assert self.frames.arm_now is not None
        doubt_m = MOVED_SD * float(first.fit.deviation_m[:2].max()) + self.setup.camera.doubt_m
        obstacle = arm_placing.Obstacle(
            first.fit.T_table_container, first.fit.size_m, doubt_m, first.fit.shape == "cylinder"
        )
        drawn = [self.grasp] if self.grasp else draw_grasps(
            self.setup.container, self.setup.squeeze, self.seed, arm_placing.TRIES
        )  # fmt: skip
        limits = placing.limits(self.setup.squeeze, self.setup.camera.rate_hz)
        start_deg = self.frames.arm_now.joint_deg.tolist()
        try:
            arguments = (placing, limits, grip, start_deg, obstacle, drawn)
            plan: arm_placing.GraspPlan = yield from ask(Compute(arm_placing.choose_grasp, arguments, "placement"))
        except arm_placing.NoGrasp as none:
            yield from self._planned(none, obstacle)
            if none.refused == (arm_placing.BEGINS_AT_IT,):
                raise self._ended(BEGINS_NEAR, str(none), "the arm: move it away by its joystick") from none
            raise self._ended(NO_GRASP, str(none), "the container's place, and the arm's reach") from none
        self._plan = plan
        yield from self._planned(plan, obstacle)
        preflight: Preflight = yield from ask(CheckArm(plan))
        if (yield from self.permit(preflight)):  # somebody may have moved anything meanwhile
            yield from self._still_stands("asked")
            preflight = yield from ask(CheckArm(plan))
        if failed := [one for one in preflight.checks if not one.passed]:
            reason = "; ".join(f"{one.name}: {one.came}, not {one.wanted}" for one in failed)
            raise self._ended(NOT_READY, reason, "; ".join(dict.fromkeys(one.hint for one in failed if one.hint)))
        try:
            yield from ask(Carry(plan, preflight))
        finally:
            self._arrived()
        yield from self._placement_now()
        yield from self._still_stands("placed")

    def after(self) -> RigExperiment[None]:
        """Withdraw, and look once more. Raises SqueezeEnded."""
        if self._plan is None:
            return
        stopped: SqueezeEnded | None = None
        try:
            yield from ask(Withdraw(self._plan))
        except SqueezeEnded as ended:
            stopped = ended
        self._arrived()
        yield from self._placement_now()
        try:
            yield from self._look("after", near=stopped is not None)
        except (InputError, ValueError) as error:  # what was squeezed, and why the arm stopped, count for more
            yield Step(notes=(SessionNote(self.setup.clock(), "stage", f"container not measured: {error}"),))
        if stopped is not None:
            raise stopped

    def _still_stands(self, when: str) -> RigExperiment[None]:
        """Look, and raise SqueezeEnded where the container is not as it was before. The hand that was placed may hide
        it; where the robot has not moved yet, it is to be seen as before."""
        placed = when == "placed"
        change = (yield from self._look(when, near=placed)).change
        if change is not None and (change.changed if placed else change.kind != "stands"):
            cause = "the hand hit it" if placed else "a person moved it"
            raise self._ended(f"{CONTAINER} {change.kind}", change.words, f"the container: {cause}")

    def _look(self, when: str, *, near: bool = False) -> RigExperiment[ContainerSighting]:
        since_ns = self.setup.clock()
        phase = (SqueezePhase("look"),)
        yield from ask(HandWait(LOOK_S), phase, Moment(since_ns))
        images = [one for one in self.frames.depth if frame_ns(one) >= since_ns][-LOOKS:]
        arm, hands = self.frames.arm_now, self.frames.hands
        if not images or arm is None or not hands:
            lacks = "depth image" if not images else "state of arm and hand"
            raise self._ended(NOT_FOUND, f"no {lacks} in {LOOK_S:g} s", "the device that is silent")
        before = self.found.sightings[0].fit if self.found.sightings else None
        arguments = (images, arm, hands[-1], self.geometry, when, before, near)
        sighting: ContainerSighting = yield from ask(Compute(sight, arguments, "sighting"))
        self.found.sightings.append(sighting)
        yield Step((sighting,), moment=Moment(self.setup.clock()))
        return sighting

    def _planned(
        self, found: arm_placing.GraspPlan | arm_placing.NoGrasp, obstacle: arm_placing.Obstacle
    ) -> RigExperiment[None]:
        assert self.setup.placing is not None
        hands = [obstacle.T_table_container @ np.linalg.inv(one.T_hand_container) for one in found.tried]
        at = found.tried[-1]
        self.found.placement = HandPlacement(
            by=self.setup.placing.chain.name,
            seed=self.seed if self.grasp is None else -1,
            along_m=at.along_m,
            tilt_deg=at.tilt_deg,
            turn_deg=at.turn_deg,
            T_table_hand=hands[-1],
            T_hand_container=at.T_hand_container,
            tried=np.array([(one.along_m, one.tilt_deg, one.turn_deg) for one in found.tried]),
            refused=found.refused,
            T_table_hands=np.array(hands),
            path_m=np.zeros((0, 3)) if isinstance(found, arm_placing.NoGrasp) else found.path_m,
            reached="",
        )
        yield from self._placement_now()

    def _arrived(self) -> None:
        if self.found.placement is not None:
            self.found.placement = replace(self.found.placement, reached=self.arm.reached)

    def _placement_now(self) -> RigExperiment[None]:
        yield Step((self.found.placement,), moment=Moment(self.setup.clock()))

    def _ended(self, kind: str, reason: str, advice: str) -> SqueezeEnded:
        stands = self.arm.halt(f"{kind}: {reason}")
        return SqueezeEnded(SqueezeStop(kind, " ".join(reason.split()), advice, stands, True), self.setup.clock())
