"""Requirements before the robot moves: a table of checks, each with its requirement and its finding."""

import itertools
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.rig.sections import CalibrationAge
from deformscope.robot.checks import Check, Preflight
from deformscope.robot.description import AS_CAPSULES, LINK_RADIUS_M, RobotDescription
from deformscope.robot.force_alone import ForceAlone
from deformscope.robot.placement import TURNED_RAD, best_joints, follow, towards
from deformscope.robot.readings import ArmSample, ForceSample, RobotObservation
from deformscope.robot.robot import ForceSensor, Robot
from deformscope.robot.touch import TouchPlan
from deformscope_drivers.arm.device import CALL_MS
from deformscope_drivers.arm.kinematics import FloatArray, pose_error
from deformscope_drivers.device import Device
from deformscope_drivers.health import Link

LOOK_PERIODS = 50
"""Control periods that are observed: half a second, with 15 pictures at 30 Hz and 500 forces at 1 kHz. Fewer make rates
and noise uncertain; more make every start wait."""
RATE_SHARE = 0.8
"""Share of the configured rate that must arrive: three of fifteen pictures may be late or lost. Below it the supervisor
would stop the arm for silence now and then; above, a busy computer is refused that would do."""
ZERO_N = 0.6
"""Greatest load in free air [N]: a sensor's possible drift since its tare (no figure of it is published). Larger, a tip
that presses something would be zeroed there; smaller, a sensor that has warmed up is refused."""
NOISE_N = 0.05
"""Greatest deviation of a reading in free air [N]: half of the contact's threshold (`TouchPlan.contact_force_n`). With
a larger limit, noise would count as contact; a smaller one refuses usable sensors."""
STILL_DEG = 0.05
"""Greatest motion of a joint that counts as at rest [deg]: 0.4 mm of a tip half a metre away. With a smaller limit, the
resolution of the reported joints counts as motion; with a larger one, a sensor is tared while a person moves the arm
slowly."""
LATE_MS = 20.0
"""Lateness of the control cycle: two periods of 10 ms, within which the supervisor is to act. Larger, forces grow for
longer before the arm is stopped; smaller, a computer with other work is refused."""
LONGEST_CALL_MS = 4.5
"""Time of a call to the arm: each slot of 10 ms has a velocity to send and the joint angles to read."""
CLOCK_PPM = 1000.0
"""Greatest drift between the clocks of device and host: quartz clocks differ by a tenth of it. Beyond, ticks were lost
or the device's rate is another one than configured, and its times are wrong by 0.6 s in ten minutes."""
HAND_M = 0.005
"""Clearance between parts at the arm's end and a level surface at the tip's greatest depth [m]: for a surface that is
not level, and a description with errors of millimetres. A larger one refuses short sticks; a smaller one lets a gripper
or cable touch the surface around the dent."""
FREE_M = 0.01
"""Least height of the tip over the surface at the start [m]: several times the uncertainty of camera and arm, so that
the force there is that of free air. A larger one only requires that the arm is lifted further."""
WAY_STEPS = 60
"""Number of poses checked on the first path: one every 3 deg of half a turn, 3 cm of a tip half a metre away. Fewer may
miss where it sinks; more take longer."""
SAME_SHARE, COARSE_S = 8.0, 0.08
"""An axis of the force sensor is stuck if it repeats a value this many times longer than in these checks, and for two
readings. An axis that repeated for longer in the checks [s] is exempt: its noise is below a count. In ten minutes of
noise of 1 to 5 counts no repetition is that long, except at 100 Hz; a smaller share stops good sensors, a larger one
detects a stuck axis later."""
FORCE_TURNED = "[tool] R_tip_force"
"""Calibrations that an arm needs if only its force sensor guards it."""
COLLISION_NOISE = 6.0
"""A collision's limit is at least this number of standard deviations of the torques' noise."""
FRESH_S = {"arm": 0.05, "force sensor": 0.02, "camera": 0.1}
"""Greatest age of a reading by device [s], or two of its periods if longer: within the supervisor's limit on silence
(`Limits`), and three periods of a camera at 30 Hz. Larger, a device passes that is stopped for silence at once;
smaller, a busy computer is refused."""


def check(
    robot: Robot,
    plans: Sequence[TouchPlan],
    *,
    calibrated: Mapping[str, bool],
    ages: Mapping[str, CalibrationAge] | None = None,
    lift_m: float = 0.0,
    described: RobotDescription = AS_CAPSULES,
) -> Preflight:
    """Check a robot at rest for half a second, and its planned motion.

    plans: the touches, or those at the corners of the area of possible touches; calibrated: the required calibrations,
    by name, and whether they are done; ages: ages of the calibrations, by name; lift_m: height of the plans above the
    surface; described: shapes of hand and cables. Raises RobotStopped if the supervisor stops. Nothing moves."""
    robot.start()
    seen = [robot.cycle() for _ in range(LOOK_PERIODS)]
    return Preflight(
        (
            *_devices(robot, seen),
            *_force(robot, seen),
            *_arm(robot, seen),
            *_clocks(robot, seen),
            *_pictures(seen),
            *_free(robot, plans, lift_m),
            *(
                Check(f"calibration: {name}", there, "present", "present" if there else "missing")
                for name, there in calibrated.items()
                if name != FORCE_TURNED or robot.force_alone
            ),
            *(
                Check(f"age: {name}", age.young, f"{age.at_most} days at most", f"{age.days} days")
                for name, age in (ages or {}).items()
            ),
            *_hand(robot, plans, described),
            *_plans(robot, plans, lift_m),
        )
    )


def _devices(robot: Robot, seen: Sequence[RobotObservation]) -> Iterator[Check]:
    rates_hz = {"arm": robot.arm.state_hz, "force sensor": float(robot.force.config.rate_hz)}
    if robot.camera is not None:
        rates_hz["camera"] = 1.0 / robot.supervisor.limits.camera_period_s
    devices: dict[str, tuple[Device[Any] | ForceSensor | None, int]] = {
        "arm": (robot.arm, sum(len(one.arms) for one in seen)),
        "force sensor": (robot.force, sum(len(one.forces) for one in seen)),
        "camera": (robot.camera, sum(len(one.pictures) for one in seen)),
    }
    span_s = (seen[-1].now_ns - seen[0].now_ns) / 1e9 * len(seen) / (len(seen) - 1)
    for name, (device, count) in devices.items():
        if device is None:
            continue
        health = device.health()
        age = "never" if health.age_s is None else f"{health.age_s * 1e3:.0f} ms old"
        young_s = max(FRESH_S[name], 2.0 / rates_hz[name] if rates_hz.get(name) else 0.0)
        fresh = device.link is Link.CONNECTED and health.age_s is not None and health.age_s <= young_s
        yield Check(f"{name}: fresh", fresh, f"a reading within {young_s * 1e3:.0f} ms", f"{device.link}, {age}")
        least_hz, hz = RATE_SHARE * rates_hz.get(name, 0.0), count / span_s
        enough = (count + 1) / span_s >= least_hz  # one may have come just before, or after
        yield Check(f"{name}: rate", enough, f"{least_hz:.0f} Hz or more", f"{hz:.0f} Hz")


def _force(robot: Robot, seen: Sequence[RobotObservation]) -> Iterator[Check]:
    samples = [sample for one in seen for sample in one.forces]
    usable = sum(sample.usable for sample in samples)
    well = bool(samples) and usable == len(samples)
    yield Check("force sensor: well", well, "every reading usable", f"{usable} of {len(samples)}")
    refused = seen[-1].refused - seen[0].refused
    yield Check("force sensor: wire", refused == 0, "no damaged frames", f"{refused}")
    if not samples:
        return
    forces_n = np.array([sample.force_n for sample in samples])
    zero_n = float(np.linalg.norm(forces_n.mean(axis=0)))
    tool = robot.placement.tool
    most_n, loudest_n = max(ZERO_N, tool.contact_n), max(NOISE_N, 2.0 * tool.force_noise_n)
    yield Check("force sensor: tare", zero_n < most_n, f"below {most_n:.2g} N in free air", f"{zero_n:.3f} N")
    noise_n = forces_n.std(axis=0)
    known = bool(np.all((noise_n > 0) & (noise_n < loudest_n)))
    came = f"{noise_n.min() * 1e3:.1f} to {noise_n.max() * 1e3:.1f} mN"
    yield Check("force sensor: noise", known, f"above 0 and below {loudest_n * 1e3:.3g} mN", came)
    longest_s = _longest_repeat_s(samples, [one.pattern for one in samples])
    limit_s = robot.supervisor.limits.force_frozen_s
    axes = np.array([one.sensor_n for one in samples]).T.tolist()
    axes_s = np.array([_longest_repeat_s(samples, values) for values in axes])
    same_s = SAME_SHARE * (axes_s + 2.0 / robot.force.config.rate_hz)
    robot.supervisor.axes_frozen_s = np.where(axes_s < COARSE_S, same_s, np.inf)
    wanted = f"no equal readings for {500 * limit_s:.0f} ms"
    yield Check("force sensor: alive", longest_s < 0.5 * limit_s, wanted, f"{longest_s * 1e3:.0f} ms at most")


def _longest_repeat_s(samples: Sequence[ForceSample], values: Sequence[Hashable]) -> float:
    """The longest time [s] over which samples one after the other have the same of the values (n,)."""
    longest_ns = 0
    for _, group in itertools.groupby(zip(values, samples, strict=True), key=lambda one: one[0]):
        times_ns = [sample.time_ns for _, sample in group]
        longest_ns = max(longest_ns, times_ns[-1] - times_ns[0])
    return longest_ns / 1e9


def _arm(robot: Robot, seen: Sequence[RobotObservation]) -> Iterator[Check]:
    states = [state for one in seen for state in one.arms]
    if not states:
        yield Check("arm: still", False, "states", "none")
        return
    if not robot.arm.by_hand:
        yield from _joints(robot, states)
    waiting = max(state.fifo_count for state in states)
    yield Check("arm: FIFO", waiting == 0, "empty", f"{waiting} points")
    stopped = robot.arm.stopped_because
    yield Check("arm: accepts commands", not stopped, "not stopped", stopped or "not stopped")


def _joints(robot: Robot, states: Sequence[ArmSample]) -> Iterator[Check]:
    joints_deg = np.array([state.joints_deg for state in states])
    moved_deg = float(np.ptp(joints_deg, axis=0).max())
    yield Check("arm: still", moved_deg < STILL_DEG, f"joints within {STILL_DEG:g} deg", f"{moved_deg:.3f} deg")
    margin_deg = robot.supervisor.limits.joint_margin_deg
    left_deg = robot.arm.chain.to_limits_deg(joints_deg[-1])
    joint = int(np.argmin(left_deg))
    came = f"joint {joint + 1} {left_deg[joint]:.1f} deg"
    yield Check("arm: joints", left_deg[joint] > margin_deg, f"{margin_deg:g} deg or more inside their ranges", came)
    if robot.clearance is not None:
        links, limits = robot.arm.chain.forward(joints_deg[-1]), robot.supervisor.limits
        table_m, itself_m = robot.clearance.over_table_m(links), robot.clearance.to_itself_m(links)
        wanted = f"elbow and wrist {100 * limits.table_m:g} cm or more above it"
        yield Check("arm: over the table", table_m > limits.table_m, wanted, f"{100 * table_m:.1f} cm")
        wanted = f"{100 * limits.itself_m:g} cm or more between parts that may collide"
        yield Check("arm: clear of itself", itself_m > limits.itself_m, wanted, f"{100 * itself_m:.1f} cm")
        if limits.arm_box is not None:
            inside_m = robot.clearance.in_box_m(links, limits.arm_box)
            yield Check("arm: box", inside_m > 0, "elbow, wrist and stick inside", f"{100 * inside_m:.1f} cm inside")
    yield from _torques(robot, states)
    if (zones := getattr(robot.arm.config, "protection_zones", None)) is not None:  # an arm that did not, did not open
        wanted = "those of the rig file set as it was opened"
        yield Check("arm: protection zones", True, wanted, f"{len(zones)} stored in the arm")
    homed = robot.arm.homed
    yield Check("arm: homed", homed, "since power-on", "it was" if homed else "the arm reports that it was not")
    if (call_ms := robot.arm.health().extra.get(CALL_MS)) is not None:
        wanted = f"a call in less than {LONGEST_CALL_MS:g} ms"
        yield Check("arm: link", call_ms < LONGEST_CALL_MS, wanted, f"{call_ms:.1f} ms")


def _torques(robot: Robot, states: Sequence[ArmSample]) -> Iterator[Check]:
    """That the torques' noise at rest is small against the limit of a collision, where the arm reports torques."""
    limit_nm = robot.supervisor.limits.collision_nm
    torques_nm = [state.torques_nm for state in states if state.torques_nm]
    if limit_nm == 0 or not torques_nm:
        return
    noise_nm = np.array(torques_nm).std(axis=0)
    joint = int(np.argmax(noise_nm))
    most_nm = limit_nm / COLLISION_NOISE
    came = f"{noise_nm[joint]:.2f} Nm (joint {joint + 1})"
    yield Check("arm: joint torques", bool(noise_nm[joint] < most_nm), f"noise below {most_nm:.2g} Nm at rest", came)


def _clocks(robot: Robot, seen: Sequence[RobotObservation]) -> Iterator[Check]:
    times_ms = np.array([state.time_ns for one in seen for state in one.arms]) / 1e6
    if len(times_ms) > 1:  # what happened before, while devices opened, does not matter any more
        late_ms = float(np.percentile(np.diff(times_ms), 95)) - 1e3 / robot.arm.state_hz
        limit_ms = max(LATE_MS, 250.0 * robot.supervisor.limits.arm_silent_s)
        came = f"{max(late_ms, 0.0):.1f} ms (19 of 20 states)"
        yield Check("arm: control period", late_ms < limit_ms, f"less than {limit_ms:g} ms late", came)
    relation = robot.force.health().clock
    if relation is not None and relation.drift_ppm is not None:
        drift_ppm = abs(relation.drift_ppm)
        yield Check("force sensor: clock", drift_ppm < CLOCK_PPM, f"within {CLOCK_PPM:g} ppm", f"{drift_ppm:.0f} ppm")


def _pictures(seen: Sequence[RobotObservation]) -> Iterator[Check]:
    pictures = [picture.pattern for one in seen for picture in one.pictures]
    if not pictures:  # the check of its rate says so
        return
    repeats = sum(a is not None and a == b for a, b in itertools.pairwise(pictures))
    yield Check("camera: alive", repeats == 0, "no two equal pictures in a row", f"{repeats} of {len(pictures)}")


def _free(robot: Robot, plans: Sequence[TouchPlan], lift_m: float) -> Iterator[Check]:
    """That the tip is above the surface: a force during the tare would become the zero."""
    if not plans:
        return
    over_m = robot.placement.center_offset_m
    height_m = float(robot.center_m[2]) - over_m + lift_m - max(float(plan.point_m[2]) for plan in plans)
    came = f"{height_m * 100:.1f} cm"
    yield Check("tip: in free air", height_m > FREE_M, f"{FREE_M * 100:g} cm or more above the surface", came)
    if robot.force_alone:
        way = ForceAlone.of(robot)
        words = way.words(max(plan.max_depth_m for plan in plans))
        yield Check("tip: force at contact", way.contact_n <= way.hard_n, f"{way.hard_n:g} N or less", words)


def _hand(robot: Robot, plans: Sequence[TouchPlan], described: RobotDescription) -> Iterator[Check]:
    """That gripper, mount and cables stay above a level surface while the tip is at its greatest depth."""
    if robot.arm.by_hand or not plans:
        return
    over_m = described.over_tip_m(robot.placement, robot.arm.chain.forward(robot.pose.joints_deg))
    if np.isfinite(over_m):
        left_m = over_m - max(plan.max_depth_m for plan in plans)
        wanted = f"{1000.0 * HAND_M:g} mm or more above the surface around the deepest dent"
        yield Check("hand: above the surface", left_m >= HAND_M, wanted, f"{1e3 * left_m:.0f} mm")


def _first_way(robot: Robot, goal_deg: FloatArray, height_m: float) -> Check:
    """That wrist and tip stay above the surface on the first way, joints turning evenly from here to angles (n,) [deg].

    height_m: z of the surface [m, surface frame]"""
    chain, placement = robot.arm.chain, robot.placement
    here_deg = np.asarray(robot.pose.joints_deg)
    turn_deg = towards(here_deg.tolist(), goal_deg, ~np.isfinite(chain.upper_deg))
    lowest_m = np.inf
    for share in np.linspace(0.0, 1.0, WAY_STEPS):
        frames = chain.forward(here_deg + share * turn_deg)
        tip_m = placement.T_surface_center(frames[-1])[2, 3] - placement.center_offset_m
        wrist_m = [(np.linalg.inv(placement.T_base_surface) @ frame)[2, 3] - LINK_RADIUS_M for frame in frames[-3:]]
        lowest_m = min(lowest_m, float(tip_m), *map(float, wrist_m))
    came = f"{(lowest_m - height_m) * 100:.1f} cm above it at the lowest"
    return Check("arm: first way", lowest_m > height_m, "wrist and tip above the surface all along", came)


def _plans(robot: Robot, plans: Sequence[TouchPlan], lift_m: float) -> Iterator[Check]:
    limits, placement = robot.supervisor.limits, robot.placement
    yield Check("plan: touches", bool(plans), "at least one", f"{len(plans)}")
    forces_n = [max(plan.set_force_n, plan.more_force_n or 0.0) for plan in plans]
    most_n = max(forces_n, default=0.0)
    yield Check("plan: force", most_n < limits.soft_force_n, f"below {limits.soft_force_n:g} N", f"{most_n:g} N")
    ends: list[tuple[FloatArray, FloatArray]] = []
    for plan in plans:
        ends += [(place_m, plan.normal) for place_m in plan.places_m(placement.center_offset_m)]
    if limits.low_m is None or limits.high_m is None:
        yield Check("workspace: box", False, "given", "none")
    else:
        low_m, high_m = np.array(limits.low_m), np.array(limits.high_m)
        places_m = np.array([placement.point_in_base_m(place_m) for place_m, _ in ends]).reshape(-1, 3)
        outside = int(np.count_nonzero(np.any((places_m < low_m) | (places_m > high_m), axis=1)))
        yield Check("workspace: plan inside", outside == 0, "all of it in the box", f"{outside} of {len(ends)} outside")
    if robot.arm.by_hand:  # where a person places it they see themselves
        return
    # the joint angles that it will come there with: those it has, or the best where it first has to turn
    start_deg: npt.ArrayLike | None = robot.pose.joints_deg
    here = placement.T_surface_center(robot.pose.T_base_ee)
    route = [(here[:3, 3], -here[:3, 2])]
    if ends:
        poses = [placement.T_base_ee(*end) for end in ends[:3]]
        if np.linalg.norm(pose_error(robot.pose.T_base_ee, poses[0])[3:]) > TURNED_RAD:
            route, start_deg = [], best_joints(robot.arm.chain, poses)
            if start_deg is not None:
                top_m = max(float(plan.point_m[2]) for plan in plans) - lift_m
                yield _first_way(robot, np.asarray(start_deg), top_m)
    for plan in plans:
        crossing_m, above_m, deepest_m = plan.places_m(placement.center_offset_m)
        route += [(place_m, plan.normal) for place_m in (crossing_m, above_m, deepest_m, crossing_m)]
    far = len(route)
    if start_deg is not None and route:
        centers_m, normals = (np.array(part) for part in zip(*route, strict=True))
        led = follow(robot.arm.chain, placement, centers_m, normals, start_deg=start_deg)
        far = int(np.count_nonzero(~led))
    wanted = "every way, away from joint limits and singularities"
    yield Check("arm: reach", far == 0, wanted, f"{len(route) - far} of {len(route)}")
