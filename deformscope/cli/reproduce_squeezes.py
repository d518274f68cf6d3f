"""`deformscope reproduce squeezes`: squeezes of the laboratory compared with the simulated truth, as a new data set.

deformscope reproduce squeezes --out runs/squeezes
deformscope classify runs/squeezes/squeezes --model runs/containers/five/contents.npz
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deformscope.cli.common import make_folder, recorder_of, show, write_file, write_json
from deformscope.config import SqueezesConfig

if TYPE_CHECKING:
    from deformscope.files.squeeze_dataset import TrialRow
    from deformscope.reproduce.containers import SqueezeJob
    from deformscope.reproduce.squeeze_truth import Numbers

KEPT_TOGETHER = 20
"""Number of trials that are written together."""


def run(config: SqueezesConfig) -> None:
    """Squeeze missing trials, compare, draw."""
    from deformscope.pictures.findings import Findings
    from deformscope.pictures.report import Figure, Table
    from deformscope.reproduce.squeeze_truth import truth_rows
    from deformscope.reproduce.squeeze_truth_figure import truth_png
    from deformscope.session import Step

    make_folder(config.out)
    with recorder_of(config) as recorder:
        every = _squeezed(config)
        png = truth_png(every)
        caption = "Squeezes of the laboratory compared with the simulated truth"
        found = Findings((Table(truth_rows(every), caption=caption),), (Figure(png, caption),))
        recorder.write(Step((found,), frame=0))
    show(found)
    write_file(config.out / "squeezes.png", png)
    summary = dict(truth_rows(every))
    write_json({"summary": summary, "squeezes": every}, config.output.json)


def _squeezed(config: SqueezesConfig) -> list[Numbers]:
    """Numbers of all trials; those that the folder lacks are squeezed."""
    from deformscope.cli.study import Trials, tried
    from deformscope.experiments.squeeze_trial import feature_settings
    from deformscope.files.squeeze_dataset import SqueezeDataset
    from deformscope.lab.container_setup import container_lab
    from deformscope.reproduce.containers import squeeze_jobs
    from deformscope.reproduce.squeeze_truth import squeeze_errors

    folder = config.out / "squeezes"
    jobs = squeeze_jobs(folder, config.trials, config.cylinders, 0, config.output.seed, new=True)
    dataset = SqueezeDataset(folder, feature_settings(container_lab().setup))
    notes = config.out / "squeezes.jsonl"
    known = _known(notes, {one.trial for one in dataset.entries()} if dataset.exists else set())
    left = [job for job in jobs if job.trial not in known]

    def keep(new: Sequence[tuple[SqueezeJob, tuple[TrialRow, Numbers]]]) -> None:
        """Errors first: a trial of the data set has its errors."""
        with notes.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(numbers) + "\n" for _, (_, numbers) in new)
        dataset.add([row for _, (row, _) in new])
        known.update({str(numbers["trial"]): numbers for _, (_, numbers) in new})

    tried(Trials("squeezing", squeeze_errors, left), config.on, config.workers, keep=keep, together=KEPT_TOGETHER)
    return [known[job.trial] for job in jobs]


def _known(notes: Path, kept: set[str]) -> dict[str, Numbers]:
    """Errors by trial, of those that the data set has."""
    lines = notes.read_text(encoding="utf-8").splitlines() if notes.is_file() else []
    every = [json.loads(line) for line in lines]
    return {one["trial"]: one for one in every if one["trial"] in kept}
