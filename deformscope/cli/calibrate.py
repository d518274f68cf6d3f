"""`deformscope calibrate beta|theta`: fit the model to images or to pair files, with interval and verdict.

deformscope calibrate beta my_video.mp4 --roi 400,200,750,350 --grid 7x15 --held bottom,contact --contact 740,180,60,40
deformscope calibrate beta frames/ --mask mask.tif --grid 24x12 --held top,bottom --record out.rrd --viewer native
deformscope calibrate beta sample:tension --whole-motion --select cluster-size,held --json -
deformscope calibrate beta pair.npz --cluster-size 3 --json -
deformscope calibrate theta cube.npz --picture cube.png --report cube.html
"""

from __future__ import annotations

import dataclasses
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import (
    EXIT_LOSSES,
    console,
    fit_progress,
    note_sizes,
    progress,
    quiet_warp,
    read_file,
    resolve_viewer,
    show_table,
    write_json,
)
from deformscope.cli.pokes import fit_layers, save_pair_model, tell_layers
from deformscope.cli.summaries import estimate_rows, write_summaries
from deformscope.config import BetaConfig, ImageOptions, OutputOptions, SearchOptions, SummaryOptions, ThetaConfig
from deformscope.errors import InputError

NO_SUMMARY = SummaryOptions()

if TYPE_CHECKING:
    from deformscope.arrays import ImageArray
    from deformscope.experiments.foam_video import ParticleOptions
    from deformscope.experiments.poke_files import LayersOptions
    from deformscope.experiments.whole_motion import MotionOptions
    from deformscope.files.sources import Source
    from deformscope.log.blueprint import Layout
    from deformscope.recording.recorder import RecordingSummary
    from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model
    from deformscope.stages.fit.estimate import Choice, Estimate
    from deformscope.stages.poke.poke_estimate import PokesFound


def beta(config: BetaConfig) -> None:
    """`calibrate beta`: overlapping clusters, theta fixed."""
    from deformscope.stages.fit.calibrate import Model

    quiet_warp()
    model = Model(
        "beta",
        config.mode,
        config.fitted_cluster_size,
        config.alpha,
        theta=config.fitted_theta,
        volume=config.search.volume,
        device=_device(config),
    )
    _calibrate(config, model, config.beta_range)


def theta(config: ThetaConfig) -> None:
    """`calibrate theta`: one quadratic cluster unless asked otherwise, beta fixed."""
    from deformscope.stages.fit.calibrate import Model

    quiet_warp()
    model = Model(
        "theta",
        config.mode,
        config.cluster_size,
        config.alpha,
        beta=config.beta,
        volume=config.search.volume,
        device=_device(config),
    )
    _calibrate(config, model, config.theta_range)


def _device(config: BetaConfig | ThetaConfig) -> str:
    from deformscope.stages.msm.solver import pick_device

    return pick_device(config.search.device)


def _calibrate(config: BetaConfig | ThetaConfig, model: Model, bounds: tuple[float, float]) -> None:
    from deformscope.stages.fit.calibrate import FitOptions

    sources, search, images, output = config.sources, config.search, config.images, config.output
    fit = FitOptions(model, bounds, search.method, search.candidates, search.level, output.seed)
    pairs = [source for source in sources if Path(source).suffix.lower() == ".npz"]
    if pairs and len(pairs) != len(sources):
        other = next(source for source in sources if source not in pairs)
        raise InputError("either pair files or images", "both", "name them in two commands", other)
    save, layers, summary, motion = config.model.save, _layers(config), config.summary, _motion(config)
    if motion is not None and (pairs or _recorded_pairs(sources[0])):
        raise InputError("images with --whole-motion", "pair files", "--joint fits one value to all pairs")
    if pairs:
        paths = [Path(source) for source in pairs]
        calibrate_pairs(paths, fit, search, images, output, layers=layers, save=save, summary=summary)
        return
    if len(sources) == 1 and (raws := _recorded_pairs(sources[0])):
        calibrate_pair_bytes(
            raws, fit, output, noise_m=search.noise_m, joint=search.joint, layers=layers, save=save, summary=summary
        )
        return
    if layers is not None:
        raise InputError("pair files with --thickness-m", "images", "leave out --thickness-m")
    if save is not None:
        raise InputError("pair files with --save", "images", "leave out --save")
    if search.joint:
        raise InputError("pair files with --joint", "images", "leave out --joint")
    if search.noise_m is not None:
        raise InputError("--noise-px for images", "--noise-m", "give the noise in pixels")
    if len(sources) == 1 and sources[0].startswith("sample:"):
        images = for_sample(sources[0].removeprefix("sample:"), images)
    if motion is not None and {"alpha", "dt"} & set(motion.select) and images.fps is None and _tell_no_rate(sources):
        raise InputError("--fps with --select alpha or dt", "images that do not tell their rate", "--fps 30")
    calibrate_images(sources, fit, particle_options(images, search), images, output, summary, motion)


def _motion(config: BetaConfig | ThetaConfig) -> MotionOptions | None:
    if not isinstance(config, BetaConfig) or not config.motion.whole_motion:
        return None
    from deformscope.experiments.whole_motion import MotionOptions

    return MotionOptions(config.motion.select or ())


def _tell_no_rate(sources: Sequence[str]) -> bool:
    """Whether the sources are images by themselves, which do not say how fast they were taken."""
    return len(sources) > 1 or Path(sources[0]).is_dir()


def _layers(config: BetaConfig | ThetaConfig) -> LayersOptions | None:
    if not isinstance(config, BetaConfig) or config.layers.thickness_m is None:
        return None
    from deformscope.experiments.poke_files import LayersOptions

    return LayersOptions(config.layers.thickness_m, config.layers.spacing_m, config.cluster_size, config.theta)


def _recorded_pairs(source: str) -> list[tuple[str, bytes]]:
    if Path(source).suffix.lower() != ".rrd":
        return []
    from deformscope.recording.reader import Replay

    return [(f"{source}, pair {index}", raw) for index, raw in enumerate(Replay(Path(source)).read_pair_bytes())]


# Images --------------------------------------------------------------------------------------------------------------


def sample_images(name: str) -> ImageOptions:
    """The flags that suit a sample that ships, out of its `sample.toml`."""
    import tomllib

    from deformscope.files.sources import sample_path

    folder = sample_path(name)
    told = tomllib.loads((folder / "sample.toml").read_text(encoding="utf-8"))
    return ImageOptions(
        roi=tuple(told["roi"]) if "roi" in told else None,
        grid=tuple(told["grid"]) if "grid" in told else None,
        spacing_px=told.get("spacing_px"),
        mask=folder / told["mask"] if "mask" in told else None,
        held=tuple(told["held"]),
        fps=told.get("fps"),
    )


def for_sample(name: str, asked: ImageOptions) -> ImageOptions:
    """What was asked for, with the sample's own particles where nothing was said about them."""
    told = sample_images(name)
    if any(value is not None for value in (asked.roi, asked.grid, asked.spacing_px, asked.mask, asked.held)):
        return dataclasses.replace(asked, fps=asked.fps or told.fps)
    return dataclasses.replace(
        told, fps=asked.fps or told.fps, stride=asked.stride, flow=asked.flow, px_per_cm=asked.px_per_cm
    )


def particle_options(images: ImageOptions, search: SearchOptions) -> ParticleOptions:
    """What decides how images become particles, without where they come from."""
    from deformscope.experiments.foam_video import ParticleOptions

    return ParticleOptions(
        roi=images.roi,
        grid=images.grid,
        spacing_px=images.spacing_px,
        held=images.held_parts(),
        contact=images.contact,
        flow=images.flow,
        px_per_cm=images.px_per_cm,
        noise_px=search.noise_px,
    )


def calibrate_images(
    sources: Sequence[str],
    fit: FitOptions,
    particles: ParticleOptions,
    images: ImageOptions,
    output: OutputOptions,
    summary: SummaryOptions = NO_SUMMARY,
    motion: MotionOptions | None = None,
) -> Estimate:
    """Fit a sequence, record it where asked, tell and write the result."""
    from deformscope.files.sources import open_source
    from deformscope.images import read_image
    from deformscope.recording.reader import Replay

    mask: ImageArray | None = None
    if images.mask is not None:
        mask = read_image(images.mask)
    elif len(sources) == 1 and Path(sources[0]).suffix.lower() == ".rrd":
        mask = Replay(Path(sources[0]), trust=True).mask  # its ledger was compared when it was looked at for pairs
    settings = {"sources": list(sources), "stride": images.stride, "fps": images.fps, "mask": images.mask is not None}
    settings |= {"camera": images.camera} if images.camera is not None else {}
    opened = open_source(sources, stride=images.stride, fps=images.fps, mask=images.mask, camera=images.camera)
    with opened as source:
        found = run_images(source, mask, fit, particles, settings, output, summary, motion)
    if problems := source.problems():
        console().print(f"deformscope: {source.name} is damaged: {'; '.join(problems)}", markup=False, soft_wrap=True)
        raise SystemExit(EXIT_LOSSES)
    return found


def run_images(
    source: Source,
    mask: ImageArray | None,
    fit: FitOptions,
    particles: ParticleOptions,
    settings: dict[str, Any],
    output: OutputOptions,
    summary: SummaryOptions = NO_SUMMARY,
    motion: MotionOptions | None = None,
) -> Estimate:
    """One sequence through the loop: the same for files, samples and recordings. motion: all frames are fitted."""
    from deformscope.experiments.foam_video import foam_video
    from deformscope.experiments.whole_motion import whole_motion
    from deformscope.recording.recorder import Recorder
    from deformscope.session import run
    from deformscope.stages.see.particles import clean_mask

    used = settings | {"particles": dataclasses.asdict(particles), "fit": dataclasses.asdict(fit)}
    if motion is not None:
        used["motion"] = dataclasses.asdict(motion)
    region = None if mask is None else clean_mask(mask)
    last: list[ImageArray] = []
    with Recorder(
        output.record, resolve_viewer(output.viewer), used, layout="images", overwrite=output.overwrite
    ) as recorder:
        if mask is not None:
            recorder.write_input("mask", mask)
        with progress("frames", total=source.count) as advance, fit_progress() as fitting:

            def frames() -> Iterator[Any]:
                for frame in source:
                    last[:] = [frame.image]
                    yield frame
                    advance(1)

            experiment = (
                foam_video(particles, fit, region, fitting)
                if motion is None
                else whole_motion(particles, fit, motion, region, fitting)
            )
            found = run(frames(), experiment, recorder)
        problems = source.problems()
        if problems:
            recorder.stopped_because(f"with what could be read of {source.name}: {'; '.join(problems)}")
    tell(found.estimate, recorder.summary(), problems=problems)
    if summary.wanted:
        from deformscope.pictures.evidence import Result

        shown = Result(found.estimate, found.comparisons[-1:], ("",), last[0])
        write_summaries(summary, [shown], seed=output.seed, settings=used)
    damage = {"source_problems": problems} if problems else {}
    write_json(found.estimate.as_json() | damage, output.json)
    return found.estimate


# Pairs ---------------------------------------------------------------------------------------------------------------


def calibrate_pairs(
    paths: Sequence[Path],
    fit: FitOptions,
    search: SearchOptions,
    images: ImageOptions,
    output: OutputOptions,
    *,
    layers: LayersOptions | None = None,
    save: Path | None = None,
    summary: SummaryOptions = NO_SUMMARY,
) -> None:
    """Fit pair files."""
    if images != ImageOptions():
        raise InputError("no flags about images with pair files", "some (--roi, --grid, --held...)", "leave them out")
    if search.noise_px is not None:
        raise InputError("--noise-m for pair files", "--noise-px", "give the noise in metres")
    raws = [(str(path), read_file(path, "a pair file (.npz)")) for path in paths]
    calibrate_pair_bytes(
        raws, fit, output, noise_m=search.noise_m, joint=search.joint, layers=layers, save=save, summary=summary
    )


def calibrate_pair_bytes(
    raws: Sequence[tuple[str, bytes]],
    fit: FitOptions,
    output: OutputOptions,
    *,
    noise_m: float | None = None,
    joint: bool = False,
    layers: LayersOptions | None = None,
    save: Path | None = None,
    summary: SummaryOptions = NO_SUMMARY,
) -> list[Estimate]:
    """Fit pairs given by name and content: the same for files and recordings.

    layers: all are pokes of one surface, fitted together with the material below it
    """
    from deformscope.experiments.pair_files import pair_files
    from deformscope.files.pairs import parse_pair
    from deformscope.pictures.evidence import Result
    from deformscope.recording.recorder import Recorder
    from deformscope.session import run
    from deformscope.stages.msm.clusters import rank

    if save is not None and layers is None and len(raws) > 1:
        raise InputError("one pair file with --save, or --thickness-m with several pokes of a surface", str(len(raws)))
    seen = [parse_pair(raw, name, noise_m=noise_m) for name, raw in raws]
    note_sizes(one.rest for one in seen)
    if layers is None and any(one.rest.shape[1] == 3 and rank(one.rest) == 2 for one in seen):
        console().print("note: a flat surface by itself hardly feels beta; --thickness-m fits the material below it")
    names = [name for name, _ in raws]
    found: list[Calibration] = []
    pokes: PokesFound | None = None
    settings = {
        "sources": names,
        "noise_m": noise_m,
        "joint": joint,
        "fit": dataclasses.asdict(fit),
    }
    if layers is not None:
        settings["layers"] = dataclasses.asdict(layers)
    layout: Layout = "pair" if all(one.rest.shape[1] == 2 for one in seen) else "pair-3d"
    with Recorder(
        output.record, resolve_viewer(output.viewer), settings, layout=layout, overwrite=output.overwrite
    ) as recorder:
        if recorder.active and len({one.rest.shape[1] for one in seen}) > 1:
            raise InputError("pairs all in the plane, or all in space, in one recording", "both", "two commands")
        for index, (_, raw) in enumerate(raws):
            recorder.write_input(f"pair/{index}", raw)
        if layers is not None:
            pokes = fit_layers(seen, names, fit, layers, recorder)
        else:
            with fit_progress() as fitting:
                found = run((), pair_files(seen, fit, joint=joint, progress=fitting), recorder)
    if pokes is not None:
        tell_layers(pokes, names, recorder.summary(), output, save)
        if summary.wanted:
            shown = Result(pokes.estimate, pokes.comparisons, tuple(names[i] for i in pokes.fit.shaped))
            write_summaries(summary, [shown], seed=output.seed, settings=settings, pokes=pokes)
        return [pokes.estimate]
    for name, one in zip(names, found, strict=False):
        tell(one.estimate, recorder.summary(), "all pairs" if joint else name)
    if summary.wanted:
        called = [tuple(names)] if joint else [(name,) for name in names]
        results = [Result(one.estimate, one.comparisons, some) for one, some in zip(found, called, strict=True)]
        write_summaries(summary, results, seed=output.seed, settings=settings)
    if save is not None:
        save_pair_model(seen[0], raws[0][0], fit.model, found[0].estimate, save)
    every = [one.estimate.as_json() for one in found]
    write_json(every[0] if len(every) == 1 else every, output.json)
    return [one.estimate for one in found]


# Telling -------------------------------------------------------------------------------------------------------------


def tell(estimate: Estimate, recording: RecordingSummary, name: str = "", problems: Sequence[str] = ()) -> None:
    """The result as a short table. problems: of the source"""
    rows = estimate_rows(estimate)
    if problems:
        rows.append(("SOURCE DAMAGED", "; ".join(problems)))
    if recording.path is not None:
        rows.append(("recording", f"{recording.path} ({recording.bytes / 1e6:.1f} MB)"))
        rows.append(("to look at it", f"{_rerun()} {recording.path}"))
    if recording.dropped:
        rows.append(("live view", f"{recording.dropped} items dropped; the recording has them all"))
    title = f"{estimate.parameter} of {name}" if name else f"Estimate of {estimate.parameter}"
    show_table(title, rows)
    if estimate.selection:
        show_table("Error on particles left out, of each way of fitting", list(map(_choice, estimate.selection)))


def _choice(one: Choice) -> tuple[str, str]:
    pace = "static" if one.alpha is None else f"alpha {one.alpha:g}, dt {one.dt:g} s"
    name = f"{one.cluster_size} a side, {','.join(one.held)}, {pace}"
    value = f"{one.held_out:.3g} ± {one.scatter:.2g} (fitted {one.fit:.3g}, at {one.value:.3g})"
    return name, value + (" <- used" if one.chosen else "")


def _rerun() -> str:
    """How this user starts rerun's viewer: by name where it is on the PATH, else beside this Python."""
    beside = Path(sys.executable).with_name("rerun")
    if shutil.which("rerun") is not None or not beside.exists():
        return "rerun"
    try:
        return str(beside.relative_to(Path.cwd()))
    except ValueError:
        return str(beside)
