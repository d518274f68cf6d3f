"""Anisotropy, fields of stiffness, yielding and recovery of images, recordings and files: the same for a first run and
for its replay.

Results of a material, as a table and a picture."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import ImageArray
from deformscope.config import MaterialOptions, OutputOptions, ViscousConfig, YieldConfig
from deformscope.errors import InputError
from deformscope.experiments.fit import material_motion
from deformscope.experiments.fit.calibration_inputs import images_of, mask_of, opened_images, particle_options
from deformscope.experiments.fit.material_motion import MaterialEstimate, MaterialFit
from deformscope.experiments.fit.whole_motion import ParticleOptions, TrackedMotion
from deformscope.file_io import ending_of, read_file
from deformscope.files.motions import parse_motion
from deformscope.files.pairs import parse_pair
from deformscope.files.sources import Source
from deformscope.pictures.material_figures import axes_png, field_png, recovery_png, yield_png
from deformscope.pictures.messages import reason_rows
from deformscope.pictures.report import ColoredBody, Figure, Findings, ReportVerdict, Section, Table, html_report
from deformscope.plain import Json
from deformscope.recording.items import read_found
from deformscope.recording.reader import Replay
from deformscope.results.render import Rows, format_value, to_rows
from deformscope.runs.calibration_report import provenance_sections, settings_section
from deformscope.runs.force_log import force_file, kept_force, recorded_force
from deformscope.runs.image_calibration import frames_of, images_recorder
from deformscope.runs.pair_calibration import pair_recorder, parse_files, recorded_pairs
from deformscope.runs.result import Note, SourceResult, log_note
from deformscope.session import Step, run
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.materials.axis_estimate import ACROSS_VIEW, AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.plasticity import YieldOptions
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.msm.solver import pick_device
from deformscope.stages.see.particles import clean_mask

RAW_FILES = {"axes": ("pair", "a pair file (.npz)"), "yield": ("motion", "a motion file (.npz)")}
RAW_FILES["viscous"] = RAW_FILES["yield"]
RAW_FILES["field"] = RAW_FILES["axes"]
KINDS: dict[str, type[material_motion.MaterialEstimate]] = {
    "axes": AxisEstimate,
    "field": FieldEstimate,
    "yield": YieldEstimate,
    "viscous": RecoveryEstimate,
}


@dataclass(frozen=True, slots=True)
class MaterialJob:
    """Settings that determine a result besides the inputs; they are recorded.

    find: the quantity of a material; noise: noise of a position [m of files, px of images]; particles: number of
    particles of images; frame: frame of images to which axes or a field are fitted; force_n: force on the moved
    particles;
    at, released: see `UnloadingOptions`"""

    find: Literal["axes", "field", "yield", "viscous"]
    level: float = 0.9
    seed: int = 0
    device: str = "cpu"
    noise_m: float | None = None
    particles: ParticleOptions | None = None
    cluster_size: int = 3
    turn_deg: float = 0.0
    frame: int | None = None
    force_n: float | None = None
    beta: float | None = None
    creep: float | str = "none"
    maximum: float | None = None
    theta: float = 0.0
    at: tuple[int, int] | None = None
    released: tuple[str, ...] = ("contact",)

    def yield_options(self) -> YieldOptions:
        """Options of the fit of yielding."""
        most = float("inf") if self.maximum is None else self.maximum
        given = self.beta, self.creep, most, self.cluster_size, self.theta, self.level, self.seed, self.device
        return YieldOptions(*given)

    def model(self) -> Model:
        """Model of the axes."""
        return Model(cluster_size=self.cluster_size, device=self.device)

    def directions(self, d: int) -> Any:
        """(d, d) the material's axes."""
        turn, axes = np.deg2rad(self.turn_deg), np.eye(d)
        axes[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        return axes


@dataclass(frozen=True, slots=True)
class MaterialResult(SourceResult):
    """Result of `calibrate axes`, `field`, `yield` or `viscous`.

    estimate: the numbers; found: the compared motion"""

    found: material_motion.MaterialFit

    @property
    def estimate(self) -> material_motion.MaterialEstimate:
        """The numbers."""
        return self.found.estimate

    def as_json(self) -> Json:
        return self.with_problems(self.estimate.as_json())

    def tables(self) -> tuple[Table, ...]:
        table = material_table(self.estimate, self.name)
        return (Table([*table.rows, *self.source_rows()], caption=table.caption),)

    def figures(self) -> tuple[Figure, ...]:
        return (material_figure(self.found),)

    def findings(self) -> Findings:
        return Findings(self.tables(), self.figures(), material_bodies(self.found))


def material_page(result: MaterialResult) -> str:
    """All results, with the picture, settings and provenance, as one HTML page."""
    (table,) = result.tables()
    verdict = next(str(row[1]) for row in table.rows if row[0] in ("verdict", "anisotropy"))
    sections = [
        Section("", [ReportVerdict(verdict, ())]),
        Section("Numbers and evidence", [table, *result.figures()]),
        settings_section(result.estimate.settings),
        *provenance_sections(seed=result.seed, settings=result.settings),
    ]
    return html_report(table.caption, sections)


def calibrate_material(
    config: MaterialOptions, *, note: Note = log_note, progress: Progress | None = None
) -> MaterialResult:
    """Fit the sources of the options."""
    quiet_warp()
    job, sources = job_of(config), config.sources
    settings: dict[str, Any] = {"sources": list(sources)}
    raws = _raw_files(job, sources)
    if raws:
        return run_material_files(raws, job, settings, config.output, note=note, progress=progress)
    if config.fit.noise_m is not None:
        raise InputError("--noise-px for images", "--noise-m", "give the noise in pixels")
    images = images_of(config)
    timed = isinstance(config, ViscousConfig) or (isinstance(config, YieldConfig) and config.creep != "none")
    job = dataclasses.replace(job, particles=particle_options(images, config.fit.noise_px))
    settings |= {"stride": images.stride, "fps": images.fps, "camera": images.camera}
    with opened_images(sources, images, timed=timed) as source:
        settings["timed"] = source.timed
        mask = mask_of(sources, images, source.size)
        force = None
        if job.find not in ("axes", "field") and job.at is None and Path(sources[0]).suffix.lower() == ".rrd":
            sensor = config.unloading.force if isinstance(config, YieldConfig | ViscousConfig) else None
            force = recorded_force(Path(sources[0]), sensor, source.began_ns, "--force")
        return run_material_images(source, mask, force, job, settings, config.output, progress=progress)


def job_of(config: MaterialOptions) -> MaterialJob:
    """The same without the sources and output files. The job of the options; None becomes its default."""
    groups = (config.output, config.fit, getattr(config, "unloading", None), config)
    given = {one.name: getattr(group, one.name) for group in groups if group for one in dataclasses.fields(group)}
    known = {one.name: given.get(one.name) for one in dataclasses.fields(MaterialJob)}
    known |= {"find": type(config).__name__.removesuffix("Config").lower(), "device": pick_device(config.fit.device)}
    return MaterialJob(**{name: value for name, value in known.items() if value is not None})


def run_material_images(
    source: Source,
    mask: ImageArray | None,
    force: PressForce | None,
    job: MaterialJob,
    settings: Mapping[str, object],
    output: OutputOptions,
    *,
    progress: Progress | None = None,
) -> MaterialResult:
    """Fit the material to one sequence of files, a sample or a recording. mask: (H, W) [px], 0 = not the body"""
    assert job.particles is not None
    used = {**settings, "material": dataclasses.asdict(job)}
    unloading = material_motion.UnloadingOptions(job.released, job.at, force)
    with images_recorder(source, mask, used, output) as recorder:
        if force is not None:
            recorder.write(force_file(force))
        find = _finder(job, job.particles, unloading, progress)
        experiment = material_motion.material_video(job.particles, find, None if mask is None else clean_mask(mask))
        found = run(frames_of(source, progress), experiment, recorder)
        result = MaterialResult(
            found, name=source.name, problems=tuple(source.problems()), settings=used, seed=job.seed
        )
        recorder.write(Step((result.findings(),)))
    return dataclasses.replace(result, recording=recorder.summary())


def run_material_files(
    raws: Sequence[tuple[str, bytes]],
    job: MaterialJob,
    settings: Mapping[str, object],
    output: OutputOptions,
    *,
    note: Note = log_note,
    progress: Progress | None = None,
) -> MaterialResult:
    """Pairs, all in one fit, or one motion, given by name and content: the same for files and recordings."""
    used = {**settings, "material": dataclasses.asdict(job)}
    kind = RAW_FILES[job.find][0]
    if job.find != "axes" and len(raws) > 1:
        raise InputError(f"one {kind} file", str(len(raws)), "give them in several commands")
    parse: Callable[..., Any] = parse_pair if kind == "pair" else parse_motion
    seen = parse_files(parse, raws, job.noise_m, note)
    with pair_recorder(seen, raws, used, output) as recorder:
        found = run((), material_motion.material_files(lambda: _of_files(seen, job, progress)), recorder)
        name = ", ".join(name for name, _ in raws)
        result = MaterialResult(found, name=name, settings=used, seed=job.seed)
        recorder.write(Step((result.findings(),), frame=0))
    return dataclasses.replace(result, recording=recorder.summary())


def _of_pairs(seen: Sequence[Observation], job: MaterialJob, progress: Progress | None) -> material_motion.MaterialFit:
    if job.find == "field":
        one = seen[0] if job.force_n is None else dataclasses.replace(seen[0], force_n=job.force_n)
        return material_motion.field_of_pair(one, job.level, job.seed, job.device, progress)
    return material_motion.axes_of_pairs(
        seen, job.model(), job.directions(seen[0].rest.shape[1]), job.level, job.seed, progress
    )


def _of_files(seen: Sequence[Any], job: MaterialJob, progress: Progress | None) -> material_motion.MaterialFit:
    """seen: pairs, or one motion"""
    if job.find == "yield":
        return material_motion.yield_of_motion(seen[0], job.yield_options(), progress)
    if job.find == "viscous":
        return material_motion.recovery_of_motion(seen[0], job.level, job.seed)
    return _of_pairs(seen, job, progress)


def _finder(
    job: MaterialJob, particles: ParticleOptions, unloading: material_motion.UnloadingOptions, progress: Progress | None
) -> Callable[[TrackedMotion], material_motion.MaterialFit]:
    def pose(tracked: TrackedMotion) -> material_motion.MaterialFit:
        frame, seen = material_motion.pose_of(tracked, particles, job.frame)
        found = _of_pairs([seen], job, progress)
        settings = found.estimate.settings | {"frame": frame, "frames": len(tracked.history)}
        estimate = dataclasses.replace(found.estimate, settings=settings)
        return material_motion.MaterialFit(estimate, ((frame, found.comparisons[0][1]),))

    def yielding(tracked: TrackedMotion) -> material_motion.MaterialFit:
        return material_motion.yield_of_camera(tracked, particles, unloading, job.yield_options(), progress)

    def viscous(tracked: TrackedMotion) -> material_motion.MaterialFit:
        return material_motion.recovery_of_camera(tracked, particles, unloading, job.level, job.seed)

    return {"axes": pose, "field": pose, "yield": yielding, "viscous": viscous}[job.find]


def _raw_files(job: MaterialJob, sources: Sequence[str]) -> list[tuple[str, bytes]]:
    """Pair or motion files, or those that a recording keeps; none where the source has images."""
    name, words = RAW_FILES[job.find]
    if ending_of(sources[0]) == ".npz":
        return [(one, read_file(one, words)) for one in sources]
    if len(sources) == 1 and Path(sources[0]).suffix.lower() == ".rrd":
        recording = Replay(Path(sources[0]))
        if "explore" in recording.settings and not recording.color_counts:
            hint = "`deformscope replay` fits the creep of touches that `explore --hold` made"
            raise InputError("a recording of a camera, of pairs or of a motion", "an exploration", hint, sources[0])
        return recorded_files(recording, name)
    return []


def recorded_files(recording: Replay, name: str) -> list[tuple[str, bytes]]:
    """The pair files or the motion file in a recording, by name and content."""
    if name == "pair":
        return recorded_pairs(recording)
    found = recording.read_inputs()
    return [(str(recording.path), found[name])] if name in found else []


# Replay --------------------------------------------------------------------------------------------------------------


def replay_material(
    recording: Replay, source: Source, output: OutputOptions, *, progress: Progress | None = None
) -> tuple[list[material_motion.MaterialEstimate], MaterialResult]:
    """The recorded result, and a new fit to the recorded data. source: its images"""
    settings = dict(recording.settings)
    try:
        job = msgspec.convert(settings.pop("material"), MaterialJob)
    except msgspec.ValidationError as error:
        raise InputError("a recording of this version", f"other settings ({error})", where=recording.path) from error
    recorded: list[material_motion.MaterialEstimate] = read_found(recording, KINDS[job.find])
    if job.device != "cpu":  # the recording's GPU may not be here
        job = dataclasses.replace(job, device=pick_device("auto"))
    if job.particles is None:
        raws = recorded_files(recording, RAW_FILES[job.find][0])
        return recorded, run_material_files(raws, job, settings, output, progress=progress)
    with source:
        force = kept_force(recording)
        found = run_material_images(source, recording.mask, force, job, settings, output, progress=progress)
    return recorded, found


def material_table(found: MaterialEstimate, name: str) -> Table:
    """The numbers, the verdict and why to doubt it."""
    if isinstance(found, AxisEstimate):
        return Table(_axes_rows(found), caption=f"beta along the axes of {name} ({found.level:.0%} intervals)")
    if isinstance(found, FieldEstimate):
        return Table(_field_rows(found), caption=f"Stiffness of each place of {name} ({found.level:.0%} intervals)")
    if isinstance(found, YieldEstimate):
        return Table(_yield_rows(found), caption=f"Yielding of {name} ({found.level:.0%} intervals)")
    return Table(_recovery_rows(found), caption=f"Recovery of {name} ({found.level:.0%} intervals)")


def material_figure(found: MaterialFit) -> Figure:
    """The evidence."""
    estimate = found.estimate
    if isinstance(estimate, AxisEstimate):
        return Figure(axes_png(estimate), "beta along each axis")
    if isinstance(estimate, FieldEstimate):
        return Figure(field_png(estimate), "Stiffness and beta of each place, each with its interval's width")
    if isinstance(estimate, YieldEstimate):
        assert found.motion is not None
        caption = "Error over the yield strain; distance from observed to simulated in each frame"
        return Figure(yield_png(estimate, found.motion), caption)
    return Figure(recovery_png(estimate), "Indentation over time, and the recovery after the release")


def material_bodies(found: MaterialFit) -> tuple[ColoredBody, ...]:
    """Bodies of axes or a field, with the fitted particles."""
    estimate = found.estimate
    if not isinstance(estimate, AxisEstimate | FieldEstimate) or not found.comparisons:
        return ()
    seen = found.comparisons[-1][1]
    known = np.isfinite(seen.observed).all(axis=1)
    at = seen.observed[known]
    if isinstance(estimate, FieldEstimate):
        nearest = cKDTree(estimate.place).query(seen.rest[known])[1]
        return (ColoredBody("Stiffness over its geometric mean [-]", at, estimate.stiffness[nearest]),)
    share = np.linspace(-0.5, 0.5, 41)[:, None]
    lines = [at.mean(axis=0) + share * np.ptp(at @ axis) * axis for axis in estimate.axes.T]
    value = np.concatenate([np.full(len(at), np.nan), np.repeat(estimate.value, len(share))])
    return (ColoredBody("Beta along each axis [-]", np.concatenate([at, *lines]), value),)


def _axes_rows(found: AxisEstimate) -> Rows:
    rows: Rows = []
    for k, (low, high) in enumerate(found.interval):
        rows.append(
            (f"beta along {_axis(found, k)}", f"{found.value[k]:.4g} ({low:.4g} to {high:.4g}): {found.verdict[k]}")
        )
    if len(found.value) == 2:
        rows.append(("beta across the view", f"unidentified: {ACROSS_VIEW}"))
    rows += reason_rows(tuple(dict.fromkeys(one for some in found.reasons for one in some)))
    for words, most in (("pressed", found.pressed), ("bulges", found.bulges)):
        if most is None:
            rows.append((words, "along no axis"))
        else:
            rows.append((words, f"along {_axis(found, most)}: mean strain {found.strain[most]:+.3g}"))
    differ = "the axes differ" if found.anisotropic else "one beta explains the data as well"
    return [
        *rows,
        ("anisotropy", f"{differ} (one beta would leave this error with probability {found.p_isotropic:.2g})"),
        *to_rows(found, "beta"),
        ("error, axes / one beta", f"{format_value(found, 'aee')} / {format_value(found, 'aee_isotropic')}"),
        *to_rows(found, "noise", "explained", "converged"),
    ]


def _lowered(reasons: Sequence[Doubt]) -> str:
    """Why nothing is identified; empty without a reason."""
    return next((one.text for one in reasons if one.allows == "unidentified"), "")


def _axis(found: AxisEstimate, k: int) -> str:
    return "(" + ", ".join(f"{x:.2g}" for x in found.axes[:, k]) + ")"


def _yield_rows(found: YieldEstimate) -> Rows:
    low, high = found.yield_strain.interval
    strain = f"{found.yield_strain.value:.4g} ({low:.4g} to {high:.4g})" if high is not None else f"above {low:.4g}"
    unsure = "no yield is identified" if high is None else "it yielded, but the yield strain is not identified"
    meaning = {
        "identified": "the motion determines it well",
        "weak": "the motion determines it roughly",
        "at-bound": "it yields at the smallest strain that the data resolve",
        "unidentified": _lowered(found.reasons) or unsure,
    }
    return [
        ("yield strain", strain),
        ("verdict", f"{found.verdict}: {meaning[found.verdict]}"),
        *reason_rows(found.reasons),
        *to_rows(found, "largest_strain", "beta", "creep", "set"),
        ("error, yielding / elastic", f"{format_value(found, 'aee')} / {format_value(found, 'elastic_aee')}"),
        *to_rows(found, "explained"),
        *_unloading(found.settings),
        *to_rows(found, "converged"),
    ]


def _unloading(settings: dict[str, object]) -> Rows:
    """Source of the push's end."""
    cycle = settings.get("unloading")
    if not isinstance(cycle, dict):
        return []
    source = {
        "displacement": "it rests from this frame on: the tool is assumed to be off; --at gives other frames",
        "force": "no force from this frame on",
        "given": "as named",
    }[str(cycle["source"])]
    left = f"{float(cycle['kept_share']):.0%} of the indentation is left"
    return [("unloaded", f"from frame {cycle['unloaded_frame']} on, {left} ({source})")]


def _field_rows(found: FieldEstimate) -> Rows:
    meaning = {
        "uniform": "no place differs from the others within the data's accuracy",
        "anisotropic": "one material, stiffer along one direction; no place differs from the others",
        "materials": f"{found.materials} materials with sharp borders",
        "gradual": "it changes gradually from place to place",
        "unidentified": "the relative stiffness of most places is not identified",
    }[found.verdict]
    metres = 1.0 if found.unit == "m" else found.metres_per_unit
    absolute = "positions alone determine only relative stiffness: give a force (--force-n)"
    if found.absolute is not None and metres is None:
        absolute = "in N/m with the scale of the images (--px-per-cm)"
    elif found.absolute is not None:
        assert metres is not None
        soft, stiff = found.absolute.min() / metres, found.absolute.max() / metres
        absolute = (
            f"{soft:.4g} to {stiff:.4g} N/m (modulus times {'thickness' if found.place.shape[1] == 2 else 'spacing'})"
        )
    rows = [
        *to_rows(found, "ratio"),
        ("verdict", f"{found.verdict}: {_lowered(found.reasons) or meaning}"),
        *reason_rows(found.reasons),
        *to_rows(found, "determined", "directions"),
    ]
    for number, one in enumerate(found.levels() if found.materials > 1 else []):
        numbers = f"{one['stiffness_over_softest']:.3g} times the softest, beta {one['beta']:.2g}, {one['share']:.0%}"
        rows.append((f"material {number + 1}", numbers))
    return [
        *rows,
        ("stiffness of a cell", absolute),
        ("beta", f"{found.beta.min():.3g} to {found.beta.max():.3g}"),
        *to_rows(found, "poisson"),
        *[
            (name, f"probability {likely:.2f} (left-out data: {error:.3g} times its noise)")
            for name, likely, error in zip(found.tried, found.probability, found.held_out, strict=True)
        ],
        *to_rows(found, "noise"),
        ("error, elastic / beta", f"{format_value(found, 'aee')} / {format_value(found, 'beta_aee')}"),
        *to_rows(found, "explained", "converged"),
    ]


def _recovery_rows(found: RecoveryEstimate) -> Rows:
    meaning = {
        "elastic": "it recovers immediately, within the data's accuracy",
        "viscous": "the rest of the indentation recovers with time",
        "plastic": "a part of the indentation is permanent, the rest recovers immediately",
        "viscoplastic": "a part of the indentation recovers with time, and a part is permanent",
        "unidentified": "whether it relaxes, or has a permanent set, is not identified",
    }[found.verdict]
    relaxes = found.verdict not in ("elastic", "plastic")
    return [
        *to_rows(found, "share"),
        *(to_rows(found, "time_s") if relaxes else [("mean relaxation time", "no relaxation is identified")]),
        ("permanent set", f"{format_value(found, 'set')} of the push"),
        ("verdict", f"{found.verdict}: {_lowered(found.reasons) or meaning}"),
        *reason_rows(found.reasons),
        *to_rows(found, "force_kept", "instant", "relaxed", "largest"),
        ("held, then watched", f"{found.held_s:.3g} s, {found.watched_s:.3g} s after frame {found.released}"),
        *to_rows(found, "explained"),
    ]
