"""What measures ourselves: `deformscope reproduce ...`, `coverage` and `bench`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, ViewOptions, either
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class CubesConfig(RecordedOptions):
    """The thesis's experiment 3.A: theta of cubes of known Poisson's ratio, with figures 3.10 and 3.11, table 3.2, and
    overlapping clusters beside one cluster."""

    pairs: Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint=""), flags.Reads()] = ()
    """Cubes from pair files (.npz) with `nu`, instead of the thesis's 45 made with finite elements."""
    out: flags.Folder = Path("runs/cubes")
    """Folder for the figures (PNG), tables (CSV) and cubes.json; files there are replaced."""
    quick: bool = False
    """The 15 cubes of 6^3 particles alone."""
    method: Literal["sweep", "gradient"] = "sweep"
    """How theta is searched: all values at once (Thesis Algorithm 3), or downhill (Algorithm 2)."""
    cluster_size: flags.ClusterFlag = 2
    """Particles along each side of the overlapping clusters."""
    compare: Literal["deepest", "all", "none"] = "deepest"
    """Cubes that overlapping clusters are fitted to: the deepest pressed of each kind, all, or none."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    workers: flags.SomeFlag = None
    """Processes; default: one a core."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        either("--pairs", "--quick", self.pairs, self.quick)


@dataclass(frozen=True, slots=True)
class PokesConfig(RecordedOptions):
    """Pokes of finite element slabs that were not fitted, predicted and compared with a rigid body, a half-space and
    linear finite elements."""

    out: flags.Folder = Path("runs/pokes")
    """Folder of dents.png and pokes.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The slab of one modulus alone."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class FoamsConfig(RecordedOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. Some 3 minutes
    on one core."""

    out: flags.Folder = Path("runs/foams")
    """Folder of the figures and of foams.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The softest and the firmest foam alone, fewer images, in some 30 s."""
    keep_images: bool = False
    """Keep the images in DIR/images, a folder a foam, as `calibrate beta` takes them."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class CoverageConfig(RecordedOptions):
    """Count how often the intervals hold the truth: random objects under each kind of noise, data without information,
    and unseen pokes of finite element bodies."""

    objects: Annotated[int, flags.least(5)] = 1000
    """Random objects for each kind of noise; a fifth as many with beta = 0, near 1, of finite elements, and for each
    kind of data that are wrong."""
    quick: bool = False
    """15 objects each: what it looks like, in a minute."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    out: Annotated[Path | None, flags.one_word("DIR", Path), flags.unset] = None
    """Folder for the rank histogram (coverage.png); made where there is none."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError("a folder after --out", "a file", where=self.out)


@dataclass(frozen=True, slots=True)
class DisturbedCoverageConfig(RecordedOptions):
    """Count how often the intervals hold the truth where data are not as assumed: errors that neighbours share over 1
    to 6 cells, with and without white noise, outliers, lost tracks, a held particle that is off, whole motions."""

    objects: Annotated[int, flags.least(3)] = 400
    """Random objects for each kind of error, a third of them in space; each takes some .3 s of a core."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These kinds alone, such as "30 % outliers,30 % lost tracks"; parts of their names do."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class RegionCoverageConfig(RecordedOptions):
    """Count how often a map's levels lie in their intervals, and its number of regions is right: surfaces of known
    truth, drawn from the stated prior and from violations of it, touched in closed form and explored as `explore`
    does."""

    objects: Annotated[int, flags.least(5)] = 300
    """Explorations of each condition; each takes some 5 s of a core."""
    scatter: Annotated[float | None, arg(metavar="SHARE")] = None
    """One more condition: foam whose log stiffness scatters by this, such as 0.08."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These conditions alone, such as "stated prior,scatter 6 %"."""
    touches: flags.ManyFlag = 8
    """Touches of each exploration at most."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.scatter is not None and not 0.0 < self.scatter < 1.0:
            raise InputError("a share above 0 and below 1 after --scatter", f"{self.scatter:g}", "0.08")


@dataclass(frozen=True, slots=True)
class SafetyCoverageConfig(RecordedOptions):
    """Count whether a simulated arm stands in time when things go wrong, of all kinds in turn, how long and how far it
    takes to stand, and how far it stays from joint limits and singularities on random layouts of arm and table."""

    arm: Literal["jaco", "kuka"] = "jaco"
    """Whose faults: jaco = all kinds, or kuka = answers that end while the arm moves, of controllers with HOLDON 0 and
    1; 500 faults are 50 of each."""
    faults: Annotated[int, flags.least(0)] = 1000
    """Faults; each takes some 2 s of a core. 0 = none."""
    layouts: Annotated[int, flags.least(0)] = 200
    """Layouts; each takes some 5 s of a core. 0 = none."""
    rigid: Annotated[int, flags.least(0)] = 88
    """Touches of a rigid surface by a force sensor that is wrong; each takes some 4 s of a core. 0 = none."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class RemovalCoverageConfig(RecordedOptions):
    """Count which points of simulated pictures stay, of foam and of a robot with gripper, stick and cable, by how the
    robot is taken out: capsules, convex hulls (Thesis 4.4) or meshes; with the camera's place exact, and off by 5 mm
    and 1 degree."""

    layouts: flags.ManyFlag = 6
    """Robots, from seed SEED on; of each, six pictures. One takes some 30 s of a core."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    picture: flags.PictureFlag = None
    """Draw what was removed of the first robot's pictures to a PNG."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


SlabKindFlag = Literal["one material", "halves", "stiff disc", "soft disc", "gradual"]


@dataclass(frozen=True, slots=True)
class ForceCoverageConfig(RecordedOptions):
    """Count how often the intervals of a predicted force hold the true one: random slabs of one material, halves, stiff
    and soft discs and gradual ones, half of whose 24 pokes are fitted, under scatter that the model is not given."""

    slabs: flags.ManyFlag = 20
    """Slabs of each kind, from seed SEED on. A slab takes some 3 s."""
    kinds: Annotated[tuple[SlabKindFlag, ...], arg(metavar="KIND...")] = ()
    """Of slabs; default all."""
    scatter: Annotated[tuple[float, ...], arg(metavar="SHARE...")] = (0.0, 0.03, 0.06, 0.1)
    """By how much the force scatters from poke to poke, as a share."""
    full: bool = False
    """Press the slabs with finite elements and fit shape-matching models to what their surfaces do: some minutes a
    slab."""
    out: Annotated[Path | None, flags.one_word("DIR", Path), flags.unset] = None
    """Folder of a file for each slab, written as it comes; a slab whose file is there is not tried again."""
    split: Literal["alternate", "random"] = "alternate"
    """Which half is fitted: every other poke, as on a chess board, or any half."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if not self.scatter or any(not 0.0 <= one < 1.0 for one in self.scatter):
            raise InputError("shares from 0 to below 1 after --scatter", " ".join(f"{one:g}" for one in self.scatter))


@dataclass(frozen=True, slots=True)
class CreepCoverageConfig(RecordedOptions):
    """Count how often the intervals of a creeping foam's stiffness, relaxation and energy loss hold the truth: touches
    of finite elements with a memory, a quarter as many of foams without one."""

    objects: flags.ManyFlag = 60
    """Foams that creep, from seed SEED on; each takes some 5 s."""
    hold: Annotated[float, arg(metavar="S")] = 8.0
    """How long the force is held [s]."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if not 0.5 <= self.hold <= 60.0:
            raise InputError("0.5 to 60 s after --hold", f"{self.hold:g}")


@dataclass(frozen=True, slots=True)
class MaterialsCoverageConfig(RecordedOptions):
    """Count how often the intervals of `calibrate axes`, `yield` and `viscous` hold the truth: deformations and motions
    of known materials, under noise that neighbours share."""

    kinds: Annotated[tuple[Literal["axes", "yield", "viscous"], ...], arg(metavar="NAME...")] = ()
    """Of axes, yield and viscous; default: all."""
    objects: flags.ManyFlag = 12
    """Motions of each kind, from seed SEED on; one to yield takes some 5 s, another less than one."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class LumpCoverageConfig(RecordedOptions):
    """Count how many lumps `explore --goal inclusions` finds within how many touches, how often it finds one where
    there is none, and whether what it says of missed ones is right: fields of 20 by 20 cm of finite elements, with a
    lump of 2 cm radius 1 to 2 cm deep and without."""

    objects: flags.ManyFlag = 40
    """Fields with a lump, and as many without, from seed SEED on; each takes some 25 s."""
    touches: flags.ManyFlag = 30
    """Touches at most."""
    foam: Annotated[str, arg(metavar="N")] = "60"
    """Hardness of the foam [N]."""
    lump: Annotated[str, arg(metavar="N|rigid")] = "600"
    """Hardness of the lump [N]."""
    smallest_lump_cm: Annotated[float, arg(metavar="CM")] = 2.0
    """Radius of the smallest lump that must not be missed [cm]."""
    set_force: Annotated[float, arg(metavar="N")] = 5.0
    """Force to press with [N]."""
    errors: bool = False
    """With all errors of the laboratory, foam that scatters among them; else nothing is kept from the estimator."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class FieldCoverageConfig(RecordedOptions):
    """Count how often `calibrate field` finds materials, their border and their ratio: plates and slabs of finite
    elements, under noise that neighbours share."""

    kinds: Annotated[tuple[str, ...], arg(metavar="NAME...")] = ()
    """Bodies by name, as the table has them; default: all."""
    objects: flags.ManyFlag = 6
    """Bodies of each kind, from seed SEED on; a plate takes some 5 s, a slab 30."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class Table41Config(RecordedOptions):
    """Thesis table 4.1 and scenes beyond it: explore simulated tables over seeds, and report how good the maps are
    after how many touches, planner beside planner. A touch takes about a second of a core: 20 seeds of all scenes take
    most of an hour."""

    out: flags.Folder = Path("runs/table41")
    """Folder for the table (CSV, JSON, PNG) and for each exploration (runs.jsonl); files there are replaced."""
    scenes: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Scenes, as `deformscope explore --list-scenarios` names them; default: all."""
    planners: Annotated[str, arg(metavar="NAME,NAME...")] = "regions"
    """Planners: regions, integrated-variance, max-variance, random-above. The first is compared with the others."""
    seeds: flags.ManyFlag = 20
    """Layouts of each scene, from seed 0 on."""
    touches: flags.ManyFlag = 12
    """Touches of each exploration."""
    closed_form: bool = False
    """Take what a contact feels in closed form instead of pressing finite elements: no surface, no arm, far faster."""
    clean: bool = False
    """Keep nothing from the estimator: the arm is as its calibration says, the force exact, foam without scatter."""
    relief: Literal["seen", "stated"] = "seen"
    """Take the foam as thick and as curved as it is seen, or as level and as thick as stated (finite elements only)."""
    pace: Annotated[str, arg(metavar="NAME,NAME...")] = "careful"
    """As of `deformscope explore`: careful, quick; robot seconds are those of its plans, travelled and touched step by
    step. The first is compared with the others."""
    resume: bool = False
    """Take what an earlier command left in runs.jsonl, and go on from there; it must have been this version."""
    workers: flags.SomeFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class Chapter4Config(RecordedOptions):
    """Thesis chapter 4 by its own rules: figure 4.5 (beta over hardness, by how the model is held and the size of its
    clusters), 4.6 (dents of foams), 4.7 (fields of beta, isopleths, variance, truth) and table 4.1 with the number of
    touches at Th. Some 10 minutes on two cores."""

    out: flags.Folder = Path("runs/chapter4")
    """Folder for the figures (PNG), tables (CSV) and chapter4.json; files there are replaced."""
    seeds: flags.ManyFlag = 3
    """Layouts of each scenario, from seed 0 on; figure 4.7 shows the first."""
    quick: bool = False
    """One foam and one scenario."""
    workers: flags.SomeFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure what MSM costs on this machine, beside NumPy. Ctrl-C ends it and shows what has been measured."""

    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton where they are installed (deformscope[peers])."""
    quick: bool = False
    """Less of everything, in some 20 s."""
    only: flags.CasesFlag = None
    """Measure these alone, out of step, memory, relax, sweep, theta, gradient, fit and cold."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: what fits into a few seconds, 9 at most."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: flags.JsonFlag = None
    """Write all of it as JSON; with -, stdout is the JSON alone. An existing file is replaced."""


@dataclass(frozen=True, slots=True)
class ContainersConfig(RecordedOptions):
    """Thesis chapter 2 in the laboratory: squeeze boxes with five contents, evaluate touch, vision and both, and draw
    its figures, with its statements beside ours. Trials that the folder has already are taken from there, so that a
    command that was cut off goes on."""

    out: flags.Folder = Path("runs/containers")
    """Folder of the data set (squeezes/) and of the reports (five/, three/); made where it is not there."""
    trials: Annotated[int, flags.least(20)] = 731
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 100
    """Squeezes of plastic cylinders besides, on which what was learned from boxes is tested."""
    whole: Annotated[int, flags.least(0)] = 20
    """Trials whose whole recordings are kept, at the camera's full rate."""
    quick: bool = False
    """At most 30 splits, and neither costly classifiers nor a learning curve."""
    workers: flags.SomeFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class SqueezesConfig(RecordedOptions):
    """Squeeze containers of the laboratory that `reproduce containers` does not have, and compare events, tracked poses
    and changes of depth with what was simulated. Trials that the folder has already are taken from there."""

    out: flags.Folder = Path("runs/squeezes")
    """Folder of the data set (squeezes/), of each trial's errors (squeezes.jsonl) and of the figure; made where it is
    not there."""
    trials: Annotated[int, flags.least(1)] = 300
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 0
    """Squeezes of plastic cylinders besides."""
    workers: flags.SomeFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)
