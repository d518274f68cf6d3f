"""Beta or theta from images or pairs of shapes, in files, recordings, samples or arrays."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import check_arrays
from deformscope.config.flags import Selectable
from deformscope.errors import InputError
from deformscope.experiments.fit.poke_files import LayersOptions, fit_options
from deformscope.file_io import ending_of, read_file
from deformscope.runs.calibration_result import CalibrationResult
from deformscope.runs.pair_calibration import arrays_bytes, calibrate_pair_bytes, recorded_pairs
from deformscope.runs.result import Note, log_note
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.quiet import quiet_warp

PairArrays: TypeAlias = Mapping[str, object]
"""A pair by name, as in a pair file: `rest (K, d)`, `deformed (K, d)` [m], `held (n,)`, and a pair file's other
arrays."""
MOST_PARTICLES = 11_000
"""Default number of particles of a fit of layers."""


def calibrate(
    config: BetaConfig | ThetaConfig,
    given: Sequence[PairArrays] | Sequence[ImageArray] = (),
    *,
    note: Note = log_note,
    progress: Progress | None = None,
) -> list[CalibrationResult]:
    """Fit the sources of the options, or given pairs or images (H, W[, 3]) [0..255]; one result, or one for each of
    several pairs."""
    quiet_warp()
    sources, search, output = config.sources, config.search, config.output
    check_arrays(sources, config.images, search.noise_px, "pair files", config.push)
    fit = fit_options(config)
    layers = _layers(config)
    select: tuple[Selectable, ...] | None = None
    if isinstance(config, BetaConfig) and config.motion.whole_motion:
        select = config.motion.select or ()
    if given and isinstance(given[0], Mapping):
        raws = [(name, arrays_bytes(**one)) for name, one in zip(sources, given, strict=True)]  # type: ignore[arg-type]
    elif ending_of(sources[0]) == ".npz":
        raws = [(path, read_file(path, "a pair file (.npz)")) for path in sources]
    elif given or len(sources) > 1 or Path(sources[0]).suffix.lower() != ".rrd":
        raws = []
    else:
        from deformscope.recording.reader import Replay

        raws = recorded_pairs(Replay(Path(sources[0])))
    if raws and select is not None:
        raise InputError("images with --whole-motion", "pair files", "--joint fits one value to all pairs")
    if raws:
        save = config.model.save is not None
        if save and layers is None and len(raws) > 1:
            expected = "one pair file with --save, or --thickness-m with several pokes of a surface"
            raise InputError(expected, str(len(raws)))
        return calibrate_pair_bytes(
            raws, fit, output, noise_m=search.noise_m, joint=search.joint, layers=layers, note=note, progress=progress
        )
    if search.joint:
        raise InputError("pair files with --joint", "images", "leave out --joint")
    if config.push.thickness_m is not None and config.push.force is None:
        raise InputError("--force with the --thickness-m of images", "no --force", "--force 3N")
    if search.noise_m is not None:
        raise InputError("--noise-px for images", "--noise-m", "give the noise in pixels")
    # what only images need
    from deformscope.experiments.fit.calibration_inputs import images_of
    from deformscope.runs.image_calibration import calibrate_images

    images = images_of(config)
    return [calibrate_images(config, images, fit, select, given, progress, note)]  # type: ignore[arg-type]


def _layers(config: BetaConfig | ThetaConfig) -> LayersOptions | None:
    if not isinstance(config, BetaConfig) or not config.has_layers:
        return None
    most = None if config.search.fine else MOST_PARTICLES
    own = {
        "thickness_m": config.push.thickness_m,
        "cluster_size": config.cluster_size,
        "theta": config.theta,
        "most_particles": most,
    }
    return LayersOptions(**config.layers.shared(LayersOptions) | own)
