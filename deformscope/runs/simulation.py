"""A measured slab in another simulator: written, pressed there, and its parameters fitted to the pokes."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.optimize import minimize_scalar

from deformscope.arrays import FloatArray, IntArray
from deformscope.config.simulate import SimulateConfig
from deformscope.errors import InputError
from deformscope.file_io import make_folder, read_file
from deformscope.files.model_file import load_model
from deformscope.files.pairs import parse_pair
from deformscope.log.layout import FINDINGS
from deformscope.pictures.figures import MEASURED, SIMULATED, canvas, png_of
from deformscope.pictures.palette import OBSERVED, TARGET, hexadecimal
from deformscope.pictures.palette import SIMULATED as MSM
from deformscope.pictures.report import ColoredBody, ComparedSurfaces, Figure, Findings, Table
from deformscope.plain import Json, plain
from deformscope.recording.items import read_estimates, read_results
from deformscope.recording.reader import Replay
from deformscope.runs.pair_calibration import recorded_pairs
from deformscope.runs.prediction import poke_of
from deformscope.runs.result import FoundResult, SourceResult, open_recorder, recording_rows, settings_of
from deformscope.session import Step
from deformscope.simulators.body_files import write_body, write_meshes
from deformscope.simulators.target_process import TARGETS, TargetFailed, TargetProcess, target_process
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.fit.model import Observation
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate, TouchEstimate
from deformscope.stages.msm.poke import Tip
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.poke.fitted import FittedModel, Score, predict, predict_seen
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import SeenPoke, seen_poke
from deformscope.stages.poke.tip_law import Indenter, TipLaw
from deformscope.stages.simulate import target_fit
from deformscope.stages.simulate.slab_mesh import SlabMesh, block_of, slab_around
from deformscope.terminal import Interruption, Progress, say, until_interrupted

POISSON, RATIOS, START_PA = 0.3, (0.0, 0.49), 50e3
"""Poisson's ratio at the start of a fit; of a block's fit its bounds, and the modulus [Pa]."""
DEPTHS = (0.4, 0.7, 1.0)
"""Shares of a touch's depth at which its force is compared."""
SLOWER, STEPS_TRIED, STABLE = 2.0, 5, 0.05
"""Longer time steps are tried until the force changes by more than this share."""
ANSWERED = ("force_n", "penetration_m", "rest_m", "moved_m")
LEVEL = 0.9
"""Least upward part of a touch's normal."""


@dataclass(frozen=True, slots=True)
class PokeAnswer:
    """A poke in the simulator. held_out: it was not fitted; before: errors with the measured modulus; beyond_edge: the
    surface's error without the points within a cell of a flat tip's edge; msm: errors of shape matching, None without a
    model"""

    poke: target_fit.MeasuredPoke
    answer: target_fit.TargetPoke
    held_out: bool
    after: Score
    beyond_edge: float
    before: Score
    msm: Score | None
    msm_moved: FloatArray | None

    def as_json(self) -> Json:
        seen, poke, after, before = self.poke.seen, self.poke, self.after, self.before
        found: Json = {"name": poke.name, "at_m": seen.at, "tip": seen.tip.shape, "size_m": seen.tip.size}
        found |= {"held_out": self.held_out, "depth_m": poke.depth, "force_n": poke.force}
        found |= {"target_force_n": self.answer.force, "penetration_m": self.answer.penetration}
        found |= {"force_error": after.force_error, "dent_error": after.surface_error}
        found |= {"dent_error_beyond_edge": self.beyond_edge, "force_error_before": before.force_error}
        found |= {"dent_error_before": before.surface_error, "msm_force_error": self.msm and self.msm.force_error}
        return found | {"msm_dent_error": self.msm and self.msm.surface_error}


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationResult(SourceResult):
    """The body in the simulator. measured: modulus by the pokes' force [Pa] and Poisson's ratio that it was typed in
    with; stable_s: longest time step tried that keeps the force, None = none; seconds: duration of the whole run"""

    target: str
    version: str
    body: Path
    mesh: SlabMesh
    measured: target_fit.TargetParameters
    fit: target_fit.TargetFit
    pokes: tuple[PokeAnswer, ...]
    stable_s: float | None
    timestep_s: float
    seconds: float

    @property
    def modulus_pa(self) -> float:
        """The modulus that the simulator needs [Pa]."""
        return self.fit.parameters.young

    def error(self, kind: str, *, held_out: bool) -> float | None:
        """Root mean square of force_error or surface_error over the fitted or the held out pokes; None without any."""
        found = [getattr(one.after, kind) for one in self.pokes if one.held_out == held_out]
        return float(np.sqrt(np.mean(np.square(found)))) if found else None

    def _names(self, logarithm: str = "") -> tuple[str, ...]:
        return tuple(f"{logarithm * (name != 'poisson')}{name}" for name in self.fit.parameters.names)

    def _materials(self) -> list[tuple[float, float, int]]:
        """Of each material the modulus that is needed, the measured one [Pa], and its fitted pokes."""
        fitted = [one.poke.material for one in self.pokes if not one.held_out]
        pairs = zip(self.fit.parameters.moduli, self.measured.moduli, strict=True)
        return [(*pair, fitted.count(number)) for number, pair in enumerate(pairs)]

    def _how(self) -> dict[str, float]:
        """The target's own numbers of its way to a static state: the largest of the pokes."""
        names = self.pokes[0].answer.how
        return {name: max(one.answer.how[name] for one in self.pokes) for name in names}

    def as_json(self) -> Json:
        steps = [one.answer.step_s for one in self.pokes]
        found: Json = {
            "target": self.target,
            "version": self.version,
            "tried_version": TARGETS[self.target].tried,
            "body": self.body,
            "vertices": len(self.mesh.vertices),
            "cells": self.mesh.cells,
            "measured": {"young_pa": self.measured.young, "poisson": self.measured.poisson},
            "needed": {
                "young_pa": self.modulus_pa,
                "poisson": self.fit.parameters.poisson,
                "contact": self.fit.parameters.contact,
                "contact_unit": TARGETS[self.target].unit,
            },
            "materials": [
                {"young_pa": needed, "measured_young_pa": typed, "fitted_pokes": pokes}
                for needed, typed, pokes in self._materials()
            ],
            "deviation": dict(zip(self._names("log_"), self.fit.deviation, strict=True)),
            "determined": {name: self.fit.determined(name) for name in self._names()},
            "converged": self.fit.converged,
            "errors_by_run": self.fit.errors,
            "fitted": {"force_error": self.error("force_error", held_out=False)}
            | {"dent_error": self.error("surface_error", held_out=False)},
            "held_out": {"force_error": self.error("force_error", held_out=True)}
            | {"dent_error": self.error("surface_error", held_out=True)},
            "penetration_m": max(float(one.answer.penetration.max()) for one in self.pokes),
            "timestep_s": self.timestep_s,
            "stable_timestep_s": self.stable_s,
            "static_state": self._how(),
            "seconds_per_step": float(np.median(steps)),
            "seconds": self.seconds,
            "pokes": [one.as_json() for one in self.pokes],
            "settings": self.settings,
        }
        return self.with_problems(found)

    def tables(self) -> tuple[Table, ...]:
        needed, found, moduli = self.fit.parameters, [], []
        for number, (young, typed, pokes) in enumerate(self._materials()):
            label = f"modulus needed{f', region {number}' * bool(needed.ratios)}"
            seen = "" if pokes else "; no fitted poke, changed as the others"
            name = f"ratio {number}" if number else "young"
            moduli.append((label, name, f"{young / 1e3:.4g} kPa, measured {typed / 1e3:.4g} kPa{seen}"))
        for label, name, text in (
            *moduli,
            ("Poisson's ratio", "poisson", f"{needed.poisson:.3g}"),
            ("stiffness of contact", "contact", f"{needed.contact:.3g} {TARGETS[self.target].unit}"),
        ):
            fitted = self.fit.free[needed.names.index(name)]
            known = "" if self.fit.determined(name) else " (not determined by these pokes)" if fitted else " (given)"
            found.append((label, text + known))
        deepest = max(self.pokes, key=lambda one: float(one.answer.penetration.max()))
        inside = 1e3 * float(deepest.answer.penetration.max())
        stable = "none" if self.stable_s is None else f"up to {1e3 * self.stable_s:.3g} ms"
        found += [("penetration", f"{inside:.2g} mm of {1e3 * deepest.poke.seen.depth:.3g} mm")]
        found += [("time step", f"{1e3 * self.timestep_s:.3g} ms; the force stays the same {stable}")]
        found += [("seconds a step", f"{np.median([one.answer.step_s for one in self.pokes]):.2g}")]
        if how := self._how():
            found += [("of a poke, at most", ", ".join(f"{value:.3g} {name}" for name, value in how.items()))]
        found += [("converged", "yes" if self.fit.converged else "NO: ended before")]
        body = f"{self.body}, {len(self.mesh.vertices)} vertices"
        rows = [
            (
                one.poke.name + (" (held out)" if one.held_out else ""),
                f"{one.before.force_error or 0.0:+.1%}",
                f"{one.after.force_error or 0.0:+.1%}",
                f"{one.before.surface_error:.1%}",
                f"{one.after.surface_error:.1%}",
                f"{one.beyond_edge:.1%}",
            )
            for one in self.pokes
        ]
        names = ("poke", "force before", "force", "dent before", "dent", "off the edge")
        return (
            Table([*found, ("body", body), *self.source_rows()], caption=f"{self.target} {self.version}"),
            Table(rows, names, "Errors, with the measured modulus and with the needed one, of force and of the depth"),
        )

    def predictions(self) -> Table:
        """The pokes that tested the fit, by the model and in the simulator."""
        rows = []
        for one in filter(lambda one: one.held_out, self.pokes):
            forces = (f"{found.force[-1]:.3g} N" for found in (one.poke, one.answer))
            apart = (f"{one.after.force_error or 0.0:+.1%}", f"{one.after.surface_error:.1%}")
            rows.append((one.poke.name, *forces, *apart))
        names = ("poke", "force by the model", f"in {self.target}", "difference", "of the dents, of the depth")
        return Table(rows, names, f"{self.target} {self.version}, fitted to the measured pokes")

    def figures(self) -> tuple[Figure, ...]:
        return tuple(self._figure(one) for one in self.pokes)

    def surfaces(self, one: PokeAnswer) -> ComparedSurfaces:
        """The surface under a poke as measured, by shape matching, and in the simulator, where that has a body."""
        seen, (x, y) = one.poke.seen, self.mesh.axes[:2]
        inside = (seen.points[:, :2] >= (x[0], y[0])) & (seen.points[:, :2] <= (x[-1], y[-1]))
        near, moved = inside.all(axis=1), target_fit.surface_moved(self.mesh, one.poke, one.answer)
        parts = [("measured", seen.moved, OBSERVED), ("MSM", one.msm_moved, MSM), (self.target, moved, TARGET)]
        shown = tuple((name, (seen.points + by)[near], tint) for name, by, tint in parts if by is not None)
        return ComparedSurfaces(f"Surface under the poke: {', '.join(name for name, _, _ in shown)}", shown)

    def _figure(self, one: PokeAnswer) -> Figure:
        figure = canvas(8.4, 3.4, layout="constrained")
        left, right = figure.subplots(1, 2)
        seen, poke = one.poke.seen, one.poke
        left.plot(1e3 * poke.depth, poke.force, "x-", color=MEASURED, label="measured")
        left.plot(1e3 * poke.depth, one.answer.force, "s--", ms=4, color=hexadecimal(TARGET), label=self.target)
        if one.msm is not None and one.msm.force is not None:
            left.plot(1e3 * seen.depth, one.msm.force, "o", ms=4, color=SIMULATED, label="MSM")
        for other in self.pokes:  # faint: all pokes in one plot
            shade = {"color": MEASURED, "alpha": 0.4}
            left.plot(1e3 * other.poke.depth, other.poke.force, "x:", **shade)
            left.plot(1e3 * other.poke.depth, other.answer.force, "s:", ms=3, **shade | {"color": hexadecimal(TARGET)})
        deepest = max(float(other.poke.depth.max()) for other in self.pokes)
        most = max(float(np.max([other.poke.force, other.answer.force])) for other in self.pokes)
        left.set(xlabel="depth [mm]", ylabel="force [N]", xlim=(0.0, 1.1e3 * deepest), ylim=(0.0, 1.1 * most))
        aside = np.abs(seen.points[:, 1] - seen.at[1])
        near = np.flatnonzero(aside <= aside.min() + 0.25 * self.mesh.size[2] / self.mesh.cells[2])
        near = near[np.argsort(seen.points[near, 0])]
        along = 1e3 * (seen.points[near, 0] - seen.at[0])
        moved = [(seen.moved, "x", MEASURED, "measured"), (one.msm_moved, "o", SIMULATED, "MSM")]
        moved += [(target_fit.surface_moved(self.mesh, poke, one.answer), "s", hexadecimal(TARGET), self.target)]
        for values, mark, colour, name in moved:
            if values is not None:
                right.plot(along, 1e3 * values[near, 2], mark, ms=4, color=colour, label=name)
        low, high = np.clip(1e3 * (self.mesh.axes[0][[0, -1]] - seen.at[0]), along.min() - 1.0, along.max() + 1.0)
        right.set(xlabel="along x from the tip's axis [mm]", ylabel="height change [mm]", xlim=(low, high))
        for axes in (left, right):
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8, loc="best")
        material = f", region {poke.material}" * bool(self.fit.parameters.ratios)
        figure.suptitle(poke.name + material, fontsize=9)  # of the picture: a view has one name for all frames
        return Figure(png_of(figure, 120), "force over depth, and a cut through the dent")


def simulate(config: SimulateConfig, progress: Progress | None = None) -> SimulationResult | FoundResult:
    """Read the pokes or the pair, write the body, press or hold and fit it, and record all of it. Raises InputError."""
    began = time.monotonic()
    quiet_warp()
    if config.recorded and (pairs := recorded_pairs(replay := Replay(config.source))):
        return _simulate_pair(config, [parse_pair(raw, name) for name, raw in pairs], read_estimates(replay))
    model = None if config.recorded else load_model(config.source)
    regions = _Regions(np.zeros((1, 1), np.int64), 1.0, np.ones(1)) if model is not None else _regions(config.source)
    surface, pokes = _of_recording(config) if model is None else _of_model(model, config)
    pokes = [replace(one, material=int(regions.at(one.seen.at[None, :2])[0])) for one in pokes]
    seen = [one.seen for one in pokes]
    mesh = slab_around(surface, seen, config.spacing_m, config.vertices, regions.at, config.reach_m)
    predicted = pokes[len(config.against) :] if config.against else []
    test = predicted or _held_out(pokes, config.held_out)
    fitted = [one for one in pokes if not any(one is other for other in test)]
    about = TARGETS[config.target]
    poisson = POISSON if config.poisson is None else config.poisson
    young, ratios = regions.moduli(fitted, surface.thickness, poisson)
    start = target_fit.TargetParameters(young, poisson, about.contact * young, ratios)
    timestep_s = config.timestep_s or about.timestep_s
    make_folder(config.out)
    settings = settings_of(config)
    with target_process(config.target, config.python) as target, until_interrupted() as asked:
        if target.version != about.tried:
            say(f"{config.target} {target.version} was not tried with this program: {about.tried} was")

        body = write_body(config.target, config.out, mesh, start, config.density, timestep_s)
        runs = _Runs(target, config, body, timestep_s, began, asked)
        first = runs.press(start, pokes, anyway=True)
        free = (True, config.poisson is None, True, *regions.free(fitted))
        cost = sum(one.step_s * one.how.get("steps", 0.0) for one in first) * len(fitted) / len(pokes)
        most = target_fit.MOST_ROUNDS * (sum(free) + 1) + 1
        say(f"{len(mesh.vertices)} vertices: a run of all pokes takes some {cost:.0f} s, the fit 8 to {most} runs")
        note = progress or (lambda what, done, total: None)
        found = target_fit.fit_target(
            mesh, fitted, runs.press, start, free, lambda done, total: note("runs", done, total)
        )
        last = runs.press(found.parameters, pokes, anyway=True)
        stable = runs.stable_step(found.parameters, pokes, last)
    write_body(config.target, config.out, mesh, found.parameters, config.density, timestep_s)
    write_meshes(config.out, mesh, last[-1].moved, found.parameters)
    answers = []
    for poke, before, after in zip(pokes, first, last, strict=True):
        msm_moved, msm = predict_seen(model, poke.seen)[1:] if model is not None else (None, None)
        ours, typed = (target_fit.target_score(mesh, poke, one, config.target) for one in (after, before))
        off = target_fit.score_beyond_edge(mesh, poke, after)
        answers.append(PokeAnswer(poke, after, any(one is poke for one in test), ours, off, typed, msm, msm_moved))
    result = SimulationResult(
        name=str(config.source),
        settings=settings,
        target=config.target,
        version=target.version,
        body=body,
        mesh=mesh,
        measured=start,
        fit=found,
        pokes=tuple(answers),
        stable_s=stable,
        timestep_s=timestep_s,
        seconds=time.monotonic() - began,
    )
    moduli = 1e-3 * np.array(found.parameters.moduli)[np.pad(mesh.material, (0, 1), mode="edge").ravel()]
    firm = [ColoredBody(f"{config.target}: modulus [kPa]", mesh.vertices, moduli)][: len(ratios)]
    with open_recorder(config.output, settings, FINDINGS.variant("simulate")) as recorder:
        for number, (one, figure) in enumerate(zip(result.pokes, result.figures(), strict=True)):
            moved_mm = 1e3 * np.linalg.norm(one.answer.moved, axis=1)
            position = one.answer.rest + one.answer.moved
            shown = ColoredBody(f"{config.target}: vertices by their displacement [mm]", position, moved_mm)
            bodies: list[Any] = [shown, *firm, result.surfaces(one)]
            recorder.write(Step((Findings(result.tables(), (figure,), tuple(bodies)),), frame=number))
    return replace(result, recording=recorder.summary())


def _simulate_pair(config: SimulateConfig, seen: Sequence[Observation], known: Sequence[Estimate]) -> FoundResult:
    """A pair's block in MuJoCo, its held particles moved as they were. Poisson's ratio is fitted to the others: without
    gravity the modulus moves none of them; it is fitted to the force. known: by shape matching"""
    if len(seen) > 1 or config.target != "mujoco":
        hint = "--in mujoco: Newton's solver has no force of held vertices"
        raise InputError("one block's pair for MuJoCo", f"{len(seen)} for {config.target}", hint, config.source)
    pair, timestep_s = seen[0], config.timestep_s or TARGETS["mujoco"].timestep_s
    mesh, particle = block_of(pair)
    moved, free = (pair.deformed - pair.rest)[particle], pair.free_observed[particle]
    mesh = replace(mesh, held=(held := np.isin(particle, pair.held)))
    make_folder(config.out)
    with target_process("mujoco", config.python) as target:
        found = target_fit.TargetParameters(START_PA, POISSON, START_PA)
        body = write_body("mujoco", config.out, mesh, found, config.density, timestep_s)
        asked: Json = {"do": "hold", "asset": str(body.resolve()), "timestep_s": timestep_s}

        def hold(poisson: float) -> tuple[float, FloatArray, FloatArray]:
            """Mean distance of free particles from where they were seen [m]; displacements [m], forces [N] of all."""
            given = {"parameters": {"young": [START_PA], "poisson": poisson}, "by_m": moved[held].tolist()}
            (answer,) = target.ask(asked | given)
            went = np.array(answer["moved_m"])
            return float(np.linalg.norm((went - moved)[free], axis=1).mean()), went, np.array(answer["force_n"])

        poisson = config.poisson
        if poisson is None:
            poisson = float(minimize_scalar(lambda one: hold(one)[0], bounds=RATIOS, options={"xatol": 0.005}).x)
        (off, went, force), *ends = (hold(one) for one in (poisson, *RATIOS))
    reaction = float(np.linalg.norm(force[np.isin(particle, pair.touched)].sum(axis=0)))
    young = START_PA * pair.force_n / reaction if pair.force_n else None
    modulus = "none without a force: positions are the same for every modulus; no scene is written"
    found = replace(found, young=young or np.nan, poisson=poisson)
    write_meshes(config.out, mesh, went, found)
    body.unlink()
    if young is not None:
        write_body("mujoco", config.out, mesh, found, config.density, timestep_s)
        modulus = f"{young / 1e3:.4g} kPa, by {pair.force_n:.3g} N"
    others = f"with 0: {1e3 * ends[0][0]:.3g} mm, with {RATIOS[1]}: {1e3 * ends[1][0]:.3g} mm"
    rows = [("modulus needed", modulus), ("Poisson's ratio", f"{poisson:.3g}")]
    rows += [("distance of free particles", f"{1e3 * off:.3g} mm on average ({others})")]
    rows += [(f"by MSM, {one.parameter} {one.value:.3g}", f"{1e3 * one.aee_free:.3g} mm") for one in known]
    rows += [("body", f"{body if young else config.out}, {len(mesh.vertices)} vertices")]
    apart = np.where(free | held, 1e3 * np.linalg.norm(went - moved, axis=1), np.nan)
    shown = ColoredBody("mujoco: vertices by their distance from the particles [mm]", mesh.vertices + went, apart)
    with open_recorder(config.output, settings_of(config), FINDINGS.variant("simulate")) as recorder:
        recorder.write(Step((Findings((Table(rows),), (), (shown,)),), frame=0))
    values: Json = {"target": "mujoco", "version": target.version, "needed": {"young_pa": young, "poisson": poisson}}
    values |= {"distance_m": off, "msm_distance_m": [one.aee_free for one in known], "vertices": len(mesh.vertices)}
    rows += recording_rows(recorder.summary())
    return FoundResult(values, (Table(rows, caption=f"mujoco {target.version}"),))


@dataclass(frozen=True, slots=True)
class _Runs:
    """Runs of the target, which presses the body with given parameters."""

    target: TargetProcess
    config: SimulateConfig
    body: Path
    timestep_s: float
    began: float
    asked: Interruption
    known: dict[tuple[target_fit.TargetParameters, str], target_fit.TargetPoke] = field(default_factory=dict)

    def press(
        self, parameters: target_fit.TargetParameters, pokes: Sequence[target_fit.MeasuredPoke], *, anyway: bool = False
    ) -> list[target_fit.TargetPoke]:
        """Raises Stopped where time or a person ended the fit, unless `anyway`; InputError with the target's error."""
        left = [one for one in pokes if (parameters, one.name) not in self.known]
        for poke, answer in zip(left, self._press(parameters, left, anyway=anyway) if left else [], strict=True):
            self.known[parameters, poke.name] = answer
        return [self.known[parameters, one.name] for one in pokes]

    def _press(
        self,
        parameters: target_fit.TargetParameters,
        pokes: Sequence[target_fit.MeasuredPoke],
        timestep_s: float | None = None,
        *,
        anyway: bool = False,
    ) -> list[target_fit.TargetPoke]:
        passed_s, limit_s = time.monotonic() - self.began, self.config.limit_s
        if not anyway and (self.asked.is_set() or passed_s > limit_s):
            raise target_fit.Stopped
        silent_s, heard = max(limit_s, 2.0 * passed_s), [time.monotonic()]  # a target that hangs does not answer
        asked: list[Json] = []
        for one in pokes:
            tip = one.seen.tip
            where: Json = {"at_m": one.seen.at[:2], "tip": tip.shape, "size_m": tip.size, "slips": tip.slips}
            asked.append(where | {"depth_m": one.depth})
        given: Json = {"young": parameters.moduli, "poisson": parameters.poisson, "contact": parameters.contact}
        request: Json = {"do": "press", "asset": self.body.resolve(), "pokes": asked, "parameters": given}
        request |= {"timestep_s": timestep_s or self.timestep_s}
        answers = self.target.ask(cast("Json", plain(request)), lambda: time.monotonic() < heard[-1] + silent_s)
        found = []
        for answer in answers:
            heard.append(time.monotonic())
            force, inside, rest, moved = (np.array(answer[name]) for name in ANSWERED)
            found.append(
                target_fit.TargetPoke(force, inside, rest, moved, float(answer["step_s"]), answer.get("how", {}))
            )
        return found

    def stable_step(
        self,
        parameters: target_fit.TargetParameters,
        pokes: Sequence[target_fit.MeasuredPoke],
        last: Sequence[target_fit.TargetPoke],
    ) -> float | None:
        """The longest time step, doubled again and again, with which the deepest poke's force stays; None = none."""
        at = max(range(len(pokes)), key=lambda number: pokes[number].seen.depth)
        found, step = None, self.timestep_s
        try:
            for _ in range(STEPS_TRIED):
                force = self._press(parameters, [pokes[at]], step)[0].force[-1]
                if abs(force / last[at].force[-1] - 1.0) > STABLE:
                    break
                found, step = step, SLOWER * step
        except (TargetFailed, target_fit.Stopped):
            pass
        return found


def _held_out(pokes: Sequence[target_fit.MeasuredPoke], asked: int | None) -> list[target_fit.MeasuredPoke]:
    """Pokes for the test, spread evenly over each material."""
    pokes = sorted(pokes, key=lambda one: one.material)
    count = len(pokes) // 3 if asked is None else asked
    if count >= len(pokes):
        raise InputError("a poke to fit next to those held out", f"{len(pokes)} in all", f"--held-out {len(pokes) - 1}")
    return [pokes[(2 * number + 1) * len(pokes) // (2 * count)] for number in range(count)]


def _modulus(pokes: Sequence[target_fit.MeasuredPoke], thickness: float, poisson: float) -> float:
    """Young's modulus [Pa] of a bonded layer by the forces at the greatest depths."""
    found = []
    for poke in pokes:
        law = TipLaw(Indenter(poke.seen.tip.shape, poke.seen.tip.size), poke.depth[-1], thickness, "bonded", poisson)
        found.append(poke.force[-1] / float(law.response(poke.depth[-1])) * (1.0 - poisson**2))
    return float(np.median(found))


@dataclass(frozen=True, slots=True)
class _Regions:
    """The regions of a map, each of one material. labels: (rows, columns); level: (r,) stiffness of each [N/mm]"""

    labels: IntArray
    cell_m: float
    level: FloatArray

    def at(self, places: FloatArray) -> IntArray:
        """(p,) region at places (p, 2) [m]."""
        most = np.array(self.labels.shape)[::-1] - 1
        x, y = np.clip(np.floor(places / self.cell_m).astype(np.int64), 0, most).T
        return np.asarray(self.labels[y, x])

    def moduli(
        self, pokes: Sequence[target_fit.MeasuredPoke], thickness: float, poisson: float
    ) -> tuple[float, tuple[float, ...]]:
        """Young's modulus of the first by its pokes [Pa], and the ratios of the others to it; by the map's stiffness
        without pokes."""
        found = np.full(len(self.level), np.nan)
        for one in {poke.material for poke in pokes}:
            found[one] = _modulus([poke for poke in pokes if poke.material == one], thickness, poisson)
        found = np.where(np.isnan(found), self.level * np.nanmedian(found / self.level), found)
        return float(found[0]), tuple(float(one) for one in found[1:] / found[0])

    def free(self, pokes: Sequence[target_fit.MeasuredPoke]) -> list[bool]:
        """Which ratios the pokes can determine: those of regions with pokes, next to one more region with pokes."""
        known = {poke.material for poke in pokes}
        return [one in known and one != min(known) for one in range(1, len(self.level))]


# Reading -------------------------------------------------------------------------------------------------------------


def _of_model(model: FittedModel, config: SimulateConfig) -> tuple[MeasuredSurface, list[target_fit.MeasuredPoke]]:
    """The surface of a model of layers, and its measured or predicted pokes."""
    if model.body != "layers" or model.thickness is None:
        hint = "fit pokes of a surface with --thickness-m"
        raise InputError("a model of layers below a surface", "one of particles", hint, config.source)
    found = []
    for path in config.against:
        seen = seen_poke(parse_pair(read_file(path, "a pair file (.npz)"), path))
        if not seen.force:
            raise InputError("pokes with their force", "none", "force_n in the pair file", path)
        found.append(_single(str(path), seen))
    for text in config.poke:
        made = predict(model, poke_of(text, model))
        if made.force is None:
            raise InputError("a model with a stiffness", "none", "fit it with force_n", config.source)
        rest, moved = made.rest[made.surface], (made.position - made.rest)[made.surface]
        tip, place = made.poke.tip, np.array([*made.poke.at[:2], rest[:, 2].max()])
        found.append(_single(str(text), SeenPoke(place, tip, made.depth, rest, moved, rest, moved, None, made.force)))
    return MeasuredSurface(model.rest, model.thickness), found


def _single(name: str, seen: SeenPoke) -> target_fit.MeasuredPoke:
    """A poke at one depth: a ball's is deeper than the surface away from its axis."""
    rise = seen.tip.rise(seen.touched[:, :2] - seen.at[:2])
    if seen.tip.shape == "sphere" and np.isfinite(rise).any():
        seen = replace(seen, depth=float(np.median((rise - seen.touched_by[:, 2])[np.isfinite(rise)])))
    return target_fit.MeasuredPoke(name, seen, np.array([seen.depth]), np.array([seen.force]))


def _regions(path: Path) -> _Regions:
    """The regions of a recorded exploration's last map; one without any."""
    maps = [cast("MapEstimate", row.item) for row in read_results(path, (MapEstimate,))]
    if not maps or maps[-1].region_count == 0:
        if maps:
            say(f"no regions in the map ({maps[-1].verdict}): the body has one material")
        return _Regions(np.zeros((1, 1), np.int64), 1.0, np.ones(1))
    return _Regions(maps[-1].labels, maps[-1].cell_m, maps[-1].level_n_per_mm)


def _of_recording(config: SimulateConfig) -> tuple[MeasuredSurface, list[target_fit.MeasuredPoke]]:
    """The surface of a recorded exploration, and its touches of level foam."""
    results = [row.item for row in read_results(config.source, (SurfaceEstimate, TouchEstimate))]
    surfaces = [one for one in results if isinstance(one, SurfaceEstimate)]
    touches = [one for one in results if isinstance(one, TouchEstimate) and one.usable and one.normal[2] > LEVEL]
    if not surfaces or not touches:
        kind = Replay(config.source).identity[0].partition("-")[2] or "images"
        came = f"one of kind {kind}: {len(surfaces)} surfaces and {len(touches)} touches"
        hint = "a model of 3-D pokes: deformscope calibrate beta POKE.npz... --thickness-m 0.03 --save MODEL.npz"
        raise InputError("a recording of an exploration, or a model of a slab", came, hint, config.source)
    if config.tip is None:
        raise InputError("--tip with a recording", "none", "--tip sphere:0.02", config.source)
    known = [one.thickness_m for one in touches if one.thickness_m is not None]
    thickness = config.thickness_m or surfaces[-1].layer_m or (float(np.median(known)) if known else None)
    if thickness is None:
        raise InputError("the foam's thickness", "none in the recording", "--thickness-m 0.05", config.source)
    tip = Tip(cast("Any", config.tip.kind), config.tip.size)
    found = []
    for touch in touches:
        depth, sunk = np.array(DEPTHS) * touch.depth_m, touch.approach_m - touch.contact_m
        force = np.interp(np.array(DEPTHS) * sunk.max(), sunk, touch.fitted_n)  # the arm gives way: sunk is larger
        moved = np.zeros_like(touch.observed_m)
        moved[:, 2] = touch.observed_m[:, 2] - touch.xyz_m[2]
        rest = touch.observed_m - moved
        seen = SeenPoke(touch.xyz_m, tip, touch.depth_m, rest, moved, rest, moved, None, float(force[-1]))
        found.append(target_fit.MeasuredPoke(f"touch {touch.number}", replace(seen, heights_only=True), depth, force))
    level, map_ = float(np.median([one.xyz_m[2] for one in touches])), surfaces[-1]
    y, x = (map_.cell_m * (np.indices(map_.height_m.shape) + 0.5)).reshape(2, -1)
    return MeasuredSurface(np.column_stack([x, y, np.full(x.size, level)]), thickness), found
