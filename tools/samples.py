"""Makes the samples of the laboratory that ship (`sample:pair`, `sample:cube`, `sample:poke`, `sample:press`,
`sample:video`, `sample:sponge` with PyAV, `sample:squeezes`, `sample:table`) anew.

python tools/samples.py [NAME...]
"""

import dataclasses
import functools
import io
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.file_io import replacing
from deformscope.lab.slab import RigidTip, Slab
from deformscope.lab.slab import press as press_slab
from deformscope.stages.msm.clusters import lattice as lattice_clusters
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.plastic import PlasticMsm
from deformscope.stages.msm.solver import Msm
from studies.rendered_video import SCALE, RenderedVideo, VideoCase, encode, force_table, render
from studies.reproduce.pressed_block import Block, PressedBlock, press
from studies.reproduce.pressed_cubes import SIDE_M, thesis_cubes
from studies.reproduce.speckle import View, film
from studies.reproduce.virtual_foams import FOAMS

FOLDER = Path(__file__).resolve().parents[1] / "deformscope" / "samples"
FOAM = FOAMS[2]
BLOCK = Block(width_m=0.25, height_m=0.07, thickness_m=0.10)
CLAMP_M, DEEPEST_M, POSES = 0.03, 0.02, 5
NOISE_M = 1e-4
POISSON, CUBE_SIDE, CUBE_DEPTH_M, CUBE_NOISE_M = 0.25, 6, 0.01, 5e-4
SPACING_M = 0.02
SQUEEZES = 100
SMALL = ("tactile", "vision_small", "physical")
"""Of the modalities of a squeeze those of up to 121 numbers."""

SPONGE = VideoCase(
    3001,
    modulus_pa=15e3,
    poisson=0.05,
    size_m=(0.12, 0.06, 0.04),
    tool_at_m=0.008,
    approach_m=0.003,
    width_px=960,
    height_px=540,
    frames=45,
    rest=8,
    ramp=24,
    fps=15.0,
    fill=0.5,
    tilt_deg=2.0,
    ruler=True,
    log=dataclasses.replace(SCALE, offset_s=2.4),
)
SPONGE_MBIT = 2.2


def pushed() -> list[PressedBlock]:
    """The block of foam at each depth of the clamp."""
    depths = np.linspace(0.0, DEEPEST_M, POSES + 1)[1:]
    return press(FOAM.law(), BLOCK, CLAMP_M, depths.tolist())


def pair() -> bytes:
    """The foam's particles before and after the push, seen with noise, and the force."""
    last = pushed()[-1]
    columns, rows = np.linspace(-0.07, 0.07, 15), np.linspace(0.0, BLOCK.height_m, 8)
    rest = np.stack(np.meshgrid(rows, columns, indexing="ij")[::-1], axis=-1).reshape(-1, 2)
    contact = np.flatnonzero((rest[:, 1] == BLOCK.height_m) & (np.abs(rest[:, 0]) <= 0.5 * CLAMP_M))
    held = np.union1d(np.flatnonzero(rest[:, 1] == 0.0), contact)
    deformed = seen(rest + last.at(rest), held, NOISE_M)
    return arrays(
        rest=rest, deformed=deformed, held=held, contact=contact, force_n=last.force_n, noise_m=NOISE_M, shape=(8, 15)
    )


def cube() -> bytes:
    """A cube between plates before and after a push: its outer surface, seen with noise, and its Poisson's ratio."""
    (made,), _ = thesis_cubes((POISSON,), (CUBE_SIDE,), (CUBE_DEPTH_M,))
    rest, held = made.seen.rest, made.seen.held
    outside = ((rest == 0.0) | (rest == SIDE_M)).any(axis=1)
    deformed = np.where(outside[:, None], seen(made.seen.deformed, held, CUBE_NOISE_M), np.nan)
    named = {"rest": rest, "deformed": deformed, "observed": outside, "held": held, "held_noise_m": 0.0}
    return arrays(**named, noise_m=CUBE_NOISE_M, nu=POISSON, shape=made.seen.shape)


def poke(at: tuple[float, float] = (0.12, 0.12), force_n: float = 6.0) -> bytes:
    """The surface of a slab of foam, 40 kPa and 5 cm thick, before and while a flat tip presses it, and the force."""
    slab, side = Slab((0.4, 0.3, 0.05), 40e3, 0.3), 0.03
    rest = slab.grid(SPACING_M)
    dent = press_slab(slab, at, RigidTip((0.5 * side, 0.5 * side)), rest, force=force_n)
    contact = np.flatnonzero(dent.touched)
    deformed = seen(rest + dent.displaced, contact, NOISE_M)
    pressed = {"held": contact, "contact": contact, "force_n": force_n, "noise_m": NOISE_M}
    tip = {"tip": "flat", "tip_size_m": (side, side), "tip_at_m": (*at, slab.size[2])}
    return arrays(rest=rest, deformed=deformed, **pressed, **tip)


def press_and_release() -> bytes:
    """A block in the plane that yields: frame by frame while a tool presses it, holds it, and lets it go."""
    shape, beta, dt = (5, 7), 0.7, 0.25
    rows, columns = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    rest = 0.01 * np.column_stack([columns.ravel(), shape[0] - 1 - rows.ravel()])
    low, tip = np.flatnonzero(rows.ravel() == shape[0] - 1), np.array([2, 3, 4])
    pressing = np.concatenate([low, tip])
    body = PlasticMsm(Msm(rest, lattice_clusters(rest, shape, np.arange(len(rest)), 3), pressing), Plasticity(0.06))
    loads = [0.5, 1.0, *[1.0] * 6, *[0.0] * 8]
    motion, held = [], np.zeros((len(loads), len(rest)), dtype=bool)
    for frame, load in enumerate(loads):
        index = pressing if load else low
        at = rest[index]
        at[len(low) :, 1] -= load * 0.014
        body.hold(index)
        motion.append(body.load(at, beta, settled=1e-4).position[0])
        held[frame, index] = True
    noise = np.random.default_rng(0).normal(0.0, NOISE_M, (len(loads), *rest.shape))
    return arrays(rest=rest, motion=np.stack(motion) + noise, held=held, dt=dt, shape=shape, noise_m=NOISE_M)


def video() -> bytes:
    """What a camera sees of the push."""
    view = View(width=810, height=430, middle_px=405.0, top_px=50.0, px_per_m=5000.0)
    images = list(film(pushed(), BLOCK, CLAMP_M, view).images())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 3.0, (view.width, view.height))
        for image in images:
            writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        writer.release()
        return path.read_bytes()


@functools.cache
def sponge_seen() -> RenderedVideo:
    """A sponge on a kitchen scale, which a hand presses with a block: what a phone sees, and what the scale shows."""
    return render(SPONGE)


def sponge() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sponge.mp4"
        encode(sponge_seen().frames, SPONGE.fps, path, SPONGE_MBIT)
        return path.read_bytes()


def sponge_force() -> bytes:
    return force_table(sponge_seen().log).encode()


def squeezes() -> bytes:
    """A table of simulated squeezes of boxes with five contents."""
    from deformscope.stages.squeeze.table import LabelledTable
    from studies.reproduce.container_trials import run_squeeze, squeeze_jobs

    jobs = squeeze_jobs(Path(), SQUEEZES, cylinders=0, whole=0, seed=0)
    with ProcessPoolExecutor() as workers:
        rows = [row for row in workers.map(run_squeeze, jobs) if row.entry.discarded is None]
    label, group, trial = (
        np.array([getattr(row.entry, name) for row in rows]) for name in ("content", "container", "trial")
    )
    widths = {name: next(len(row.features[name]) for row in rows if name in row.features) for name in SMALL}
    found = {
        name: np.stack([row.features.get(name, np.full(width, np.nan)) for row in rows]).astype(np.float32)
        for name, width in widths.items()
    }
    LabelledTable(label, group, found)  # raises where they do not fit together
    return arrays(label=label, group=group, trial=trial, **found)


def table() -> bytes:
    """The same squeezes as a CSV table, with the features of touch and of physics alone."""
    with np.load(FOLDER / "squeezes" / "squeezes.npz") as found:
        features = {name: found[name] for name in ("tactile", "physical")}
        head = [f"{name}.{column}" for name, values in features.items() for column in range(values.shape[1])]
        rows = zip(found["label"], found["group"], found["trial"], *(one for one in features.values()), strict=True)
        lines = [
            ",".join([*words, *("" if np.isnan(one) else f"{one:.5g}" for some in numbers for one in some)])
            for *words, in_touch, physical in rows
            for numbers in [(in_touch, physical)]
        ]
    return "\n".join([",".join(["label", "group", "trial", *head]), *lines, ""]).encode()


def seen(position: FloatArray, held: IntArray, noise_m: float) -> FloatArray:
    """Positions (K, d) [m] as seen with noise; those of held particles (n,) are exact."""
    noise = np.random.default_rng(0).normal(0.0, noise_m, position.shape)
    noise[held] = 0.0
    return position + noise


def arrays(**named: object) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **{name: np.asarray(one) for name, one in named.items()})
    return file.getvalue()


MAKE: dict[str, tuple[str, Callable[[], bytes]]] = {
    "pair": (".npz", pair),
    "cube": (".npz", cube),
    "poke": (".npz", poke),
    "press": (".npz", press_and_release),
    "video": (".mp4", video),
    "sponge": (".mp4", sponge),
    "squeezes": (".npz", squeezes),
    "table": (".csv", table),
}
BESIDE: dict[str, tuple[str, Callable[[], bytes]]] = {"sponge": ("force.csv", sponge_force)}


def main() -> None:
    for name in sys.argv[1:] or MAKE:
        suffix, make = MAKE[name]
        for file_name, content in ((f"{name}{suffix}", make), *([BESIDE[name]] if name in BESIDE else [])):
            path = FOLDER / name / file_name
            path.parent.mkdir(exist_ok=True)
            with replacing(path) as file:
                file.write(content())
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
