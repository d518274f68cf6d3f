"""What measures ourselves: `deformscope reproduce ...` and `bench`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from deformscope.config import flags
from deformscope.config.executor import ExecutorOptions
from deformscope.config.explore import BetaGridFlag, BetaStepFlag, SigmaWFlag
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, ViewOptions, either


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
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        either("--pairs", "--quick", self.pairs, self.quick)


@dataclass(frozen=True, slots=True)
class ShapesConfig(RecordedOptions):
    """What beta and theta do to a body (figures 3.5, 3.7 and 3.13 of the thesis): with --record or --viewer, static
    states whose timelines are beta and theta, to be scrubbed. Some seconds."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class StudyOptions(RecordedOptions):
    """What every study's flags are."""

    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    resume: Annotated[Path | None, flags.one_word("FILE", Path), flags.unset] = None
    """Keep each outcome in this file as it comes, a line of JSON each; those of the same cases that an earlier command
    of this version left there are not computed again."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


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
class FoamsConfig(StudyOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. Some 3 minutes
    on one core."""

    out: flags.Folder = Path("runs/foams")
    """Folder of the figures and of foams.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The softest and the firmest foam alone, fewer images, in some 30 s."""
    keep_images: bool = False
    """Keep the images in DIR/images, a folder a foam, as `calibrate beta` takes them."""


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
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class Chapter4Config(RecordedOptions):
    """Thesis chapter 4 by its own rules: figure 4.4 (what the sweep of beta is given), 4.5 (beta over hardness, by how
    the model is held and the size of its clusters), 4.6 (dents of foams), 4.7 (fields of beta, isopleths, variance,
    truth) and table 4.1 with the number of touches at Th. Some 15 minutes on two cores."""

    out: flags.Folder = Path("runs/chapter4")
    """Folder for the figures (PNG), tables (CSV) and chapter4.json; files there are replaced."""
    seeds: flags.ManyFlag = 3
    """Layouts of each scenario, from seed 0 on; figure 4.7 shows the first."""
    beta_grid_m: BetaGridFlag = 0.005
    """How far apart the particles are, and the places whose variance is looked at [m]; default: the thesis's."""
    beta_step: BetaStepFlag = 0.01
    """Step of the sweep of beta, from 0 to below 1; default: the thesis's."""
    sigma_w_m: SigmaWFlag = 0.5
    """Width of the field's kernel [m], which makes the number of touches (`deformscope explore --help`)."""
    quick: bool = False
    """One foam and one scenario."""
    workers: flags.SomeFlag = None
    """Processes at once; default: the cores of this machine."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure what MSM costs on this machine, beside NumPy. Ctrl-C ends it and shows what has been measured."""

    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton where they are installed (deformscope[peers])."""
    quick: bool = False
    """Less of everything, in some 20 s."""
    only: flags.CasesFlag = None
    """Measure these alone, out of step, call, memory, relax, sweep, theta, gradient, fit, surface and cold."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: what fits into a few seconds, 9 at most."""
    against: flags.FileFlag = None
    """The JSON of an earlier bench: how each row's time compares with what it was then."""
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
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
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
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)
