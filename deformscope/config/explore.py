"""`deformscope explore`: options of an exploration, and of the command."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import Flags, OutputOptions, RecordedOptions
from deformscope.errors import InputError

BetaModel = Literal["volume", "none"]
Feel = Literal["apparent", "relaxed"]
Goal = Literal["regions", "inclusions"]
Pace = Literal["careful", "quick"]
REGION_TOUCHES, INCLUSION_TOUCHES = 8, 30
"""Default number of touches."""
MOST_HOLD_S = 60.0
BORDER_M, LEAST_BORDER_M = 0.02, 0.01
"""No touch is made closer to the surface's edge, unless requested; the least distance at which the law of edges was
measured."""


@dataclass(frozen=True, slots=True)
class ExploreFlags(Flags):
    """Options of an exploration that have a flag; `experiments.explore.options.ExploreOptions` has all. `budget` and
    `beta_model` follow from the goal if they are None."""

    budget: Annotated[flags.SomeFlag, arg(name="touches")] = None
    """Largest number of touches, default 8, with --goal inclusions 30."""
    goal: Goal = "regions"
    """The goal: regions of one stiffness each, or inclusions below a homogeneous surface, stiffer or softer than the
    foam around them. Inclusions end when a missed one of --smallest-inclusion or more is less likely than 5 %."""
    threshold: float = 0.06
    """Variance, as a share of the variance before any touch, below which a place needs no touch (Th of the thesis)."""
    hold_s: Annotated[float, arg(name="hold", metavar="S")] = 0.0
    """Duration for which each touch holds its force [s]. The result then has creep: instantaneous and relaxed
    stiffness, relaxation time, and the energy that a touch loses. 8 s identify times of 0.2 to 5 s."""
    feel: Feel = "apparent"
    """The mapped quantity: stiffness during the approach. With --hold also the relaxed stiffness."""
    pace: Pace = "careful"
    """Speed of travel between touches. quick: after a first contact at the observed height, the tip crosses 2 cm above
    the highest obstacle. It slows down for the last 5 to 15 mm. It travels at the rig file's travel_speed_m_s, in the
    laboratory at 15 cm/s. careful: 5 cm above, slowly for the last 3 cm, in the laboratory at 5 cm/s."""
    border_m: Annotated[float, arg(name="border", metavar="M")] = BORDER_M
    """Least distance of a touch from the surface's edge [m], at least 0.01. Below 0.02 every touch is corrected for its
    distance from the foam's edge, which is assumed to be the surface's edge."""
    first_m: Annotated[flags.PlaceFlag, arg(name="first")] = None
    """Place of the first touch, in the surface frame [m]; default: the most informative place."""
    beta_model: BetaModel | None = None
    """Model that beta is fitted with. volume: layers below the surface (default); none: no beta."""

    def __post_init__(self) -> None:
        inclusions = self.goal == "inclusions"
        if self.budget is None:
            object.__setattr__(self, "budget", INCLUSION_TOUCHES if inclusions else REGION_TOUCHES)
        if self.beta_model is None:
            object.__setattr__(self, "beta_model", "none" if inclusions else "volume")
        Flags.__post_init__(self)

    def check(self) -> None:
        if not 0.0 <= self.threshold < float("inf"):
            raise InputError("a threshold of 0 or more", f"{self.threshold:g}")
        if not 0.0 <= self.hold_s <= MOST_HOLD_S:
            raise InputError(f"a hold of 0 to {MOST_HOLD_S:g} s", f"{self.hold_s:g} s")
        if self.feel == "relaxed" and not self.hold_s:
            raise InputError("a hold, from which the relaxed stiffness is measured", "none", "--hold 5")
        if not LEAST_BORDER_M <= self.border_m <= 0.1:
            raise InputError(f"a border of {LEAST_BORDER_M:g} to 0.1 m", f"{self.border_m:g} m")


@dataclass(frozen=True, slots=True)
class ExploreConfig(ExploreFlags, RecordedOptions):
    """Map the stiffness of a surface: look, touch the most informative place, update the map, repeat; then find
    regions. RIG is a rig file with an arm, a force sensor and a depth camera. The arm moves, after a table of checks
    and a question. lab:NAME is a simulated table, explored through the real drivers on byte-exact doubles. A recording
    of arm, force sensor and depth camera (.rrd), such as `import` makes from a bag, gives a map of its touches."""

    rig: flags.SceneFlag = ""
    """A rig file (.toml), a recording (.rrd), or a simulated scene; --list-scenarios names these."""
    list_scenarios: bool = False
    """List the simulated scenes, the random quantities of their seeds, and the faults; do nothing else."""
    smallest_inclusion_m: Annotated[flags.PositiveFlag, arg(name="smallest-inclusion")] = None
    """Radius of the smallest inclusions to find [m], default 0.06, with --goal inclusions 0.02. Touches end when an
    undetected one is less likely than 1 in 20, or after --touches."""
    set_force_n: Annotated[flags.ForceFlag, arg(name="set-force")] = None
    """Force of a touch [N], 5 N at most; default: the rig file's target_force_n, or 3 N. If the dent is below 2 mm, the
    touch presses with 5/3 of it (5 N at most)."""
    tangential: Literal["held", "free"] | None = None
    """During the press, hold the tip on the surface's normal, or let lateral forces move it, as chapter 4 does;
    default: what [touch] of the rig file has; in a simulated scene held."""
    dry_run: bool = False
    """Make the first touch 10 cm above the surface, without contact, and end."""
    fault: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="KIND@TOUCH", help_behavior_hint="(repeatable)")
    ] = ()
    """Inject a fault into a simulated touch, counted from 1, such as force-silent@2, at a random moment of the seed;
    --list-scenarios lists the kinds."""
    clean: bool = False
    """Simulate without hidden errors: the arm as calibrated, exact force, and foam without scatter. Otherwise these
    errors are drawn from the seed, as large as on a real table."""
    arm: Annotated[str, arg(metavar="DRIVER")] = ""
    """The arm of a simulated scene: the double of this driver of a rig file; default: an arm whose joints
    measure torques."""
    wrench: flags.WrenchFlag = None
    """Measure forces by the simulated arm's own report, with the errors in this file, in place of a force sensor:
    the lines that `deformscope calibrate wrench lab:NAME --arm DRIVER` prints."""
    camera: Literal["plain", "primesense", "realsense"] = "plain"
    """Error model of the simulated depth camera: noise alone, or disparity of a PrimeSense or a RealSense D435.
    Disparity has steps, bleeding edges, shadows, and no depth at grazing angles."""
    robot: Literal["plain", "gripper"] = "plain"
    """The robot in the images of a simulated scene: capsules, or the meshes of an arm whose gripper holds a stick and a
    hanging cable."""
    removal: Literal["capsules", "hull", "mesh"] | None = None
    """With --robot gripper: method that removes the robot from the images, default mesh. The rig file's key is
    [shape]."""
    corrected: bool = False
    """Take out what [certificate] of the rig file states about force gain, depth, tip, compliance and clock
    (`deformscope certify`)."""
    picture: flags.PictureFlag = None
    """Draw the maps to a PNG."""
    map: flags.ArraysFlag = None
    """Write the maps as arrays: stiffness [N/mm], standard deviation of its log, regions, their probability, beta."""
    paused: bool = False
    """With --viewer page: begin paused, and touch only on a request from the page."""
    page_timeout: flags.TimeoutFlag = 0.3
    """Stop a touch that the page requested after this time without a message from the page [s]; the exploration
    continues."""
    yes: bool = False
    """Let a real arm move without asking, once the checks have passed."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        ExploreFlags.check(self)
        if self.paused and self.output.viewer != "page":
            raise InputError("--paused with --viewer page", f"--viewer {self.output.viewer}", "--viewer page")
        if not self.rig and not self.list_scenarios:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope explore --list-scenarios")
        if self.arm and (not self.rig.startswith("lab:") or self.robot != "plain"):
            raise InputError("--arm with a simulated scene, and without --robot", self.rig, "lab:two-60-150")
        if self.wrench is not None and not self.rig.startswith("lab:"):
            raise InputError("--wrench with a simulated scene", self.rig, 'driver = "arm" in the rig file')
        if self.camera != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--camera with a simulated scene alone", f"{self.rig}", "lab:two-60-150")
        if self.robot != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--robot with a simulated scene alone", f"{self.rig}", "[shape] in a rig file")
        if self.removal is not None and self.robot == "plain":
            raise InputError("--removal with --robot gripper", "--robot plain", "--robot gripper")
