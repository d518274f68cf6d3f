"""Measurements of `deformscope calibrate tip`, `place`, `camera`, `force` and `time`, and their solutions.

From measurements of a rig's set-up to values for its file, with their intervals, a table and a picture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import CameraConfig, ForceConfig, PlaceConfig, TimeConfig, TipConfig, ToolConfig
from deformscope.errors import InputError
from deformscope.experiments.rig import rig_calibration
from deformscope.experiments.rig.rig_calibration import BoardViews, ForceReadings, PushedTip, Taps, WeighedTool, taps_of
from deformscope.frames import ArmFrame, ColorFrame, DepthFrame, Frame, WrenchFrame
from deformscope.pictures.setup import off_figure, offset_figure
from deformscope.rig.rig_edit import TomlValue
from deformscope.rig.rig_file import Rig, load_rig
from deformscope.robot.placement import Placement
from deformscope.robot.setup import only_device
from deformscope.runs.arm_calibration import Arrays, RigCalibrationResult, SetupTask, Station
from deformscope.session import RigExperiment
from deformscope.stages.setup.board import CharucoSpec
from deformscope.stages.setup.force import FreeAir, force_gain, free_air, hanging_weight, mount, pivot, tool_load
from deformscope.stages.setup.hand_eye import KnownLens, camera_from_touches, camera_from_views, doubt_at, hand_eye
from deformscope.stages.setup.place import CORNER_NAMES, place
from deformscope.stages.setup.timing import time_offset
from deformscope.stages.setup.transform import LEVEL, TransformEstimate
from deformscope.terminal import say


def _tip(config: TipConfig) -> SetupTask[Any]:
    """Position of the tip on the arm's end."""
    return SetupTask(
        "tip",
        ("arm",),
        lambda at: rig_calibration.tilt_about_tip(at.operator, at.arm, config.poses, say),
        lambda found: _array(found, "T_base_ee", (4, 4)),
        solve_tip,
    )


def _place(config: PlaceConfig) -> SetupTask[Any]:
    """Pose of the surface."""
    corners = [number for _ in range(config.touches) for number in range(3)]

    def measure(at: Station) -> RigExperiment[TouchedCorners]:
        poses = yield from rig_calibration.touch_corners(at.operator, at.arm, corners, say)
        return TouchedCorners(poses, np.array(corners))

    return SetupTask("place", ("arm",), measure, place_arrays, solve_place)


def _camera(config: CameraConfig) -> SetupTask[Any]:
    """The camera's pose and lens."""
    board = CharucoSpec(*config.board, config.square)

    def measure(at: Station) -> RigExperiment[MeasuredCamera]:
        views = yield from rig_calibration.view_board(at.operator, at.arm, at.camera, board, config.views, say)
        return MeasuredCamera(views)

    return SetupTask(
        "camera",
        ("arm", "depth"),
        measure,
        camera_arrays,
        lambda rig, made: solve_camera(rig, made, board, measure_lens=config.lens),
    )


def _force(config: ForceConfig) -> SetupTask[Any]:
    """Orientation of the force sensor on the stick."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    if config.measured is None and rig.surface.T_arm_surface is None:  # before anybody pushes
        raise InputError("a rig file with tip and place", "no place", f"deformscope calibrate place {config.rig} first")
    return SetupTask(
        "force",
        ("arm", "wrench"),
        lambda at: rig_calibration.push_tip(
            at.operator, at.arm, at.wrench, config.repeats, config.tilts, say, config.weight
        ),
        lambda found: force_arrays(found, config.weight),
        solve_force,
    )


def _tool(config: ToolConfig) -> SetupTask[Any]:
    """Weight and centre of mass of what the force sensor carries."""
    return SetupTask(
        "tool",
        ("arm", "wrench"),
        lambda at: rig_calibration.weigh_tool(at.operator, at.arm, at.wrench, config.poses, say),
        tool_arrays,
        solve_tool,
    )


def _time(config: TimeConfig) -> SetupTask[Any]:
    """Offset between the clocks of force sensor and another device."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    kinds = {entry.name: entry.driver.kind for entry in rig.devices}
    name = config.device or next((one for one, kind in kinds.items() if kind == "arm"), "")
    frames: dict[str, type[ArmFrame | DepthFrame | ColorFrame]]
    frames = {"arm": ArmFrame, "depth": DepthFrame, "color": ColorFrame}
    if kinds.get(name) not in frames:
        raise InputError("--device: an arm or a camera of the rig", repr(name), ", ".join(kinds), config.rig)
    kind = frames[kinds[name]]
    wrench = only_device(rig, "wrench", "to measure with").name
    return SetupTask(
        "time",
        ("wrench", kinds[name]),
        lambda at: rig_calibration.tap_tip(at.operator, at.wrench, name, kind),
        lambda found: Taps(*(_array(found, each, ()) for each in ("x_time_s", "x", "y_time_s", "y"))),
        lambda rig, taps: solve_time(rig, taps, name, wrench),
        lambda path: recorded_taps(path, wrench, name, kind),
    )


TASKS: dict[type, Callable[[Any], SetupTask[Any]]] = {
    TipConfig: _tip,
    PlaceConfig: _place,
    CameraConfig: _camera,
    ForceConfig: _force,
    TimeConfig: _time,
    ToolConfig: _tool,
}
"""By options. Each raises InputError if the rig file lacks a required key."""


T95 = 1.7
"""Half of a 90 % interval in deviations, approximately: Student's t for a few measurements."""
DOUBT_AT_MOST_M = 0.03
"""Values of a rig file."""


def intervals(estimate: TransformEstimate) -> dict[str, Any]:
    """Half widths of the intervals, for the rig file."""
    half = estimate.half()
    return {"half_m": _plain(half[:3], 6), "half_deg": _plain(np.degrees(half[3:]), 4)}


def _plain(values: FloatArray, digits: int) -> tuple[float, ...]:
    return tuple(round(float(value), digits) for value in values)


def _matrix(T: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Rows for the rig file; the rounding keeps a rotation one to 1e-9."""
    return tuple(tuple(float(f"{value:.10g}") + 0.0 for value in row) for row in T)


def _json(estimate: TransformEstimate) -> dict[str, Any]:
    half = estimate.half()
    return {
        "T": estimate.T,
        "half_m": half[:3],
        "half_deg": np.degrees(half[3:]),
        "level": LEVEL,
        "covariance": estimate.covariance,
        "dof": estimate.dof,
    }


def _format_transform(estimate: TransformEstimate) -> tuple[tuple[str, str], ...]:
    half = estimate.half()
    at, turn = 1e3 * half[:3], np.degrees(half[3:])
    return (
        (
            "at",
            ", ".join(f"{axis} {1e3 * value:.1f}" for axis, value in zip("xyz", estimate.T[:3, 3], strict=True))
            + " mm",
        ),
        (
            "give or take",
            f"{at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f} mm; {turn[0]:.2f}, {turn[1]:.2f}, {turn[2]:.2f} degrees",
        ),
    )


def _numbered(count: int) -> list[str]:
    return [str(one + 1) for one in range(count)]


# The tip --------------------------------------------------------------------------------------------------------------


def solve_tip(rig: Rig, T_base_ee: FloatArray) -> RigCalibrationResult:
    """`[tool] T_ee_tip` from tilts (n, 4, 4) of the arm's end in the base frame [m]."""
    made = pivot(T_base_ee)
    T_tip = np.array(made.T_ee_center.T)
    if rig.tool.tip == "sphere":
        T_tip[:3, 3] += rig.tool.radius_m * T_tip[:3, 2]
    caption = "Distance of the ball from its mean position, at each tilt"
    return RigCalibrationResult(
        "tip",
        {"tool": {"T_ee_tip": _matrix(T_tip)}, "calibrated.tip": intervals(made.T_ee_center)},
        (
            ("ball's centre", "on the arm's end"),
            *_format_transform(made.T_ee_center),
            ("ball", f"stays within {1e3 * made.pivot_sd_m:.2f} mm"),
        ),
        off_figure(
            1e3 * made.off_m, _numbered(len(made.off_m)), "mm", 1e3 * made.pivot_sd_m, each="tilt", caption=caption
        ),
        {"T_ee_center": _json(made.T_ee_center), "pivot_m": made.pivot_m, "pivot_sd_m": made.pivot_sd_m},
    )


def _array(found: Arrays, name: str, shape: tuple[int, ...]) -> FloatArray:
    if name not in found:
        raise InputError(f"{name} in the file", ", ".join(sorted(found)) or "nothing")
    value = np.asarray(found[name], np.float64)
    if value.shape[1:] != shape:
        raise InputError(f"{name} of shape {('n', *shape)}", str(value.shape))
    return value


# The place ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class TouchedCorners:
    """T_base_ee: (n, 4, 4) pose of the arm's end with the tip on corners; corner: (n,) which"""

    T_base_ee: FloatArray
    corner: IntArray


def solve_place(rig: Rig, touched: TouchedCorners) -> RigCalibrationResult:
    """`[surface] T_arm_surface` and sides, and the box of `[workspace]`, from corners."""
    placement = Placement(np.eye(4), rig.tool)
    centers = touched.T_base_ee @ placement.T_ee_center
    up = -centers[:, :3, 2].mean(axis=0)
    tip = rig.calibrated.tip
    tip_sd_m = max(tip.half_m) / T95 if tip is not None and tip.half_m else 0.0
    made = place(centers[:, :3, 3], touched.corner, placement.center_offset_m, up, tip_sd_m=tip_sd_m)
    size = tuple(round(float(side), 4) for side in made.size_m)
    names = [CORNER_NAMES[one] for one in touched.corner]
    return RigCalibrationResult(
        "place",
        {
            "surface": {"T_arm_surface": _matrix(made.T_arm_surface.T), "size_m": size},
            "workspace": {"low_m": _plain(made.low_m, 3), "high_m": _plain(made.high_m, 3)},
            "calibrated.place": {**intervals(made.T_arm_surface), "half_size_m": _plain(made.size_half_m, 5)},
        },
        (
            ("surface", "in the arm's base frame"),
            *_format_transform(made.T_arm_surface),
            ("sides", f"{1e3 * size[0]:.1f} x {1e3 * size[1]:.1f} mm +- {1e3 * made.size_half_m.max():.1f} mm"),
            ("corners", f"touched within {1e3 * made.touch_sd_m:.2f} mm"),
        ),
        off_figure(
            1e3 * made.corner_off_m,
            names,
            "mm",
            1e3 * made.touch_sd_m,
            each="corner, in the order touched",
            caption="Distance of each touch from its corner",
        ),
        {"T_arm_surface": _json(made.T_arm_surface), "size_m": made.size_m, "size_half_m": made.size_half_m},
    )


def place_arrays(found: Arrays) -> TouchedCorners:
    """The arrays T_base_ee (n, 4, 4) and corner (n,) for a file."""
    poses, corner = _array(found, "T_base_ee", (4, 4)), _array(found, "corner", ()).astype(int)
    if len(poses) != len(corner) or not ((corner >= 0) & (corner < len(CORNER_NAMES))).all():
        raise InputError("a corner from 0 to 3 for each pose", f"{corner.tolist()}")
    return TouchedCorners(poses, corner)


# The camera -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCamera:
    """Measurements of one of three kinds: views of a board; T_base_ee with T_camera_board (n, 4, 4); places touched and
    seen (n, 3) [m]"""

    views: BoardViews | None = None
    poses: tuple[FloatArray, FloatArray] | None = None
    places: tuple[FloatArray, FloatArray] | None = None


def solve_camera(rig: Rig, measured: MeasuredCamera, board: CharucoSpec, *, measure_lens: bool) -> RigCalibrationResult:
    """`[camera] T_arm_camera`, the lens if it was fitted, and the error at the surface's distance."""
    camera = rig.camera
    values: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    if measured.places is not None:
        touches = camera_from_touches(*measured.places)
        estimate, off_m, sd_m = touches.T_arm_camera, touches.off_m, touches.sd_m
    else:
        if measured.views is not None:
            known = None
            if camera.focal_px is not None and camera.center_px is not None and not measure_lens:
                known = KnownLens(camera.focal_px, camera.center_px, camera.distortion)
            views = measured.views
            both = camera_from_views(views.T_base_ee, views.seen, views.size_px, board, known)
            found, lens = both.mount, both.lens
            if lens is not None:
                values |= {"focal_px": _plain(lens.focal_px, 3), "center_px": _plain(lens.center_px, 3)}
                values["distortion"] = _plain(lens.distortion, 6)
                extra["lens"] = lens
        else:
            assert measured.poses is not None
            found = hand_eye(*measured.poses)
        estimate, off_m = found.T_arm_camera, np.linalg.norm(found.off[:, :3], axis=1)
        sd_m = float(np.sqrt((off_m**2).mean()))
    values["T_arm_camera"] = _matrix(estimate.T)
    doubt_m = doubt_at(estimate, _middle(rig))
    values["doubt_m"] = round(min(doubt_m, DOUBT_AT_MOST_M), 4)
    rows = [
        ("camera", "in the arm's base frame"),
        *_format_transform(estimate),
        ("the surface's pose", f"within {1e3 * doubt_m:.1f} mm"),
    ]
    if "lens" in extra:
        rows.append(("lens", f"focal length {values['focal_px'][0]:.1f}, {values['focal_px'][1]:.1f} px"))
    if doubt_m > DOUBT_AT_MOST_M:
        rows.append(("note", "too inaccurate to remove the stick from the images: take more views, turned further"))
    return RigCalibrationResult(
        "camera",
        {"camera": values, "calibrated.camera": intervals(estimate)},
        tuple(rows),
        off_figure(
            1e3 * off_m,
            _numbered(len(off_m)),
            "mm",
            1e3 * sd_m,
            each="place" if measured.places is not None else "view",
            caption="Difference of each view from the arm's pose",
        ),
        {"T_arm_camera": _json(estimate), "doubt_m": doubt_m, **extra},
    )


def _middle(rig: Rig) -> FloatArray:
    """(3,) of the surface in the base frame [m]; of where one usually is, if that is not known yet."""
    from deformscope.robot.setup import T_BASE_SURFACE

    T = T_BASE_SURFACE if rig.surface.T_arm_surface is None else np.array(rig.surface.T_arm_surface)
    width, height = rig.surface.size_m
    return np.asarray(T @ [0.5 * width, 0.5 * height, rig.surface.top_m, 1.0])[:3]


def camera_arrays(found: Arrays) -> MeasuredCamera:
    """The arrays T_base_ee with T_camera_board, or touched_m with seen_m, for a file."""
    if "touched_m" in found:
        return MeasuredCamera(places=_pair(_array(found, "touched_m", (3,)), _array(found, "seen_m", (3,))))
    return MeasuredCamera(poses=_pair(_array(found, "T_base_ee", (4, 4)), _array(found, "T_camera_board", (4, 4))))


def _pair(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(first) != len(second):
        raise InputError("as many of one as of the other", f"{len(first)} and {len(second)}")
    return first, second


# The force sensor -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPushes:
    """force_n, axis: (n, 3) measured [N], and direction of the tip on the world, tip frame; free: readings in free air,
    None = not measured; R_base_tip: (m, 3, 3) rotations of the tip in free air; turned_n: (m, 3) forces in these poses
    [N]; load_n: a known load, None = none; loaded_n: (k, 3) forces under the load relative to free air [N]"""

    force_n: FloatArray
    axis: FloatArray
    free: ForceReadings | None = None
    R_base_tip: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    turned_n: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    load_n: float | None = None
    loaded_n: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def pushes_of(rig: Rig, made: PushedTip) -> MeasuredPushes:
    """The pushes with the axes in the tip's frame, computed from tip and place."""
    if rig.surface.T_arm_surface is None or rig.tool.T_ee_tip is None:
        lacks = "place" if rig.surface.T_arm_surface is None else "tip"
        raise InputError("a rig file with tip and place", f"no {lacks}", f"deformscope calibrate {lacks} RIG first")
    placement = Placement(np.array(rig.surface.T_arm_surface, np.float64), rig.tool)
    R_surface_tip = placement.T_surface_center(np.asarray(made.T_base_ee, np.float64))[:3, :3]
    held = np.concatenate([made.T_base_ee[None], made.tilted]) if len(made.tilted) else made.tilted
    turned_n = made.tilted_n
    if len(made.tilted):
        turned_n = np.concatenate([made.free.force_n.mean(axis=0)[None], turned_n])
    R_base_tip = (held @ placement.T_ee_center)[:, :3, :3]
    axes = -made.axis @ R_surface_tip
    return MeasuredPushes(made.force_n, axes, made.free, R_base_tip, turned_n, made.load_n, made.loaded_n)


def solve_force(rig: Rig, made: MeasuredPushes | PushedTip) -> RigCalibrationResult:
    """`[tool] R_tip_force` from pushes, and `force_gain` from a known load; noise and drift as well."""
    pushes = made if isinstance(made, MeasuredPushes) else pushes_of(rig, made)
    found = mount(pushes.force_n, pushes.axis / np.linalg.norm(pushes.axis, axis=1, keepdims=True))
    rest = None if pushes.free is None else free_air(pushes.free.time_s, pushes.free.force_n)
    half_deg, turn_deg = np.degrees(found.turn_half_rad), np.degrees(found.turn_rad)
    signs = "as they should be" if np.linalg.det(found.R_tip_force) > 0 else "mirrored: an axis the other way round"
    rows = [
        ("turned", f"by {turn_deg:.1f} degrees about the stick +- {half_deg:.1f}"),
        ("axes", signs),
        ("z", "out of the stick" if found.R_tip_force[2, 2] > 0 else "into the stick: its sign is turned round"),
    ]
    if rest is not None:
        rows += _format_free_air(rest)
    weight = None
    if len(pushes.turned_n):
        weight = hanging_weight(pushes.turned_n, pushes.R_base_tip, found.R_tip_force)
        rows.append(("hangs on it", f"{weight.weight_n:.2f} N, give or take {weight.weight_half_n:.2f}"))
    tool: dict[str, TomlValue] = {"R_tip_force": _matrix(found.R_tip_force)}
    dated: dict[str, TomlValue] = {"half_deg": (0.0, 0.0, round(float(half_deg), 3))}
    gain = None if pushes.load_n is None else force_gain(pushes.loaded_n, pushes.load_n)
    if gain is not None:
        tool |= {"force_gain": round(gain.gain, 5), "force_gain_sd": round(gain.sd, 5)}
        dated["half_gain"] = round(gain.half, 5)
        off = f"{100.0 * (gain.gain - 1.0):+.1f} %, give or take {100.0 * gain.half:.1f}"
        rows.append(("gain", f"{off}: the sensor under {pushes.load_n:g} N"))
    return RigCalibrationResult(
        "force",
        {"tool": tool, "calibrated.force": dated},
        tuple(rows),
        off_figure(
            np.degrees(np.abs(found.off_rad)),
            _numbered(len(found.off_rad)),
            "deg",
            np.degrees(found.push_sd_rad),
            each="push across the stick",
            caption="Angle of each push to its direction",
        ),
        {
            "R_tip_force": found.R_tip_force,
            "turn_deg": turn_deg,
            "half_deg": half_deg,
            "level": LEVEL,
            "free_air": rest,
            "weight": weight,
            "gain": gain,
        },
    )


def _format_free_air(rest: FreeAir) -> Sequence[tuple[str, str]]:
    worst = int(np.argmax(np.abs(rest.drift_n_per_min)))
    drift, half = rest.drift_n_per_min[worst], rest.drift_half[worst]
    return (
        ("in free air", f"{np.linalg.norm(rest.tare_n):.2f} N, noise {1e3 * rest.noise_n.max():.1f} mN"),
        ("drift", f"{drift:+.2f} N a minute at most, +- {half:.2f}"),
    )


def force_arrays(found: Arrays, load_n: float | None = None) -> MeasuredPushes:
    """force_n and axis (n, 3); with a known load [N] loaded_n (k, 3)."""
    force_n, axis = _pair(_array(found, "force_n", (3,)), _array(found, "axis", (3,)))
    loaded_n = np.zeros((0, 3)) if load_n is None else _array(found, "loaded_n", (3,))
    return MeasuredPushes(force_n, axis, load_n=load_n, loaded_n=loaded_n)


# The tool on the sensor -----------------------------------------------------------------------------------------------

GRAVITY_M_S2 = 9.80665


def solve_tool(rig: Rig, made: WeighedTool) -> RigCalibrationResult:
    """`[tool] weight_n`, and for a sensor of six axes `weight_center_m`."""
    placement = Placement(np.eye(4), rig.tool)
    R_tip_force = np.eye(3) if rig.tool.R_tip_force is None else np.array(rig.tool.R_tip_force)
    found = tool_load(made.force_n, made.torque_nm, (made.T_base_ee @ placement.T_ee_center)[:, :3, :3], R_tip_force)
    weight, half_n = found.weight, found.weight.weight_half_n
    tool: dict[str, TomlValue] = {"weight_n": _plain(weight.weight_n * weight.down, 4)}
    dated: dict[str, TomlValue] = {"half_weight_n": round(half_n, 4)}
    kg, half_kg = weight.weight_n / GRAVITY_M_S2, half_n / GRAVITY_M_S2
    rows = [
        ("tool", f"{weight.weight_n:.3f} N, give or take {half_n:.3f}: {kg:.4f} kg +- {half_kg:.4f}"),
        ("bias", _with_halves(weight.bias_n, weight.bias_half_n, "N")),
    ]
    if found.center_m is not None and found.center_half_m is not None:
        tool["weight_center_m"], dated["half_m"] = _plain(found.center_m, 5), _plain(found.center_half_m, 5)
        rows.append(("centre of mass", _with_halves(1e3 * found.center_m, 1e3 * found.center_half_m, "mm")))
        assert found.bias_nm is not None
        assert found.bias_half_nm is not None
        rows.append(("bias of torque", _with_halves(1e3 * found.bias_nm, 1e3 * found.bias_half_nm, "mN m")))
    return RigCalibrationResult(
        "tool",
        {"tool": tool, "calibrated.tool": dated},
        tuple(rows),
        off_figure(
            weight.off_n,
            _numbered(len(weight.off_n)),
            "N",
            float(np.sqrt((weight.off_n**2).mean())),
            each="pose",
            caption="Difference of each pose's force from that of bias and weight",
        ),
        {"mass_kg": kg, "mass_half_kg": half_kg, "level": LEVEL, "load": found},
    )


def _with_halves(values: FloatArray, halves: FloatArray, unit: str) -> str:
    return ", ".join(f"{value:.2f} +- {half:.2f}" for value, half in zip(values, halves, strict=True)) + f" {unit}"


def tool_arrays(found: Arrays) -> WeighedTool:
    """The arrays T_base_ee (n, 4, 4), force_n and, of a sensor of six axes, torque_nm (n, 3) for a file."""
    poses, force_n = _pair(_array(found, "T_base_ee", (4, 4)), _array(found, "force_n", (3,)))
    torque_nm = _pair(_array(found, "torque_nm", (3,)), force_n)[0] if "torque_nm" in found else None
    return WeighedTool(poses, force_n, torque_nm)


# Clocks ---------------------------------------------------------------------------------------------------------------


def solve_time(rig: Rig, taps: Taps, device: str, beside: str) -> RigCalibrationResult:
    """Delay of a device relative to a force sensor; their names in the rig."""
    found = time_offset(taps.x_time_s, taps.x, taps.y_time_s, taps.y)
    half_s = 0.5 * (found.high_s - found.low_s)
    late_ms, low_ms, high_ms = 1e3 * found.offset_s, 1e3 * found.low_s, 1e3 * found.high_s
    return RigCalibrationResult(
        "time",
        {
            "calibrated.time": {
                "offset_s": round(found.offset_s, 5),
                "half_s": round(half_s, 5),
                "device": device,
                "beside": beside,
            }
        },
        (
            (f"{device} late", f"{late_ms:+.1f} ms relative to {beside}, between {low_ms:.1f} and {high_ms:.1f} ms"),
            ("taps", f"explain {100 * found.share:.0f} % of it"),
        ),
        offset_figure(found, device, beside),
        {
            "device": device,
            "beside": beside,
            "offset_s": found.offset_s,
            "low_s": found.low_s,
            "high_s": found.high_s,
            "share": found.share,
            "level": LEVEL,
        },
    )


RECORDED_AT_MOST_S = 120.0
"""Longest recording with taps: the whole recording is compared at every offset."""


def recorded_taps(path: Path, wrench: str, device: str, kind: type[ArmFrame | DepthFrame | ColorFrame]) -> Taps:
    """Taps in a recording of a force sensor and another device, by their names in it.

    Raises InputError if a device is missing, or the recording is too long."""
    from deformscope.recording.items import read_items

    frames: dict[str, list[Frame]] = {wrench: [], device: []}
    for item in read_items(path, kinds=(WrenchFrame, kind)):
        if isinstance(item, Frame) and item.device in frames:
            frames[item.device].append(item)
            first_ns = frames[item.device][0].stamp.arrived_ns
            if (long_s := (item.stamp.arrived_ns - first_ns) / 1e9) > RECORDED_AT_MOST_S:
                expected = f"a recording of {RECORDED_AT_MOST_S:g} s at most"
                raise InputError(expected, f"{long_s:.0f} s and more", "record the taps alone", path)
    missing = [name for name, some in frames.items() if not some]
    if missing:
        raise InputError(f"frames of {wrench} and {device}", f"none of {' and '.join(missing)}", where=path)
    return taps_of(frames[wrench], frames[device])
