"""`deformscope reproduce ...` and `deformscope coverage`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from deformscope.config.flags import CountFlag, one_word, unset
from deformscope.config.options import (
    OutputOptions,
    RecordedOptions,
    ViewOptions,
    check_cluster_size,
    check_level,
)
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class CubesConfig(RecordedOptions):
    """The thesis's experiment 3.A: theta of cubes of known Poisson's ratio, with figures 3.10 and 3.11, table 3.2, and
    overlapping clusters beside one cluster."""

    pairs: Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint="")] = ()
    """Cubes from pair files (.npz) with `nu`, instead of the thesis's 45 made with finite elements."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/cubes")
    """Folder for the figures (PNG), tables (CSV) and cubes.json; files there are replaced."""
    quick: bool = False
    """The 15 cubes of 6^3 particles alone."""
    method: Literal["sweep", "gradient"] = "sweep"
    """How theta is searched: all values at once (Thesis Algorithm 3), or downhill (Algorithm 2)."""
    cluster_size: int = 2
    """Particles along each side of the overlapping clusters."""
    compare: Literal["deepest", "all", "none"] = "deepest"
    """Cubes that overlapping clusters are fitted to: the deepest pressed of each kind, all, or none."""
    level: float = 0.9
    """Confidence level of the intervals."""
    workers: CountFlag = None
    """Processes; default: one a core."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if self.pairs and self.quick:
            raise InputError("--pairs or --quick", "both", "leave one out")
        check_cluster_size(self.cluster_size)
        check_level(self.level)
        if self.workers is not None and self.workers < 1:
            raise InputError("--workers of 1 or more", str(self.workers))

    def reads(self) -> tuple[str, ...]:
        return tuple(str(path) for path in self.pairs)


# deformscope reproduce pokes -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PokesConfig(RecordedOptions):
    """Pokes of finite element slabs that were not fitted, predicted and compared with a rigid body, a half-space and
    linear finite elements."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/pokes")
    """Folder of dents.png and pokes.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The slab of one modulus alone."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


# deformscope reproduce foams -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoamsConfig(RecordedOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. Some 3 minutes
    on one core."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/foams")
    """Folder of the figures and of foams.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The softest and the firmest foam alone, fewer images, in some 30 s."""
    keep_images: bool = False
    """Keep the images in DIR/images, a folder a foam, as `calibrate beta` takes them."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


# deformscope coverage ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CoverageConfig(RecordedOptions):
    """Count how often the intervals hold the truth: random objects under each kind of noise, data without information,
    and unseen pokes of finite element bodies."""

    objects: int = 1000
    """Random objects for each kind of noise; a fifth as many with beta = 0, near 1, and of finite elements."""
    quick: bool = False
    """15 objects each: what it looks like, in a minute."""
    level: float = 0.9
    """Confidence level of the intervals."""
    jobs: int = 2
    """Processes that share the work."""
    out: Annotated[Path | None, one_word("DIR", Path), unset] = None
    """Folder for the rank histogram (coverage.png); made where there is none."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if self.objects < 5:
            raise InputError("5 --objects or more", str(self.objects))
        check_level(self.level)
        if self.jobs < 1:
            raise InputError("--jobs of 1 or more", str(self.jobs))
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError("a folder after --out", "a file", where=self.out)


@dataclass(frozen=True, slots=True)
class Table41Config(RecordedOptions):
    """Thesis table 4.1 and scenes beyond it: explore simulated tables over seeds, and report how good the maps are
    after how many touches, planner beside planner. A touch takes about a second of a core: 20 seeds of all scenes take
    most of an hour."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/table41")
    """Folder for the table (CSV, JSON, PNG) and for each exploration (runs.jsonl); files there are replaced."""
    scenes: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """Scenes, as `deformscope explore --list-scenarios` names them; default: all."""
    planners: Annotated[str, arg(metavar="NAME,NAME...")] = "regions"
    """Planners: regions, integrated-variance, max-variance, random-above. The first is compared with the others."""
    seeds: int = 20
    """Layouts of each scene, from seed 0 on."""
    touches: int = 12
    """Touches of each exploration."""
    resume: bool = False
    """Take what an earlier command left in runs.jsonl, and go on from there; it must have been this version."""
    workers: CountFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.touches < 1:
            raise InputError("--seeds and --touches of 1 or more", f"{self.seeds} and {self.touches}")
        if self.workers is not None and self.workers < 1:
            raise InputError("--workers of 1 or more", str(self.workers))


@dataclass(frozen=True, slots=True)
class ContainersConfig(RecordedOptions):
    """Thesis chapter 2 in the laboratory: squeeze boxes with five contents, evaluate touch, vision and both, and draw
    its figures, with its statements beside ours. Trials that the folder has already are taken from there, so that a
    command that was cut off goes on."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/containers")
    """Folder of the data set (squeezes/) and of the reports (five/, three/); made where it is not there."""
    trials: int = 731
    """Squeezes of cardboard boxes, in the thesis's proportions."""
    cylinders: int = 100
    """Squeezes of plastic cylinders besides, on which what was learned from boxes is tested."""
    whole: int = 20
    """Trials whose whole recordings are kept, at the camera's full rate."""
    quick: bool = False
    """At most 30 splits, and neither costly classifiers nor a learning curve."""
    workers: CountFlag = None
    """Processes at once; default: the cores of this machine."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if self.trials < 20 or min(self.cylinders, self.whole) < 0:
            raise InputError("--trials of 20 or more, --cylinders and --whole of 0 or more", f"{self.trials}")
        if self.workers is not None and self.workers < 1:
            raise InputError("--workers of 1 or more", str(self.workers))
