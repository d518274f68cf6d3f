"""The thesis's experiment on containers in the laboratory: 731 squeezes of five contents (Thesis 5.1)."""

import dataclasses
import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deformscope.experiments.squeeze.features import SqueezeGeometry
from deformscope.experiments.squeeze.frames import ObservedRecorder, SqueezeFrames
from deformscope.experiments.squeeze.placing import (
    Squeezed,
    entry_of,
    feature_settings,
    recorded_settings,
    row_of,
    squeeze,
)
from deformscope.experiments.squeeze.squeezing_hand import SqueezingHand, observer_of
from deformscope.files.squeeze_dataset import TRIALS, SqueezeDataset, TrialEntry, TrialRow
from deformscope.lab.container_setup import CAMERA_HZ, ContainerLab, container_lab
from deformscope.log.layout import SQUEEZE, SqueezeLayout
from deformscope.recording.recorder import Recorder
from deformscope.session import finish, run

THESIS_COUNTS = {"empty": 153, "water": 153, "yogurt": 120, "flour": 153, "rice": 152}
"""Thesis 5.1: around 150 of each content, 30 less of yogurt."""
BOXES, SESSIONS = 10, 5
"""Identical boxes, each of which had every content in turn; days with their own temperature. Chosen."""
FAST_CAMERA_HZ = 10.0
"""Images a second if only features are stored: the container is tracked at the events and at 5 Hz between them."""


@dataclass(frozen=True, slots=True)
class SqueezeJob:
    """One trial. folder: folder of the data set; whole: its recording is stored, at the camera's full rate"""

    content: str
    container: str
    session: str
    seed: int
    folder: Path
    whole: bool = False

    @property
    def trial(self) -> str:
        """Its name in the data set."""
        return f"{self.session}-{self.container}-{self.seed:05d}"


NEW = 100
"""First number of containers and sessions of new trials; their seeds begin at a thousand times this."""


SQUEEZES = "squeezes"
"""The data set's folder, in a study's."""


def squeeze_jobs(
    out: Path, trials: int, cylinders: int, whole: int, seed: int, *, new: bool = False
) -> list[SqueezeJob]:
    """All trials in the thesis's proportions, with contents, boxes and sessions in random order. out: the study's
    folder; cylinders: number of trials with plastic cylinders; new: use other containers, sessions and seeds"""
    first, folder = NEW if new else 0, out / SQUEEZES
    seed += 1000 * first
    contents = [content for content, count in THESIS_COUNTS.items() for _ in range(count)]
    order = np.random.default_rng([seed, 0xB0]).permutation(len(contents))
    mixed = [contents[at] for at in order]
    drawn = [mixed[round(at * len(mixed) / trials) % len(mixed)] for at in range(trials)]
    places = list(THESIS_COUNTS)
    jobs = [
        SqueezeJob(
            content,
            f"box-{first + at % BOXES + 1:02d}",
            f"lab-{first + at * SESSIONS // trials + 1}",
            seed + at,
            folder,
        )
        for at, content in enumerate(drawn)
    ]
    jobs += [
        SqueezeJob(
            places[at % len(places)],
            f"cylinder-{first + at // len(places) % BOXES + 1:02d}",
            f"lab-{first + at * SESSIONS // max(cylinders, 1) + 1}",
            seed + trials + at,
            folder,
        )
        for at in range(cylinders)
    ]
    every = max(len(jobs) // whole, 1) if whole else 0
    return [
        dataclasses.replace(one, whole=True) if whole and at % every == 0 and at // every < whole else one
        for at, one in enumerate(jobs)
    ]


def dataset_of(out: Path, rows: Sequence[TrialRow]) -> SqueezeDataset:
    """The data set in a study's folder, with these trials added, unless it has them."""
    dataset = SqueezeDataset(out / SQUEEZES, feature_settings(container_lab().setup))
    known = {one.trial for one in dataset.entries()} if dataset.exists else set()
    dataset.add([row for row in rows if row.entry.trial not in known])
    return dataset


@dataclass(frozen=True, slots=True, eq=False)
class SqueezedTrial:
    """One squeeze with its features, recording and truth. made: the laboratory, not opened; frames: frames of the
    devices"""

    entry: TrialEntry
    made: ContainerLab
    geometry: SqueezeGeometry
    frames: SqueezeFrames
    found: Squeezed


def run_squeeze(job: SqueezeJob) -> TrialRow:
    """Run one trial on its own simulated clock, in any process."""
    trial = squeeze_trial(job)
    row = row_of(trial.entry, trial.found.features)
    del trial
    gc.collect()  # laboratory and images hold each other: some 20 MB a trial
    return row


def squeeze_trial(job: SqueezeJob, on_cycle: Callable[[ContainerLab], None] = lambda made: None) -> SqueezedTrial:
    """One trial with its features, recording and truth. on_cycle: called in each control period"""
    made = container_lab(
        job.content, job.container, job.session, job.seed, camera_hz=CAMERA_HZ if job.whole else FAST_CAMERA_HZ
    )
    setup = made.setup
    entry = entry_of(setup, made.content, made.container, job.session, job.seed)
    file = job.folder / TRIALS / f"{entry.trial}.rrd" if job.whole else None
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
    settings = {"seed": job.seed, "lab": "lab:containers", "trial": dataclasses.asdict(entry)}
    found, geometry = Squeezed(), SqueezeGeometry.of(setup)
    with (
        Recorder(file, "none", settings | recorded_settings(setup), application=SQUEEZE, overwrite=True) as recorder,
        setup.open_source() as source,
    ):
        observer, names = observer_of(setup, source), setup.names
        frames = observer.frames
        layout = SqueezeLayout(source.streams, names.tactile, frames.tactile_source.pads, names.camera)
        recorder.start(layout, source.start_ns)
        observed = ObservedRecorder(recorder, observer)
        hand = SqueezingHand(setup, source, observer, lambda: on_cycle(made))
        run(source, squeeze(setup.clock, observer, geometry, found), observed, hand)
        finish(source, observed)
    if found.features is not None:
        events = found.features.events
        entry = dataclasses.replace(
            entry,
            first_s=(events.first_ns - source.start_ns) / 1e9,
            steady_s=(events.steady_ns - source.start_ns) / 1e9,
        )
    reason = None if found.stop is None else f"{found.stop.kind}: {found.stop.reason}"
    recording = "" if file is None else f"{TRIALS}/{file.name}"
    entry = dataclasses.replace(entry, discarded=reason, recording=recording)
    return SqueezedTrial(entry, made, geometry, frames, found)
