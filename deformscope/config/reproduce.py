"""Commands that evaluate this program: `deformscope reproduce ...` and `bench`."""

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
    """The thesis's experiment 3.A: theta of cubes of known Poisson's ratio, with figures 3.10 and 3.11 and table 3.2,
    and overlapping clusters compared with one cluster."""

    pairs: Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint=""), flags.Reads()] = ()
    """Cubes from pair files (.npz) with `nu`, instead of the thesis's 45 from finite elements."""
    out: flags.Folder = Path("runs/cubes")
    """Folder for the figures (PNG), tables (CSV) and cubes.json; existing files are replaced."""
    quick: bool = False
    """The 15 cubes of 6^3 particles alone."""
    method: Literal["sweep", "gradient"] = "sweep"
    """How theta is searched: all values at once (Thesis Algorithm 3), or downhill (Algorithm 2)."""
    cluster_size: flags.ClusterFlag = 2
    """Particles along each side of the overlapping clusters."""
    compare: Literal["deepest", "all", "none"] = "deepest"
    """Cubes for the fit of overlapping clusters: the deepest press of each kind, all, or none."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    workers: flags.SomeFlag = None
    """Processes; default: one per core."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        either("--pairs", "--quick", self.pairs, self.quick)


@dataclass(frozen=True, slots=True)
class ShapesConfig(RecordedOptions):
    """The effect of beta and theta on a body (figures 3.5, 3.7 and 3.13 of the thesis). --record or --viewer show
    static states on timelines of beta and theta. It takes some seconds."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class StudyOptions(RecordedOptions):
    """Options of every study."""

    jobs: flags.ManyFlag = 2
    """Number of parallel processes."""
    resume: Annotated[Path | None, flags.one_word("FILE", Path), flags.unset] = None
    """Store each outcome in this file, one line of JSON each. A later command of the same version reads them instead of
    computing the same cases again."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class PokesConfig(RecordedOptions):
    """Predict pokes of finite element slabs that were not fitted, and compare a rigid body, a half-space and linear
    finite elements."""

    out: flags.Folder = Path("runs/pokes")
    """Folder of dents.png and pokes.csv; made if missing. Existing files of these names are replaced."""
    quick: bool = False
    """Only the slab of one modulus."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class FoamsConfig(StudyOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. It takes about
    3 minutes on one core."""

    out: flags.Folder = Path("runs/foams")
    """Folder of the figures and of foams.csv; made if missing. Existing files of these names are replaced."""
    quick: bool = False
    """Only the softest and the firmest foam, with fewer images, in about 30 s."""
    keep_images: bool = False
    """Store the images in DIR/images, one folder per foam, in the form that `calibrate beta` reads."""


@dataclass(frozen=True, slots=True)
class Table41Config(RecordedOptions):
    """Thesis table 4.1 and further scenes: explore simulated tables over seeds, and report the maps' quality over the
    number of touches, for each planner. A touch takes about a second of one core: 20 seeds of all scenes take most of
    an hour."""

    out: flags.Folder = Path("runs/table41")
    """Folder for the table (CSV, JSON, PNG) and for each exploration (runs.jsonl); existing files are replaced."""
    scenes: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Scenes, as `deformscope explore --list-scenarios` lists them; default: all."""
    planners: Annotated[str, arg(metavar="NAME,NAME...")] = "regions"
    """Planners: regions, integrated-variance, max-variance, random-above. The first is compared with the others."""
    seeds: flags.ManyFlag = 20
    """Layouts of each scene, from seed 0 on."""
    touches: flags.ManyFlag = 12
    """Touches of each exploration."""
    closed_form: bool = False
    """Compute a touch's stiffness in closed form instead of pressing finite elements: no surface, no arm, much
    faster."""
    clean: bool = False
    """Simulate without hidden errors: the arm as calibrated, exact force, foam without scatter."""
    pace: Annotated[str, arg(metavar="NAME,NAME...")] = "careful"
    """Paces of `deformscope explore`: careful, quick; robot seconds are the time of the planned motions, computed step
    by step. The first pace is compared with the others."""
    resume: bool = False
    """Read the results of an earlier command from runs.jsonl, and continue; the version must be the same."""
    workers: flags.SomeFlag = None
    """Number of parallel processes; default: the cores of this machine."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class Chapter4Config(RecordedOptions):
    """Thesis chapter 4 by its own rules: figure 4.4 (input of the sweep of beta), 4.5 (beta over hardness, by held
    particles and cluster size), 4.6 (dents of foams) and 4.7 (fields of beta, isopleths, variance, truth). Table 4.1
    has the number of touches at Th. It takes about 15 minutes on two cores."""

    out: flags.Folder = Path("runs/chapter4")
    """Folder for the figures (PNG), tables (CSV) and chapter4.json; existing files are replaced."""
    seeds: flags.ManyFlag = 3
    """Layouts of each scenario, from seed 0 on; figure 4.7 shows the first."""
    beta_grid_m: BetaGridFlag = 0.005
    """Spacing of the particles, and of the places whose variance is evaluated [m]; default: the thesis's."""
    beta_step: BetaStepFlag = 0.01
    """Step of the sweep of beta, from 0 to below 1; default: the thesis's."""
    sigma_w_m: SigmaWFlag = 0.5
    """Width of the field's kernel [m], which determines the number of touches (`deformscope explore --help`)."""
    quick: bool = False
    """Only one foam and one scenario."""
    workers: flags.SomeFlag = None
    """Number of parallel processes; default: the cores of this machine."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure the cost of MSM on this machine, compared with NumPy. Ctrl-C ends it and prints the measurements so
    far."""

    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton if installed (deformscope[peers])."""
    quick: bool = False
    """Smaller and fewer cases, in about 20 s."""
    only: flags.CasesFlag = None
    """Measure only these, of step, call, memory, relax, sweep, theta, gradient, fit, surface and cold."""
    sizes: flags.SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: flags.SomeFlag = None
    """Rounds of every comparison; default: as many as fit into a few seconds, 9 at most."""
    against: flags.FileFlag = None
    """The JSON of an earlier bench: each row's time is compared with it."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: flags.JsonFlag = None
    """Write all results as JSON; with -, stdout is the JSON alone. An existing file is replaced."""


@dataclass(frozen=True, slots=True)
class ContainersConfig(RecordedOptions):
    """Thesis chapter 2 in the laboratory: squeeze boxes with five contents, evaluate touch, vision and both, and draw
    its figures, with its results for comparison. Trials in the folder are used again, so that an interrupted command
    continues."""

    out: flags.Folder = Path("runs/containers")
    """Folder of the data set (squeezes/) and of the reports (five/, three/); made if missing."""
    trials: Annotated[int, flags.least(20)] = 731
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 100
    """Additional squeezes of plastic cylinders, on which classifiers trained on boxes are tested."""
    whole: Annotated[int, flags.least(0)] = 20
    """Number of trials whose whole recordings are stored, at the camera's full rate."""
    quick: bool = False
    """At most 30 splits, without costly classifiers and learning curve."""
    workers: flags.SomeFlag = None
    """Number of parallel processes; default: the cores of this machine."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class SqueezesConfig(RecordedOptions):
    """Squeeze containers of the laboratory that `reproduce containers` does not have, and compare events, tracked poses
    and changes of depth with the simulated truth. Trials in the folder are used again."""

    out: flags.Folder = Path("runs/squeezes")
    """Folder of the data set (squeezes/), of each trial's errors (squeezes.jsonl) and of the figure; made if
    missing."""
    trials: Annotated[int, flags.least(1)] = 300
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: Annotated[int, flags.least(0)] = 0
    """Additional squeezes of plastic cylinders."""
    workers: flags.SomeFlag = None
    """Number of parallel processes; default: the cores of this machine."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)
