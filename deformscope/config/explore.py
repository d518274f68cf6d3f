"""`deformscope explore`: how to explore, and what it is asked for beside that."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.options import Flags, OutputOptions, RecordedOptions
from deformscope.errors import InputError

BetaModel = Literal["volume", "thesis", "layers", "none"]
Detail = Literal["full", "lean"]
Feel = Literal["apparent", "relaxed", "loss"]
Goal = Literal["regions", "inclusions"]
Pace = Literal["careful", "quick"]
Planner = Literal["regions", "integrated-variance", "max-variance", "random-above", "thesis"]
Relief = Literal["seen", "stated"]
REGION_TOUCHES, INCLUSION_TOUCHES = 8, 30
"""At most, unless asked for otherwise."""
MOST_HOLD_S = 60.0
BORDER_M, LEAST_BORDER_M = 0.02, 0.01
"""No touch is made so near the surface's edge, unless it is asked for; from where on an edge's law was measured."""
_GRID = flags.Rule(lambda grid: 0.002 <= grid <= 0.02, "a {flag} of 0.002 to 0.02 m")
BetaGridFlag = Annotated[float, arg(name="beta-grid", metavar="M"), _GRID]
BetaStepFlag = Annotated[float, flags.Rule(lambda step: 0.001 <= step <= 0.5, "a {flag} of 0.001 to 0.5")]
_WIDTH = flags.Rule(lambda width: 0.05 <= width <= 10.0, "a {flag} of 0.05 to 10 m")
SigmaWFlag = Annotated[float, arg(name="sigma-w", metavar="M"), _WIDTH]


@dataclass(frozen=True, slots=True)
class ExploreFlags(Flags):
    """How to explore, as far as it can be asked for; `deformscope.experiments.options.ExploreOptions` is all of it.
    What is None and follows from goal and planner is put in its place: `budget`, `beta_model`."""

    budget: Annotated[flags.SomeFlag, arg(name="touches")] = None
    """Touches at most, default 8, with --goal inclusions 30."""
    goal: Goal = "regions"
    """What is sought: regions of one stiffness each, or inclusions below a surface that shows nothing, stiffer or
    softer than the foam around them; touched is until one of --smallest-inclusion or more is missed with less than
    5 %."""
    planner: Planner = "regions"
    """Where to touch next: where the map of regions gains most a second (default), three rules by the field's
    variance, or all of chapter 4 as the thesis has it: its field of beta, from --first (default: a preset place), any
    place above --threshold until none is, and regions along isopleths."""
    threshold: float = 0.06
    """Variance, as a share of that before any touch, below which a place needs no touch (Th of the thesis)."""
    hold_s: Annotated[float, arg(name="hold", metavar="S")] = 0.0
    """Hold the force of each touch for so long [s], and report how the foam creeps: stiffness at once and relaxed,
    relaxation time, energy that a touch loses. 8 s tell times of 0.2 to 5 s."""
    feel: Feel = "apparent"
    """What is mapped: stiffness as each touch comes down, or, with --hold, when all has relaxed; or, with --hold, the
    share of its energy that a touch loses, stiffness beside it."""
    pace: Pace = "careful"
    """quick: once a touch has met the surface where it was seen, the tip crosses it 2 cm above all that it passes, and
    slows down where the surface may be, in the last 5 to 15 mm; it travels at the rig file's travel_speed_m_s, in the
    laboratory at 15 cm/s. careful: 5 cm above it, the last 3 cm slowly, in the laboratory at 5 cm/s."""
    relief: Relief = "seen"
    """Where the surface is uneven, compare touches by how thick and how curved the foam was seen to be at each (its
    table is at z = 0), so that they compare by modulus; or take it for level and as thick as stated."""
    border_m: Annotated[float, arg(name="border", metavar="M")] = BORDER_M
    """No touch is made so near the surface's edge [m], 0.01 at least. Below 0.02 every touch is corrected for how far
    it is from where the foam ends, which is taken to be where the surface does."""
    first_m: Annotated[flags.PlaceFlag, arg(name="first")] = None
    """Where to touch first, in the surface frame [m]; default: where it says most."""
    beta_model: BetaModel | None = None
    """What beta is fitted with: layers below the surface (volume, default), the thesis's sweep with one held particle
    of a single layer (thesis, default of --planner thesis) or of layers, or none."""
    beta_grid_m: BetaGridFlag = 0.005
    """How far apart the particles of the thesis's sweep are, and with --planner thesis the places whose variance is
    looked at [m]; the thesis's own is the default."""
    beta_step: BetaStepFlag = 0.01
    """Step of the thesis's sweep of beta, from 0 to below 1; the thesis's own is the default."""
    sigma_w_m: SigmaWFlag = 0.5
    """Width of the kernel of --planner thesis [m]. With --threshold it alone decides how many touches are made, n of
    table 4.1, whatever they find. The thesis does not print it; the default is such that 60 x 40 cm of one foam take
    its 3 touches."""
    detail: Detail = "full"
    """What a recording has beside devices, estimates and maps. full: also which pixels were used, and by which rule the
    others were removed, the surface under each touch, the error over beta, what was trained with what weight, force
    and pose at the force's rate, frames and maps in space. lean: none of these."""

    def __post_init__(self) -> None:
        inclusions = self.goal == "inclusions"
        if self.budget is None:
            object.__setattr__(self, "budget", INCLUSION_TOUCHES if inclusions else REGION_TOUCHES)
        if self.beta_model is None:
            model = "none" if inclusions else "thesis" if self.planner == "thesis" else "volume"
            object.__setattr__(self, "beta_model", model)
        Flags.__post_init__(self)

    def check(self) -> None:
        if not 0.0 <= self.threshold < float("inf"):
            raise InputError("a threshold of 0 or more", f"{self.threshold:g}")
        if not 0.0 <= self.hold_s <= MOST_HOLD_S:
            raise InputError(f"a hold of 0 to {MOST_HOLD_S:g} s", f"{self.hold_s:g} s")
        if self.feel != "apparent" and not self.hold_s:
            what = "relaxed stiffness" if self.feel == "relaxed" else "energy loss"
            raise InputError(f"a hold, from which the {what} is measured", "none", "--hold 5")
        if self.feel == "loss" and self.planner == "thesis":
            raise InputError("a planner whose regions are not those of beta", "thesis", "--planner regions")
        if self.goal == "inclusions" and self.feel == "loss":
            raise InputError("inclusions that are felt by their stiffness", "--feel loss", "--goal regions")
        if self.goal == "inclusions" and self.planner != "regions":
            raise InputError("the planner of --goal inclusions", f"--planner {self.planner}", "leave --planner out")
        if not LEAST_BORDER_M <= self.border_m <= 0.1:
            raise InputError(f"a border of {LEAST_BORDER_M:g} to 0.1 m", f"{self.border_m:g} m")
        if self.planner == "thesis" and self.beta_model == "none":
            raise InputError("a beta model for the thesis's planner", "none", "--beta-model thesis")


@dataclass(frozen=True, slots=True)
class ExploreConfig(ExploreFlags, RecordedOptions):
    """Map how soft a surface is, and where: look, touch where it adds most to the map, map, again; regions in the end.
    RIG is a rig file with an arm, a force sensor and a depth camera: the arm moves, after a table of checks and a
    question. lab:NAME is a simulated table, explored through the real drivers on byte-exact doubles. Of a recording of
    arm, force sensor and depth camera (.rrd), as `import` makes of a bag, the touches that it holds are mapped."""

    rig: flags.SceneFlag = ""
    """A rig file (.toml), a recording (.rrd), or a simulated scene; --list-scenarios names these."""
    list_scenarios: bool = False
    """Name the simulated scenes, what their seeds draw, and what can go wrong in them; do nothing else."""
    smallest_inclusion_m: Annotated[flags.PositiveFlag, arg(name="smallest-inclusion")] = None
    """Radius of the smallest inclusions that are sought [m], default 0.06, with --goal inclusions 0.02: touched is
    until one that is there unseen is less likely than 1 in 20, or --touches are made."""
    set_force_n: Annotated[flags.ForceFlag, arg(name="set-force")] = None
    """Force to press with [N], 5 N at most; default: the rig file's target_force_n, which is 3 N unless it says. Where
    it makes a dent below 2 mm, 5/3 of it (5 N at most) is pressed with."""
    tangential: Literal["held", "free"] | None = None
    """While it presses, hold the tip on the surface's normal, or let it follow forces across it, as chapter 4 does;
    default: as [touch] of the rig file says, in a simulated scene held, with --planner thesis free."""
    dry_run: bool = False
    """Make the first touch 10 cm above the surface, where nothing is met, and end."""
    fault: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="KIND@TOUCH", help_behavior_hint="(repeatable)")
    ] = ()
    """Let something go wrong in a simulated touch, counted from 1, such as force-silent@2, at a moment drawn from the
    seed; --list-scenarios names the kinds."""
    clean: bool = False
    """Keep nothing from the estimator in a simulated scene: the arm is as its calibration says, the force exact, and
    foam without scatter. Else these are drawn from the seed, as they would be on a table."""
    camera: Literal["plain", "primesense", "realsense"] = "plain"
    """What the camera of a simulated scene measures by: noise alone, or disparity as a PrimeSense or a RealSense D435
    has it, with its steps, edges that bleed, shadows beside them, and no depth where a surface is seen flat."""
    robot: Literal["plain", "gripper"] = "plain"
    """What the camera of a simulated scene sees of the robot: capsules, or the meshes of an arm whose gripper holds a
    stick, and a cable that hangs."""
    removal: Literal["capsules", "hull", "mesh"] | None = None
    """With --robot gripper: how that is taken out of the pictures, default mesh. A rig file says it in [shape]."""
    picture: flags.PictureFlag = None
    """Draw the maps to a PNG."""
    map: flags.ArraysFlag = None
    """Write the maps as arrays: stiffness [N/mm], its deviation (of its log), regions, their probability, beta."""
    paused: bool = False
    """With --viewer page: begin paused, and touch only where somebody says so on the page."""
    page_timeout: flags.TimeoutFlag = 0.3
    """Stop a touch that was asked for on the page where the page is not heard of for so long [s]; exploring goes on."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        ExploreFlags.check(self)
        if self.paused and self.output.viewer != "page":
            raise InputError("--paused with --viewer page", f"--viewer {self.output.viewer}", "--viewer page")
        if not self.rig and not self.list_scenarios:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope explore --list-scenarios")
        if self.camera != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--camera with a simulated scene alone", f"{self.rig}", "lab:two-60-150")
        if self.robot != "plain" and not self.rig.startswith("lab:"):
            raise InputError("--robot with a simulated scene alone", f"{self.rig}", "[shape] in a rig file")
        if self.removal is not None and self.robot == "plain":
            raise InputError("--removal with --robot gripper", "--robot plain", "--robot gripper")
