"""`deformscope.explore`: map how soft a surface is, and where, from a script."""

from __future__ import annotations

from pathlib import Path

from deformscope.api.exploration_result import ExplorationResult
from deformscope.api.result import ViewerChoice, python_names
from deformscope.config import ExploreConfig
from deformscope.config.explore import BetaModel, Feel, Goal, Pace, Planner
from deformscope.errors import InputError
from deformscope.runs.exploration_run import explore_on
from deformscope.terminal import Say, messages_to


def explore(
    rig: str | Path,
    *,
    touches: int | None = None,
    goal: Goal = "regions",
    planner: Planner = "regions",
    set_force_n: float | None = None,
    smallest_inclusion_m: float | None = None,
    beta_model: BetaModel | None = None,
    pace: Pace = "careful",
    hold_s: float = 0.0,
    feel: Feel = "apparent",
    seed: int = 0,
    record: Path | str | None = None,
    viewer: ViewerChoice = "none",
    overwrite: bool = False,
    yes: bool = False,
    trust_rig: bool = False,
    progress: Say | bool | None = None,
) -> ExplorationResult:
    """Map how soft a surface is: look, touch where it says most about the map, map, and again.

    rig: a rig file (.toml), or a simulated scene (`lab:NAME`); touches: at most, default 8, or 30 for inclusions
    goal: regions of one stiffness each, or inclusions below the surface; smallest_inclusion_m: radius of the smallest
    that are sought, default 0.06, for inclusions 0.02; set_force_n: at most 5 N
    pace: quick = low and fast over what is known of the surface; hold_s: of each touch, from which it says how the foam
    creeps; feel: what is mapped: stiffness at once, stiffness when all has relaxed, or the share of its energy that a
    touch loses
    record: a recording to make (.rrd); yes: let a real arm move, once the checks have passed, without asking
    progress: called with each line about checks and touches; default: they are printed on stderr where that is a
    terminal or a notebook; True: always, False: never; those of a rig file always, unless there is a function
    Raises InputError for what cannot be used, and SystemExit where the exploration was stopped before its end.
    """
    given = {name: value for name, value in locals().items() if name not in ("rig", "touches", "progress")}
    simulated = str(rig).startswith("lab:")
    with python_names():
        config = ExploreConfig.of(rig=str(rig), budget=touches, **given)
        with messages_to(progress if simulated or callable(progress) else True):
            explored = explore_on(config, lambda explored: None)
    if explored is None:
        raise InputError("an exploration", "none: it ended before the arm could move")
    return explored
