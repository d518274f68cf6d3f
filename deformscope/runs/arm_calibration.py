"""`deformscope calibrate arm` and `certify`: touch something known, rigid or of a known modulus, and write the arm's
compliance, or the rig's bias by cause, into the rig file. `calibrate wrench`: touch nothing.

`deformscope calibrate tip`, `place`, `camera`, `force`, `tool` and `time`: measure, solve, write."""

import contextlib
import dataclasses
import datetime
import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.config import ArmConfig, CertifyConfig, WrenchConfig
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import ExplorationStopped
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import FromFrames
from deformscope.experiments.explore.touching_robot import TouchingRobot, touching_robot
from deformscope.experiments.rig import arm_compliance
from deformscope.experiments.rig.rig_calibration import Assistant, SetupRequest
from deformscope.file_io import nearest, read_file, replacing
from deformscope.files.arrays_file import read_arrays
from deformscope.frames import ArmFrame, InputFile
from deformscope.lab.rig_members import member_of
from deformscope.lab.session_errors import LabErrors
from deformscope.log.findings import RigFindings
from deformscope.log.layout import RIG
from deformscope.pictures.messages import counted
from deformscope.pictures.report import Figure, Findings, Table
from deformscope.pictures.setup import compliance_png, off_figure
from deformscope.plain import plain
from deformscope.recording.items import read_found, read_items, read_streams
from deformscope.recording.reader import Replay
from deformscope.rig.measured import state_of
from deformscope.rig.rig_edit import Values, edited, lines_of
from deformscope.rig.rig_file import Rig, Tool, load_rig
from deformscope.rig.source import RigSource
from deformscope.robot.placement import Placement
from deformscope.robot.setup import ROLES, RigParts, only_device, open_rig
from deformscope.rows import from_json, to_json
from deformscope.runs.indentation import curve_files, curves_png, kept_curves, shown_rows
from deformscope.runs.opened_devices import LAB, Opening, setup_of, table_of
from deformscope.runs.replay_result import Different, compare
from deformscope.runs.result import open_recorder, settings_of
from deformscope.runs.skeleton import RunOperator, at_terminal, leave_arm, open_rig_run, permitted
from deformscope.session import RigExperiment, Step, run
from deformscope.session import run as run_session
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.poke.certificate import TOLERANCE, KnownSample, RigBias, certify_rig
from deformscope.stages.poke.contact import Z_90, ArmCompliance
from deformscope.stages.poke.indentation import IndentCurve, IndentSample
from deformscope.stages.poke.tip_law import Ground, Indenter
from deformscope.stages.setup.wrench import PARTS, WrenchWorth, wrench_worth
from deformscope.terminal import Interruption, say, until_interrupted
from deformscope_drivers.arm import Arm, ArmState
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.arm.wrench import ArmWrenchConfig, low_pass_share, pose_terms, reported_n, way_terms
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.subscription import Subscription

if TYPE_CHECKING:
    from deformscope.config import SetupOptions
    from deformscope.lab.randomized_rig import SimulatedHand
    from deformscope.recording.recorder import Recorder

M = TypeVar("M")
Arrays = Mapping[str, npt.NDArray[Any]]
TAPS_S = (0.9, 1.3, 0.7, 1.6, 1.0)
"""Times between the taps of a simulated person: uneven."""


@dataclass(frozen=True, slots=True)
class RigCalibrationResult:
    """Result of a rig calibration.

    kind: place, tip, camera, force, tool or time; values: values for the rig file; rows: names and values of the table;
    figure: how far each measurement is off; found: results for JSON; kept: what its recording has for a replay"""

    kind: str
    values: Values
    rows: tuple[tuple[str, str], ...]
    figure: Figure
    found: Mapping[str, Any] = field(default_factory=dict)
    kept: Sequence[InputFile | Step] = ()

    @property
    def dated(self) -> Values:
        """The values, with the date."""
        section = f"calibrated.{self.kind}"
        return {**self.values, section: {"date": today(), **self.values.get(section, {})}}

    def findings(self, where: str) -> Findings:
        """Table and picture of a calibration. where: the rig's name"""
        return Findings((Table(self.rows, caption=f"{self.kind} of {where}"),), (self.figure,))


def today() -> datetime.date:
    """Today by this computer's clock, in UTC, from which ages are counted."""
    return datetime.datetime.now(tz=datetime.UTC).date()


@dataclass(frozen=True, slots=True)
class Station:
    """The participants. arm, wrench, camera: names of devices, empty if the rig has none; operator: the person, real or
    simulated, who moves things"""

    arm: str
    wrench: str
    camera: str
    operator: Assistant


@dataclass(frozen=True, slots=True)
class SetupTask(Generic[M]):
    """One of the commands that calibrate a set-up.

    kind: its kind; needs: kinds of devices; measure: the experiment; arrays: measurements from a file of arrays; solve:
    its solution; recorded: measurements from a recording"""

    kind: str
    needs: tuple[str, ...]
    measure: Callable[[Station], RigExperiment[M]]
    arrays: Callable[[Arrays], M]
    solve: Callable[[Rig, M], RigCalibrationResult]
    recorded: Callable[[Path], M] | None = None


def set_up(config: "SetupOptions", task: SetupTask[M], recorder: "Recorder") -> RigCalibrationResult:
    """Measure, or read an earlier measurement; solve; write into the rig file unless --no-write is given."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    if config.measured is not None:
        if config.measured.suffix == ".rrd" and task.recorded is not None:
            made = task.recorded(config.measured)
        else:
            expected = "a file of arrays (.npz)"
            made = task.arrays(read_arrays(read_file(config.measured, expected), expected, config.measured))
        found = task.solve(rig, made)
        recorder.write(Step((found.findings(rig.name),)))
    else:
        with until_interrupted() as asked:
            devices, station = _devices(rig, task, asked)
            with open_rig_run(devices, recorder) as opened:
                made = run(opened.source, task.measure(station), recorder)
                found = task.solve(rig, made)
                recorder.write(Step((RigFindings(found.findings(rig.name), tuple(opened.source.streams)),)))
    if config.write:
        write_values(Path(config.rig), found.dated)
    return found


def write_values(path: Path, values: Values) -> None:
    """Write into the rig file; a failure leaves it unchanged."""
    from deformscope.rig.rig_file import parse_rig

    text = edited(path.read_text(encoding="utf-8"), values)
    parse_rig(text, str(path), trusted=True)
    with replacing(path) as file:
        file.write(text.encode())
    say(f"written into {path}: {', '.join(f'[{section}]' for section in values)}")


def written_lines(found: RigCalibrationResult) -> str:
    """New lines of a rig file."""
    return lines_of(found.dated)


# Devices and the person at them ---------------------------------------------------------------------------------------


def _devices(
    rig: Rig, task: SetupTask[Any], asked: Interruption
) -> "tuple[AbstractContextManager[RigSource], Station]":
    """The devices, not opened, and the operator: a person at a terminal, or the laboratory's."""
    if not rig.surface.scene:
        devices = {kind: only_device(rig, kind, "to measure with") for kind in task.needs}
        arm, wrench, camera = (devices[kind].name if kind in devices else "" for kind in ROLES)
        measured = dataclasses.replace(rig, devices=tuple(devices.values()))
        return open_rig(measured, member_of, None, ()), Station(arm, wrench, camera, _at_terminal(asked))
    from deformscope.lab.randomized_rig import SimulatedHand

    parts = RigParts.of(rig)
    table, randomized = table_of(parts)
    assert table is not None
    if randomized is None:
        came = "doubles are at the poses of the file"
        raise InputError(
            "a calibration that is still missing",
            came,
            "hidden = 1 in [surface]: random poses, for calibration",
            rig.name,
        )
    arm, wrench, camera = (entry.name for entry in parts.devices)
    hand = _simulated(SimulatedHand(randomized, table, table.size_m), asked)
    return open_rig(rig, member_of, table, parts.devices), Station(arm, wrench, camera, hand)


def _at_terminal(asked: Interruption) -> Assistant:
    """A person who reads the requests, carries them out, and presses Enter."""
    if not at_terminal():
        raise InputError("a person who follows the requests", "no terminal for questions", "--measured FILE.npz")

    def does(request: SetupRequest) -> RigExperiment[None]:
        say(f"{request.words}; then Enter")
        yield from RunOperator(asked).line("")
        _go_on(asked)

    return does


def _go_on(asked: Interruption) -> None:
    """Raises InputError if a person has requested the end."""
    if asked.is_set():
        raise InputError("an answer to each request", "Ctrl-C: nothing was written", "begin again")


def _simulated(hand: "SimulatedHand", asked: Interruption) -> Assistant:
    """The laboratory's person, who releases and taps while frames pass."""

    def does(request: SetupRequest) -> RigExperiment[None]:
        _go_on(asked)
        does_so = "holds it in its own way" if request.kind == "view" else "does so"
        say(f"{request.words} (a simulated person {does_so})")
        hand.do(request.kind, request.number, request.axis)
        if request.kind == "tap":
            from deformscope.lab.randomized_rig import TAP_S

            for pause_s in TAPS_S:
                yield Step(batch_s=pause_s)
                hand.tap()
                yield Step(batch_s=TAP_S)
                hand.let_go()
        yield Step(batch_s=0.3)

    return does


Recording = AbstractContextManager["Recorder"]
POISSON = (0.48, 0.5)
"""Range of Poisson's ratio of silicones [assumed: nearly incompressible]."""
LEAST_HALF_DEG, MOST_STATES = 2.0, 1 << 20
"""Least half width of a joint's learned range; longest motion, an hour of 290 states a second."""
RING_M, EDGE_RADII, SHALLOW, LEAST_N = 0.06, 4.0, 0.6, 0.17
"""Largest distance of touches from the sample's middle; least distance from its edge, in radii of the contact; force of
every second touch over that of the others; least force of the others: SHALLOW of it is ten times the sensor's noise."""


FREE_LIFT_M, FREE_N, LOOSE_N, INSIDE = 0.03, 5.0, (0.8, 0.6), (0.15, 0.85)
"""`calibrate wrench`: height above the surface, force that would be a contact, deviations of the arm's own force before
they are known, with which even a bad one does not end the motion, and share of the surface's sides above which it
moves."""


def opening_of(config: ArmConfig | WrenchConfig | CertifyConfig) -> Opening:
    """The devices, not opened, and the options of their touches. Raises the errors of `setup_of`."""
    if isinstance(config, WrenchConfig):
        return _in_free_air(config)
    errors: LabErrors | None = LabErrors.uncertified()
    force_n, hold_s = None, 0.5
    if isinstance(config, ArmConfig):
        force_n, hold_s, errors = config.set_force, 0.0, None
    options = ExploreOptions(budget=config.touches, beta_model="none", seed=config.output.seed, hold_s=hold_s)
    return setup_of(config.rig, options, force_n, trusted=config.trust_rig, errors=errors)


def _in_free_air(config: WrenchConfig) -> Opening:
    """The same for `calibrate wrench`, whose touches end above the surface. Raises InputError for a force sensor."""
    options = ExploreOptions(budget=config.places, beta_model="none", lift_m=FREE_LIFT_M, go_on=True)
    options, own = replace(options, seed=config.output.seed), (ArmWrenchConfig(), Tool())
    opening = setup_of(config.rig, options, FREE_N, trusted=config.trust_rig, arm=config.arm, own=own)
    setup = opening.setup
    if not setup.own_wrench:
        raise InputError('a force sensor with driver = "arm"', setup.names[1], "calibrate force", config.rig)
    calibrated = {name: there for name, there in setup.calibrated.items() if not name.startswith("[tool]")}
    loose = replace(setup.placement.tool, force_noise_n=LOOSE_N[0], force_off_n=LOOSE_N[1])
    placement = Placement(setup.placement.T_base_surface, loose)
    return replace(opening, setup=replace(setup, placement=placement, calibrated=calibrated, ages={}))


def touch_known(config: ArmConfig | WrenchConfig | CertifyConfig) -> RigCalibrationResult:
    """`calibrate arm`, `calibrate wrench` or `certify`: check, move, and write what was found. Raises InputError."""
    quiet_warp()
    opening = opening_of(config)
    settings = {**settings_of(config), "rig": "", **opening.settings}  # its file as text, for replay
    recorder = open_recorder(config.output, settings, RIG, real_time=opening.setup.runs_itself)
    if isinstance(config, WrenchConfig):
        return calibrate_wrench(config, opening, recorder)
    opening.setup.check_force(opening.options.set_force_n)
    if isinstance(config, ArmConfig):
        return calibrate_arm(config, opening, recorder)
    return certify(config, opening, recorder)


def calibrate_arm(config: ArmConfig, opening: Opening, recording: Recording) -> RigCalibrationResult:
    """Touch a rigid block several times, and write the compliance into the rig file unless --no-write is given."""
    setup, options = opening.setup, opening.options
    xy_m = np.array(config.at) if config.at is not None else 0.5 * np.array(setup.size_m)
    if not ((xy_m > 0.0) & (xy_m < setup.size_m)).all():
        width, height = setup.size_m
        came = f"{xy_m[0]:g},{xy_m[1]:g}"
        raise InputError(f"--at on the surface: between 0,0 and {width:g},{height:g} m", came)
    made: list[arm_compliance.ComplianceTouch] = []

    def touched(measured: TouchMeasurement, height_m: float) -> str:
        made.append(arm_compliance.touched_rigid(measured, height_m, options))
        give = 1e3 * made[-1].found.compliance_m_per_n
        return f"touch {len(made)}: {give:.3f} mm/N, pressed with {made[-1].peak_force_n:.2f} N"

    def result() -> RigCalibrationResult:
        return _compliance(arm_compliance.combine_compliance(made), f"({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm")

    known = {name: there for name, there in setup.calibrated.items() if "compliance" not in name}
    places_m = np.tile(xy_m, (config.touches, 1))
    return _touched_result(config, opening, recording, known, places_m, touched, result)


def calibrate_wrench(config: WrenchConfig, opening: Opening, recording: Recording) -> RigCalibrationResult:
    """Move above the surface, and write what the arm's own force is worth into the rig file unless --no-write is
    given."""
    setup = opening.setup
    columns = -(-config.places // 3)
    x, y = (np.linspace(*INSIDE, count) * side for count, side in zip((columns, 3), setup.size_m, strict=True))
    places_m = np.array([(one, other) for one in x for other in y])[: config.places]
    heard: list[tuple[Arm[Any], Subscription[ArmState]]] = []

    def begun(source: RigSource) -> None:
        arm: Any = source.device(setup.names[0])
        heard.append((arm, arm.readings(MOST_STATES)))

    def touched(measured: TouchMeasurement, height_m: float) -> str:
        made.append(float(np.ptp(measured.force_n @ measured.normal)))
        return f"way {len(made)} of {len(places_m)}: its own force changed by {made[-1]:.2f} N"

    def result() -> RigCalibrationResult:
        ((arm, states),) = heard
        filter_hz = (setup.own_wrench or ArmWrenchConfig()).filter_hz
        return learned_wrench(states.take(), arm.chain, filter_hz, setup.placement.tool, setup.names[1])

    made: list[float] = []
    return _touched_result(config, opening, recording, setup.calibrated, places_m, touched, result, begun=begun)


def learned_wrench(
    states: Sequence[ArmState], chain: Chain, filter_hz: float, tool: Tool, name: str
) -> RigCalibrationResult:
    """What an arm's own force is worth in these states. filter_hz: limit of its low pass; name: its device"""
    joints_deg = np.array([state.joints_deg for state in states])
    middle, half = 0.5 * (joints_deg.max(axis=0) + joints_deg.min(axis=0)), 0.5 * np.ptp(joints_deg, axis=0)
    half = np.maximum(half, LEAST_HALF_DEG)
    force_n, singular = reported_n(states, chain)
    time_s = np.array([state.stamp.host_ns for state in states]) / 1e9
    ways = [np.zeros(len(middle))]
    for turned_deg in np.diff(joints_deg, axis=0):
        ways.append(way_terms(ways[-1], turned_deg))
    terms = pose_terms(joints_deg, middle, half), np.array(ways)
    share = low_pass_share(filter_hz, (len(time_s) - 1) / float(np.ptp(time_s)))
    worth = wrench_worth(time_s - time_s[0], force_n, *terms, singular, share)
    tool = replace(tool, force_noise_n=worth.smooth_n, force_off_n=worth.off_n)
    known = {"force_noise_n": worth.smooth_n, "force_off_n": worth.off_n}
    turned = np.eye(3) if tool.T_ee_tip is None else np.array(tool.T_ee_tip)[:3, :3].T
    values: dict[str, Any] = {
        f"devices.{name}": {
            "driver": "arm",
            "filter_hz": filter_hz,
            "least_singular": worth.least_singular,
            "middle_deg": middle.tolist(),
            "half_deg": half.tolist(),
            "bias_n": worth.bias_n.tolist(),
            "friction_n": worth.friction_n.tolist(),
        },
        "tool": {**known, "R_tip_force": turned.tolist()},
    }
    rows = (
        ("noise", f"{worth.noise_n:.2f} N a report, {worth.smooth_n:.2f} N behind {filter_hz:g} Hz"),
        ("within a touch", f"off by {worth.off_n:.2f} N (one deviation), {worth.raw_off_n:.2f} N without correction"),
        ("friction", f"{np.abs(terms[1] @ worth.friction_n).max():.2f} N at most, by the joints' directions"),
        ("used", f"where the Jacobian's least singular value is {worth.least_singular:.3f} or more"),
        ("zeros", f"{worth.zeros} reports of 0 N, which are left out"),
        ("resolves", f"a set force of {tool.resolved_n:.2f} N or more"),
    )
    names, each = [str(number + 1) for number in range(PARTS)], "part of the motion"
    text = "Own force without contact, as the other parts predict it"
    figure = off_figure(worth.left_n, names, "N", worth.off_n, each=each, caption=text)
    found = {**known, "resolved_n": tool.resolved_n, "raw_off_n": worth.raw_off_n, "zeros": worth.zeros}
    found |= {"least_singular": worth.least_singular}
    during = len(states), states[0].stamp.host_ns, states[-1].stamp.host_ns, filter_hz
    kept = InputFile("states", to_json(during).encode()), Step((worth,))
    return RigCalibrationResult("wrench", values, rows, figure, found, kept)


def _touched_result(
    config: ArmConfig | WrenchConfig | CertifyConfig,
    opening: Opening,
    recording: Recording,
    calibrated: Mapping[str, bool],
    places_m: FloatArray,
    touched: Callable[[TouchMeasurement, float], str],
    result: Callable[[], RigCalibrationResult],
    forces_n: Sequence[float] = (),
    begun: Callable[[RigSource], None] = lambda source: None,
) -> RigCalibrationResult:
    """Check, ask, and touch places (n, 2) [m]; the recorded result. touched: called with each touch and the surface's
    height, and gives a line to print; begun: called before the first; others as in `permitted` and `touch_places`. Ends
    the command after a stop."""
    setup, options = opening.setup, opening.options
    stop: ExplorationStop | None = None
    with until_interrupted() as asked, recording as recorder, open_rig_run(setup.open_source(), recorder) as opened:
        watch = opened.watch(asked)

        def shown(measured: TouchMeasurement, height_m: float) -> None:
            line = touched(measured, height_m)
            opened.line("")
            say(line)

        def touching(robot: TouchingRobot) -> RigExperiment[None]:
            yield from permitted(
                robot, setup, options, calibrated, asked, yes=config.yes, places_m=np.unique(places_m, axis=0)
            )
            begun(opened.source)
            yield from arm_compliance.touch_places(FromFrames(robot.geometry, options), places_m, shown, forces_n)

        with touching_robot(setup, opened.source, options, watch) as robot, watch.halts(robot):
            try:
                run_session(opened.source, touching(robot), recorder, robot)
            except ExplorationStopped as error:
                stop = error.stop
                recorder.stopped_because(f"{stop.kind}: {stop.reason}")
        found = None if stop is not None else result()
        if found is not None:
            for one in found.kept:
                recorder.write(one)
            recorder.write(Step((RigFindings(found.findings(config.rig), tuple(opened.source.streams)),)))
    if found is None:
        touches = 0 if stop is None else stop.touch
        leave_arm(stop, touches, asked, recorder.summary().path, arm_stopped=watch.arm_stopped)
    if isinstance(config, CertifyConfig) and config.save:
        write_values(Path(config.rig), found.values)
    elif not isinstance(config, CertifyConfig) and config.write and not config.rig.startswith(LAB):
        write_values(Path(config.rig), found.dated)
    return found


def _compliance(found: arm_compliance.CombinedCompliance, place: str) -> RigCalibrationResult:
    rows = [
        ("touched at", place),
        ("compliance", f"{1e3 * found.compliance_m_per_n:.3f} mm/N +- {1e3 * found.compliance_sd:.3f}"),
        ("camera", f"depth camera sees the surface {1e3 * found.off_m:+.1f} mm from the height of contact"),
        ("for [tool]", f"compliance_m_per_n = {found.compliance_m_per_n:.3e}"),
        ("", f"compliance_sd = {found.compliance_sd:.1e}"),
    ]
    if found.dome > 0.0:
        dent = f"dents {1e3 * found.dome * 3.0 ** (2.0 / 3.0):.2f} mm at 3 N (Hertz), in addition to the compliance"
        rows.insert(2, ("tip", dent))
    if found.compliance_sd > arm_compliance.SURE_SD * found.compliance_m_per_n:
        rows.append(("note", "the touches differ: make more of them; is it rigid and firmly held?"))
    known = {"compliance_m_per_n": found.compliance_m_per_n, "compliance_sd": found.compliance_sd}
    png = compliance_png([one.found for one in found.touches], ArmCompliance(**known))
    figure = Figure(png, "Compliance of the arm at each touch")
    return RigCalibrationResult("arm", {"tool": {**known}}, tuple(rows), figure, cast("dict[str, Any]", plain(found)))


def known_sample(config: "CertifyConfig", opening: Opening) -> KnownSample:
    """The sample of a name or a file, as it lies. Raises InputError."""
    setup, options, path = opening.setup, opening.options, Path(config.sample)
    if path.suffix.lower() == ".json":
        name, modulus_pa, sd, lies = _of_file(path)
    else:
        table = tomllib.loads((resources.files("deformscope") / "rig" / "silicones.toml").read_text(encoding="utf-8"))
        if (name := config.sample) not in table:
            near = nearest(name, table) or "the JSON of deformscope indent"
            raise InputError(f"a sample out of {', '.join(table)}, or a .json", repr(name), near)
        lies = {"poisson": POISSON, **table[name]}
        modulus_pa, sd = 1e3 * lies["kpa"][0], lies["kpa"][1] / lies["kpa"][0]
    stated_m = options.thickness_m if options.thickness_stated else None
    if (thickness_m := config.thickness_m or lies.get("thickness_m") or stated_m) is None:
        raise InputError("the sample's thickness", "none", "--thickness-m 0.02")
    ground: Ground = "sliding" if config.sliding or lies.get("sliding") else "bonded"
    give, tip = setup.compliance_m_per_n, Indenter("sphere", (2.0 * setup.placement.tool.radius_m,))
    sample = IndentSample(
        tip,
        thickness_m,
        ground,
        (lies["poisson"][0], lies["poisson"][1]),
        width_m=min(setup.size_m),
        machine_n_per_mm=1e-3 / give if give > 0.0 else None,
        machine_sd=setup.compliance_sd / give if give > 0.0 else 0.0,
    )
    return KnownSample(name, modulus_pa, sd, sample)


def _of_file(path: Path) -> tuple[str, float, float, dict[str, Any]]:
    """Name, modulus [Pa], deviation of its log, and the settings of the result of `indent`."""
    expected = "the JSON of deformscope indent, with a modulus in its interval"
    with contextlib.suppress(ValueError, KeyError, TypeError, IndexError):
        given = json.loads(read_file(path, expected))
        found, lies = given["together"] or given["curves"][0], given["settings"]
        modulus_pa, (low, high) = found["modulus_pa"], found["modulus_interval_pa"]
        known, thickness_m = (float(lies["poisson"][0]), float(lies["poisson"][1])), lies.get("thickness_m")
        if 0.0 < low <= modulus_pa <= high < 1e12 and -1.0 < known[0] <= known[1] <= 0.5:
            sd = float(np.log(high / low)) / 2.0 / Z_90
            lies = {**lies, "poisson": known, "thickness_m": thickness_m and float(thickness_m)}
            return f"{path.name}, {modulus_pa / 1e3:.4g} kPa", modulus_pa, sd, lies
    raise InputError(expected, "another file", "deformscope indent ... --json FILE.json", path)


def plan_touches(known: KnownSample, touches: int, size_m: tuple[float, float], most_n: float) -> list[FloatArray]:
    """Places (n, 2) [m] on a ring about the middle, and forces (n,) [N]: to the end of the law of small strain, every
    second one less deep. Raises InputError for a sample that is too small for the tip, or too soft for the sensor."""
    sample, nu = known.lies, 0.5 * sum(known.lies.poisson)
    around_m = EDGE_RADII * sample.tip.contact_radius_m(sample.limit_m)
    if (ring_m := min(0.5 * min(size_m) - around_m, RING_M)) < 0.0:
        came = f"{1e3 * min(size_m):.3g} mm"
        raise InputError(f"a sample of {2e3 * around_m:.3g} mm or more for a {sample.tip}", came, "a smaller tip")
    full = float(sample.law(sample.limit_m, nu).response(sample.limit_m)) * known.modulus_pa / (1.0 - nu**2)
    if full < LEAST_N:
        expected = f"a sample that presses back with {LEAST_N:.2g} N at {1e3 * sample.limit_m:.2g} mm"
        raise InputError(expected, f"{full:.2g} N", "a firmer or a thicker one, or a larger tip")
    turn = 2.0 * np.pi * np.arange(touches) / touches
    places_m = 0.5 * np.array(size_m) + ring_m * np.column_stack([np.cos(turn), np.sin(turn)])
    return [places_m, min(full, most_n) * np.where(np.arange(touches) % 2 == 0, 1.0, SHALLOW)]


def certify(config: CertifyConfig, opening: Opening, recording: Recording) -> RigCalibrationResult:
    """Touch a sample of known modulus, and write the rig's certificate into its file where that is asked for."""
    setup, tool, curves = opening.setup, opening.setup.placement.tool, list[IndentCurve]()
    known = known_sample(config, opening)
    places_m, forces_n = plan_touches(known, config.touches, setup.size_m, setup.workspace.target_force_n)
    opening = replace(opening, options=replace(opening.options, set_force_n=float(forces_n[0])))

    def touched(made: TouchMeasurement, height_m: float) -> str:
        name, normal = f"touch {len(curves) + 1}", made.normal / np.linalg.norm(made.normal)
        curves.append(IndentCurve(-(made.position_m @ normal), made.force_n @ normal, made.time_s, name))
        return f"{name} of {config.touches}: {curves[-1].force_n.max():.2f} N"

    def result() -> RigCalibrationResult:
        given = tool.force_gain_sd or TOLERANCE[0], *TOLERANCE[1:3], setup.compliance_sd or TOLERANCE[3], TOLERANCE[4]
        found = certify_rig(curves, known, given)
        values: dict[str, Any] = {
            "date": today(),
            "sample": known.name,
            "tip": str(known.lies.tip),
            "bias": found.bias,
            "interval": found.bias_interval,
            "off": found.off_text,
            "conditions": f"{counted(len(curves), 'touch')}, up to {forces_n.max():.2g} N, scatter {found.scatter:.1%}",
            "causes": {name: one[:2] for name, one in found.causes.items()},
        }
        rows = [*shown_rows(found, ()), *((name, str(values[name])) for name in ("sample", "tip", "conditions"))]
        if not (config.rig.startswith(LAB) or config.sample.lower().endswith(".json")):
            rows.append(("note", "a recipe's modulus is of one laboratory: measure your own sample by `indent`"))
        figure = Figure(curves_png(found.curves), "Force over depth of each touch, with the law")
        # a simulated arm's compliance is in no file, and the certificate is relative to it
        give = {"compliance_m_per_n": setup.compliance_m_per_n, "compliance_sd": setup.compliance_sd}
        stated = tool.compliance_m_per_n is not None or config.rig.startswith(LAB)
        sections = {"certificate": values} if stated else {"tool": give, "certificate": values}
        found_json = {**found.as_json(), **values, "date": str(today())}
        kept: list[InputFile | Step] = [InputFile("known", to_json((known, given)).encode()), *curve_files(curves)]
        kept.append(Step((replace(found, curves=()),)))
        return RigCalibrationResult("certificate", sections, tuple(rows), figure, found_json, kept)

    given = setup.calibrated, places_m, touched, result, forces_n.tolist()
    return _touched_result(config, opening, recording, *given)


def replay_found(recording: Replay, rig: Rig | None) -> str:
    """Compare a recorded certificate or worth of an arm's own force with that computed again; its name, empty: it has
    none. Raises Different."""
    if "known" in (inputs := recording.read_inputs()):
        known, given = from_json(tuple[KnownSample, tuple[float, ...]], inputs["known"].decode())
        found = replace(certify_rig(kept_curves(recording), known, given), curves=())
        compare(read_found(recording, RigBias), [found], recording.path)
        return "the certificate computed again from its touches"
    if "states" not in inputs:
        return ""
    count, first_ns, last_ns, filter_hz = from_json(tuple[int, int, int, float], inputs["states"].decode())
    arm = next(one for one in read_streams(recording.path, trust=True) if one.kind == "arm")
    driver = DRIVERS[arm.driver]
    config = next((one.config for one in (rig.devices if rig else ()) if one.name == arm.device), driver.config())
    frames = cast("Iterator[ArmFrame]", read_items(recording.path, trust=True, kinds=(ArmFrame,)))
    states = [one for one in map(state_of, frames) if first_ns <= one.stamp.host_ns <= last_ns]
    if len(states) != count:
        raise Different(f"the {count} states of the arm in its motion", str(len(states)), where=recording.path)
    again = learned_wrench(states, cast(Chain, driver.chain(config, arm.urdf)), filter_hz, Tool(), "")
    compare(read_found(recording, WrenchWorth), cast(Step, again.kept[1]).results, recording.path)
    return "the worth of the arm's own force computed again from its states"
