"""Table 4.1 without finite elements, camera and arm: hundreds of explorations in minutes.

A touch is the scene's stiffness (Hertz: the power 2/3 of its modulus), its mean over the contact, plus a fit's error
and the laboratory's hidden errors (`LabErrors`: scatter, gain and arm). A stiffness above the arm's resolution is a
lower bound. Posterior, planner and stop rule are those of `explore`."""

import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.scenes import Scene, built_in, initial_modulus_pa
from deformscope.lab.session_errors import LabErrors, SessionErrors
from deformscope.stages.map.plan import FieldKernel, PlanOptions, plan_touch
from deformscope.stages.poke.contact import RIGID_SDS, ArmCompliance
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import LAW_SD, MapGrid, StiffnessSample
from studies.map_score import Z_90, TrueMap, score_map
from studies.reproduce.table41_runs import MapAfter, TableJob, TableRun

FORCE_N = 3.0
FIT_SD = 0.012
"""Deviation of log stiffness: the depth's uncertainty in a fit to 3 N (sd .2 to 2.2 % of a sphere)."""
LOG_N_PER_MM_60 = float(np.log(0.55))
"""Stiffness of foam of 60 N at 3 N under a ball of 1 cm; others follow as the power 2/3 of their modulus (Hertz)."""
RIGID_LOG = float(
    np.log(1e-3 * FORCE_N / (RIGID_SDS * ArmCompliance(0.0, ARM_DOUBT / ARM_STIFFNESS_N_M).depth_sd_m(FORCE_N)))
)
"""Log stiffness [N/mm] from which a touch is a lower bound."""

MOST_LOG = RIGID_LOG + 0.1
"""Its effect is small next to softer material, where a part of the ball presses on its edge: finite elements show it up
to 4 mm outside the edge."""


def true_log_stiffness(modulus_pa: FloatArray) -> FloatArray:
    """(...,) log stiffness of places with these moduli [N/mm]."""
    return np.asarray(LOG_N_PER_MM_60 + 2.0 / 3.0 * np.log(modulus_pa / initial_modulus_pa(60.0)))


def run_closed_form(job: TableJob, prior: RegionPrior | None = None) -> TableRun:
    """Explore one scene. prior: prior of the estimator, None = as in `explore`"""
    began = time.perf_counter()
    scene, options = built_in(job.scene, job.seed), PlanOptions(budget=job.touches)
    truth, random = _truth(scene), np.random.default_rng([job.seed, 0xC10])
    errors = (LabErrors.none() if job.clean else LabErrors()).draw([job.seed, 0xC11])
    posterior = RegionPosterior.before_touches(MapGrid(scene.size_m), prior, seed=job.seed)
    after: list[MapAfter] = []
    stop_after, travel_m = None, 0.0
    with threadpool_limits(1):
        while True:
            start = time.perf_counter()
            choice = plan_touch(posterior, FieldKernel(), options)
            if after:
                spent = time.perf_counter() - start
                unseen = choice.missed.probability(options.inclusion_m)
                after[-1] = replace(after[-1], compute_s=after[-1].compute_s + spent, unseen=unseen)
                if choice.stop not in (None, "budget") and stop_after is None:
                    stop_after = len(after)
            enough = choice.stop is not None and not (job.go_on and len(after) < job.touches)
            if enough or choice.target_m is None:
                break
            travel_m += float(np.hypot(*(choice.target_m - (posterior.touches[-1].xy_m if after else np.zeros(2)))))
            felt = _felt(scene, choice.target_m, posterior.prior) + float(errors.scatter(choice.target_m))
            start = time.perf_counter()
            posterior = posterior.with_touch(_touch(choice.target_m, felt, errors, random))
            shown = posterior.region_map()
            touch = posterior.touches[-1]
            after.append(
                MapAfter(
                    touches=len(after) + 1,
                    travel_m=travel_m,
                    robot_s=travel_m / options.speed_m_s + (len(after) + 1) * options.touch_s,
                    compute_s=time.perf_counter() - start,
                    xy_m=(float(touch.xy_m[0]), float(touch.xy_m[1])),
                    log_stiffness=touch.log_stiffness,
                    log_sd=touch.log_sd,
                    rigid=touch.rigid,
                    felt_log_stiffness=felt,
                    touch_covered=None if touch.rigid else bool(abs(touch.log_stiffness - felt) <= Z_90 * touch.log_sd),
                    score=score_map(shown, truth),
                    probability=dict(shown.probability),
                )
            )
    return TableRun(job, scene.region_count, tuple(after), FORCE_N, stop_after, time.perf_counter() - began)


def _truth(scene: Scene) -> TrueMap:
    pieces = np.array([piece.modulus_pa for piece in scene.pieces])
    return TrueMap(
        labels=scene.regions,
        level=true_log_stiffness(pieces),
        rigid=np.array([piece.rigid for piece in scene.pieces], dtype=bool),
        log_stiffness=true_log_stiffness(scene.modulus_pa(scene.cells_m())),
    )


def _felt(scene: Scene, xy_m: FloatArray, prior: RegionPrior) -> float:
    """Log stiffness of a contact at (2,): the mean stiffness over a Gaussian (Gauss-Hermite quadrature)."""
    node, weight = np.polynomial.hermite_e.hermegauss(15)
    around = xy_m + prior.blur_m * np.stack(np.meshgrid(node, node), axis=-1)
    stiffness = np.exp(np.minimum(true_log_stiffness(scene.modulus_pa(around)), MOST_LOG))
    return float(np.log((np.outer(weight, weight) * stiffness).sum() / weight.sum() ** 2))


def _touch(xy_m: FloatArray, felt: float, errors: SessionErrors, random: np.random.Generator) -> StiffnessSample:
    sd, stiffness_n_m = float(np.hypot(LAW_SD, FIT_SD)), 1e3 * float(np.exp(felt))
    bent = stiffness_n_m * (1.0 / errors.arm_n_per_m - 1.0 / ARM_STIFFNESS_N_M)  # what is taken for a dent, over it
    value = felt + float(np.log(errors.gain)) - bent + sd * float(random.standard_normal())
    if value > RIGID_LOG:
        return StiffnessSample(xy_m, RIGID_LOG, RegionPrior().rigid_sd, rigid=True)
    return StiffnessSample(xy_m, value, sd, arm_sd=ARM_DOUBT * stiffness_n_m / ARM_STIFFNESS_N_M)
