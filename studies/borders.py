"""`python -m studies borders`: loss of maps by an unknown kind of border, relative to an oracle that has it.

python -m studies borders
python -m studies borders --scenes ring --touches 12 --objects 8

Both touch the same scenes of the clean laboratory in closed form, each by its own plan. The oracle's prior has curves
of the true family alone; all else is unknown to it too. No estimator can be expected to do better with as many touches.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from tyro.conf import arg

from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.partitions import Family
from studies.quantities import Rate, by, of_cases
from studies.reproduce.closed_form_table import run_closed_form
from studies.reproduce.table41_runs import TableJob
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import reported

FAMILIES = {
    "two-60-150": Family.SQUARE_LINE,
    "two-110-150": Family.SQUARE_LINE,
    "wavy": Family.SQUARE_LINE,
    "disc": Family.BLOB,
    "zigzag": Family.ZIGZAG,
    "ring": Family.RING,
}
"""Kind of each scene's border; lines may be straight or waves."""

GOOD = 0.85


@dataclass(frozen=True, slots=True)
class BorderOutcome:
    """One exploration. oracle: with the true family; right: the number of regions is"""

    scene: str
    seed: int
    oracle: bool
    iou: float
    right: bool
    touches: int


def try_border(case: tuple[str, int, int, bool]) -> BorderOutcome:
    """Explore a scene by its name, its seed, touches at most, and as the oracle or not."""
    scene, seed, touches, oracle = case
    shares = tuple(float(one is FAMILIES[scene]) for one in Family)
    prior = RegionPrior(family_shares=shares) if oracle else None
    job = TableJob(scene=scene, seed=seed, touches=touches, clean=True, closed_form=True)
    after = run_closed_form(job, prior).after
    score = after[-1].score
    assert score.iou is not None
    return BorderOutcome(scene, seed, oracle=oracle, iou=score.iou, right=score.right, touches=len(after))


@dataclass(frozen=True, slots=True)
class BorderConfig(StudyOptions):
    """Explore scenes as `explore` does and as an oracle with the true kind of border, and compare their maps."""

    scenes: Annotated[tuple[str, ...], arg(metavar="NAME...")] = ("two-60-150",)
    """Scenes of the laboratory whose kind of border is known."""
    touches: flags.ManyFlag = 8
    """Touches of each exploration at most."""
    objects: flags.ManyFlag = 20
    """Layouts of each scene, from seed SEED on; each takes some 10 s of a core."""

    def check(self) -> None:
        if unknown := [one for one in self.scenes if one not in FAMILIES]:
            raise InputError(f"--scenes of {', '.join(FAMILIES)}", ", ".join(unknown))


def trials(options: BorderConfig) -> list[Trials[tuple[str, int, int, bool], BorderOutcome]]:
    """Each layout twice."""
    seeds = reported(options.objects, options.output.seed)
    cases = [
        (scene, seed, options.touches, oracle) for scene in options.scenes for seed in seeds for oracle in (False, True)
    ]
    return [Trials("explorations", try_border, cases)]


def report(options: BorderConfig, seconds: float, tried: Sequence[BorderOutcome]) -> StudyReport:
    """A line of each scene and estimator."""
    lines = []
    for (scene, oracle), some in by(tried, lambda one: (one.scene, one.oracle)).items():
        iou = np.array([one.iou for one in some])
        number = of_cases(Rate.of(one.right for one in some))
        good = f"{np.median(iou):.3f} [{np.mean(iou >= GOOD):.2f}]"
        lines.append((scene, "oracle" if oracle else "explore", str(len(some)), good, number))
    names = ("scene", "who", "layouts", f"IoU, median [share at {GOOD} or more]", "number of regions right")
    return StudyReport([Table(lines, names, f"{options.touches} touches at most, seconds: {seconds:.0f}")], tried)


STUDY = Study(BorderConfig, trials, report)
