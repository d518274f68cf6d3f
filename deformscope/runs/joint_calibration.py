"""beta and theta of pairs together, for the command and for scripts."""

from dataclasses import dataclass

from deformscope.config import BothConfig
from deformscope.file_io import read_file
from deformscope.files.pairs import parse_pair
from deformscope.pictures.material_figures import joint_png
from deformscope.pictures.messages import least_aee_rows, value_rows
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json, plain
from deformscope.runs.pair_calibration import pair_recorder, parse_files
from deformscope.runs.result import LibraryResult, Note, log_note
from deformscope.session import Step
from deformscope.stages.fit.estimate import converged_text, explained_text
from deformscope.stages.fit.joint import JointEstimate, JointOptions, calibrate_both
from deformscope.stages.fit.model import Model
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.msm.solver import pick_device


@dataclass(frozen=True, slots=True)
class JointResult(LibraryResult):
    """What `calibrate both` found. estimate: beta and theta, each with its interval; name: name of the pair"""

    estimate: JointEstimate
    name: str

    def as_json(self) -> Json:
        return self.estimate.as_json()

    def tables(self) -> tuple[Table, ...]:
        found = self.estimate
        rows = [row for one in (found.beta, found.theta) for row in (*value_rows(one), *least_aee_rows(one))]
        rows.append(("correlation", f"{found.correlation:+.2f}"))
        rows.append(("stiffness", found.beta.stiffness_text()))
        if found.beta.explained is not None:
            rows.append(("explained", explained_text(found.beta.explained, found.beta.reasons)))
        rows.append(("converged", converged_text(found.beta)))
        return (Table(rows, caption=f"beta and theta of {self.name}"),)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(joint_png(self.estimate), "Joint posterior of beta and theta"),)


def calibrate_jointly(
    config: BothConfig, *, note: Note = log_note, progress: Progress | None = None
) -> list[JointResult]:
    """Each pair alone, or all together."""
    quiet_warp()
    device = pick_device(config.fit.device)
    model = Model(basis=config.mode, cluster_size=config.cluster_size or None, volume="project", device=device)
    options = JointOptions(model, config.beta_range, config.theta_range, config.fit.level, config.output.seed)
    raws = [(one, read_file(one, "a pair file (.npz)")) for one in config.sources]
    seen = parse_files(parse_pair, raws, config.fit.noise_m, note)
    sets = [seen] if config.joint else [[one] for one in seen]
    names = ["all pairs"] if config.joint else list(config.sources)
    every: list[JointResult] = []
    settings: dict[str, object] = {"command": "both", **plain(config)}  # type: ignore[dict-item]
    with pair_recorder(seen, raws, settings, config.output) as recorder:
        for number, (name, some) in enumerate(zip(names, sets, strict=True)):
            estimate, comparisons = calibrate_both(some, options, progress=progress)
            every.append(JointResult(estimate, name))
            for frame, comparison in enumerate(comparisons, start=number):
                recorder.write(Step((comparison, every[-1].findings()), frame=frame))
    return every
