"""`python -m studies creep`: how far off a creeping foam's stiffness, relaxation and loss are, and how often held.

python -m studies creep
python -m studies creep --objects 400 --hold 4 --jobs 16 --json creep.json
python -m studies creep --objects 1 --laws 200

Touches of foams that creep, keep a dent or are slid over, in finite elements: are fit and verdict right?

Random quantities of each: hardness, thickness, Poisson's ratio, one or two branches that relax by RELAXES in all with
times of TIMES_S, and the deviation of the arm's compliance from its calibration. The truth of a stiffness is that of
the same slab pressed without memory, with its full and with its relaxed modulus; the truth of a loss that of the true
forces. Plastic foams creep too, and keep KEEPS of each dent. A tip with lateral motion during a press sticks, or slides
once its lateral force reaches a share of the sticking one.

In addition: foams of laws that the fit has and of laws that it does not have, by another generator (`creep_laws`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import numpy as np
from tyro.conf import arg

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.scene_lab import CreepingWorld, Relaxation
from deformscope.lab.scenes import Piece, Scene, initial_modulus_pa
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from deformscope.pictures.report import Table
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.poke.creep import CreepBehaviour, fit_creep
from studies.creep_laws import LawOutcome, law_cases, law_table, try_law
from studies.held_touch import HeldTouch, held_touch
from studies.quantities import KnownEstimate, by, counts, interval_rows, interval_table
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported
from studies.touching import Sensing, force_curve

RELAXES, TIMES_S = (0.1, 0.4), (0.2, 5.0)
HARDNESS_N, THICKNESS_M, POISSON = (40.0, 150.0), (0.035, 0.06), (0.05, 0.35)
TIP_M, SET_FORCE_N, DEEPEST_M = 0.01, 3.0, 0.02
QUANTITIES = (
    "instantaneous stiffness",
    "relaxed stiffness",
    "share that relaxes",
    "mean relaxation time",
    "energy loss",
    "share of the dent that stays",
)
CreepKind = Literal["viscous", "elastic", "plastic", "slipping", "sticking"]
KINDS: tuple[CreepKind, ...] = get_args(CreepKind)
KEEPS, LEANS, SLIDES_AT = (0.15, 0.4), (0.2, 0.6), (0.2, 0.7)
STUCK, ROUGH = 0.5, 2.0
"""Force across over along of a tip that sticks, for each lean; a friction that is never reached."""
UP = np.array([0.0, 0.0, 1.0])
ARM = ArmCompliance(1.0 / ARM_STIFFNESS_N_M, ARM_DOUBT / ARM_STIFFNESS_N_M)


@dataclass(frozen=True, slots=True)
class CreepCase:
    """A foam and a touch of it. hold_s: how long the force is held"""

    seed: int
    hold_s: float
    kind: CreepKind = "viscous"


def touched(case: CreepCase) -> tuple[HeldTouch, tuple[float, ...]]:
    """One foam's touch as it was made, and the truth (6,) of QUANTITIES (nan: there is none)."""
    random = np.random.default_rng([case.seed, KINDS.index(case.kind), 19])
    hardness = float(np.exp(random.uniform(*np.log(HARDNESS_N))))
    piece = Piece("foam", initial_modulus_pa(hardness))
    scene = Scene(
        "homogeneous", 0, (piece,), {}, thickness_m=random.uniform(*THICKNESS_M), poisson=random.uniform(*POISSON)
    )
    branches = int(random.integers(1, 3))
    shares = random.dirichlet([2.0] * branches) * random.uniform(*RELAXES)
    fastest, slowest = np.log(TIMES_S)
    times_s = np.exp(random.uniform(fastest, slowest, branches))
    relaxation = Relaxation(tuple(shares.tolist()), tuple(times_s.tolist()))
    if case.kind == "elastic":
        relaxation = Relaxation()
    off = max(1.0 + ARM_DOUBT * float(random.standard_normal()), 0.1)
    sensing, lean = Sensing(arm_n_per_m=ARM_STIFFNESS_N_M / off), 0.0
    if case.kind == "plastic":
        relaxation = replace(relaxation, keeps=random.uniform(*KEEPS))
    elif case.kind in ("slipping", "sticking"):
        lean = random.uniform(*LEANS)
        friction = ROUGH if case.kind == "sticking" else STUCK * lean * random.uniform(*SLIDES_AT)
        sensing = replace(sensing, friction=friction)
    tip, xy_m = RigidTip(radius=TIP_M), 0.5 * np.asarray(scene.size_m)
    made = held_touch(
        CreepingWorld(scene, relaxation),
        tip,
        xy_m,
        hold_s=case.hold_s,
        set_force_n=SET_FORCE_N,
        max_depth_m=DEEPEST_M,
        sensing=sensing,
        lean=lean,
        random=random,
    )
    rest = np.append(xy_m, scene.thickness_m + TIP_M)
    most_n = 1.1 * SET_FORCE_N / (1.0 - RELAXES[1]) / (1.0 - relaxation.keeps)
    depth_m, force_n = force_curve(SlabWorld(scene), tip, rest, UP, most_n, DEEPEST_M)
    at_once, relaxed = (
        1e-3 * SET_FORCE_N / float(np.interp(SET_FORCE_N / left, force_n, depth_m))
        for left in (1.0 - relaxation.keeps, (1.0 - relaxation.keeps) * (1.0 - relaxation.share))
    )
    mean_s = float(np.dot(relaxation.shares, relaxation.times_s) / relaxation.share) if relaxation.share else np.nan
    loss = true_loss(made.true_depth_m, made.true_force_n, made.held)
    return made, (at_once, relaxed, relaxation.share, mean_s, loss, relaxation.keeps)


def try_creep(case: CreepCase) -> KnownEstimate:
    """Touch one foam, and fit."""
    made, truth = touched(case)
    fit = fit_creep(
        made.time_s,
        made.position_m,
        made.force_n,
        UP,
        loading=made.loading,
        held=made.held,
        set_force_n=SET_FORCE_N,
        arm=ARM,
        radius_m=TIP_M,
    )
    nothing = (np.nan, np.nan)
    estimates = (
        (fit.instant_n_per_mm, fit.instant_interval),
        (fit.relaxed_n_per_mm or np.nan, fit.relaxed_interval or nothing),
        (fit.share, fit.share_interval),
        (fit.time_s or np.nan, fit.time_interval or nothing),
        (np.nan if fit.loss is None else fit.loss, fit.loss_interval or nothing),
        (np.nan if fit.kept is None else fit.kept, fit.kept_interval or nothing),
    )
    return KnownEstimate.of(case.kind, fit.verdict, truth, estimates)


def true_loss(depth_m: FloatArray, force_n: FloatArray, held: int) -> float:
    """Share of the work (n,) steps that the way back did not give again."""
    work = 0.5 * (force_n[1:] + force_n[:-1]) * np.diff(depth_m)
    taken = float(work[: held - 1].sum())
    return 1.0 + float(work[held - 1 :].sum()) / taken


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CreepCoverageConfig(StudyOptions):
    """Count how often the intervals of a creeping foam's stiffness, relaxation and energy loss hold the truth: touches
    of finite elements with a memory, and a quarter as many of foams without one."""

    objects: flags.ManyFlag = 60
    """Foams that creep, from seed SEED on; each takes some 5 s."""
    hold: Annotated[float, arg(metavar="S")] = 8.0
    """Duration of the force [s]."""

    laws: Annotated[int, flags.least(0)] = 60
    """Touches of each law of viscoelasticity, by hereditary integrals that share no code with the fit; each takes less
    than a second. Their seeds are 5000 and on."""

    def check(self) -> None:
        if not 0.5 <= self.hold <= 60.0:
            raise InputError("0.5 to 60 s after --hold", f"{self.hold:g}")


def trials(options: CreepCoverageConfig) -> list[Trials[Any, Any]]:
    """All foams, and a quarter as many of each other kind; and each law of viscoelasticity."""
    seeds = reported(options.objects, options.output.seed)
    few = seeds[: max(1, len(seeds) // 4)]
    cases = [CreepCase(seed, options.hold) for seed in seeds]
    cases += [CreepCase(seed, options.hold, kind) for kind in KINDS[1:] for seed in few]
    return [Trials("touches", try_creep, cases), Trials("laws", try_law, law_cases(options.laws))]


def report(
    options: CreepCoverageConfig, seconds: float, tried: Sequence[KnownEstimate], laws: Sequence[LawOutcome]
) -> StudyReport:
    """A table of each kind, and their verdicts."""
    kinds = by(tried, lambda one: one.kind)
    lines = {kind: interval_rows(some, QUANTITIES) for kind, some in kinds.items()}
    verdicts = {kind: counts(one.verdict for one in some) for kind, some in kinds.items()}
    tables = [
        interval_table(some, "touches", f"{kind} touches, held for {options.hold:g} s") for kind, some in lines.items()
    ]
    names = get_args(CreepBehaviour)
    taken = [(kind, *(some.get(name, 0) for name in names)) for kind, some in verdicts.items()]
    tables.append(Table(taken, ("touches of", *names), "verdicts by kind"))
    found = {"hold_s": options.hold, "rows": lines, "verdicts": verdicts}
    if laws:
        counted, found["laws"] = law_table(laws)
        tables.append(counted)
    return StudyReport(tables, found)


STUDY = Study(CreepCoverageConfig, trials, report)
