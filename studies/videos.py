"""`python -m studies videos`: stiffness, modulus, clock and body of rendered videos whose truth is known.

python -m studies videos --jobs 16 --resume videos.jsonl --json videos.json
python -m studies videos --videos 3 --unaided 0

Each video is rendered by `studies.rendered_video` (finite elements of large strains in plane stress; hand-held camera,
perspective, shadow, noise, H.264 at 4 Mbit/s where PyAV is installed) and written with the log of its force, whose
clock, rate and unit are its own. Then the library fits the files as a user's script does: once with region, held parts
and contact stated, and once without them."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np

from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from studies.independent.large_strain import Law
from studies.quantities import Rate, Row, band, by, counts, share
from studies.rendered_video import RenderedVideo, case, render, write
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import INDEPENDENT, TUNING

QUANTITIES = ("stiffness at the contact", "modulus", "Poisson's ratio", "time of the log")
KEYS = ("contact_stiffness_n_per_mm", "modulus_pa", "poisson", "force_offset_s")
"""Where the JSON has them: an object of value and interval."""

SPACING = 1.0 / 6.0
"""Distance of particles as a share of the block's height."""

ALIKE, FOOTPRINT = 0.85, 0.7
"""Overlap of a right region with the true one, and of the widths of a right contact and the tool."""
FIRST = 140
"""First of the independent seeds that is counted: those before it were counted with an earlier program."""
NEAR = 0.12
"""Largest error of a modulus that is right."""


@dataclass(frozen=True, slots=True)
class FilmCase:
    """One video. unaided: nothing of region, held parts and contact is stated"""

    seed: int
    unaided: bool = False
    law: Law = "neo-hooke"
    width_px: int = 1280
    height_px: int = 720


@dataclass(frozen=True, slots=True)
class FilmOutcome:
    """What was found in one video. truth, value, low, high: (4,) of QUANTITIES, nan where there is none

    frame_s: time between images; lag_s: time constant of the display; verdicts: those of stiffness and modulus
    reasons: codes of its doubts; error: why there is no result; encoder: what made the file; overlap: intersection over
    union of the region; held, contact: whether they are right; unsure: whether the result says that they may be
    wrong"""

    seed: int
    holding: str
    frame_s: float
    lag_s: float
    truth: tuple[float, ...]
    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    verdicts: tuple[str, str] = ("", "")
    reasons: tuple[str, ...] = ()
    error: str = ""
    encoder: str = ""
    overlap: float = float("nan")
    held: bool = False
    contact: bool = False
    unsure: bool = False

    @property
    def right(self) -> bool:
        """Whether region, held parts and contact are right."""
        return self.overlap >= ALIKE and self.held and self.contact


def try_film(made: FilmCase) -> FilmOutcome:
    """Render one video, and fit its files."""
    drawn = case(made.seed, law=made.law, width_px=made.width_px, height_px=made.height_px)
    try:
        video = render(drawn)
    except ArithmeticError as error:  # a foam that softens can lose its balance at the tool's corner
        none = (float("nan"),) * len(QUANTITIES)
        about = made.seed, drawn.holding, 1.0 / drawn.fps, drawn.log.lag_s
        return FilmOutcome(*about, none, none, none, none, error=f"not rendered: {error}")
    with tempfile.TemporaryDirectory() as folder:
        encoder = write(video, Path(folder))
        known: dict[str, Any] = {} if made.unaided else flags_of(video)
        return fitted(video, Path(folder), known, encoder)


def flags_of(video: RenderedVideo) -> dict[str, Any]:
    """What a user states of a video after a look at it."""
    return {"roi": video.roi, "spacing_px": SPACING * video.roi[3], "held": video.held, "contact": video.contact}


def fitted(video: RenderedVideo, folder: Path, known: Mapping[str, Any], encoder: str) -> FilmOutcome:
    """The fit of the files in a folder."""
    import deformscope as ds

    made = video.case
    truth = (video.stiffness_n_per_mm, video.modulus_pa, video.poisson, made.log.offset_s)
    nothing = (float("nan"),) * len(truth)
    try:
        result = ds.calibrate_beta(
            str(folder / "video.mp4"),
            force=str(folder / "force.csv"),
            px_per_cm=video.px_per_cm,
            thickness_m=video.thickness_m,
            progress=False,
            **known,
        )
    except InputError as error:
        why = str(error).splitlines()[0]
        about = made.seed, made.holding, 1.0 / video.fps, made.log.lag_s, truth
        return FilmOutcome(*about, nothing, nothing, nothing, error=why)
    found: dict[str, Any] = result.to_dict()
    settings: dict[str, Any] = dict(result.settings)
    numbers = [_numbers(found.get(key)) for key in KEYS]
    value, low, high = (tuple(one[at] for one in numbers) for at in range(3))
    overlap, held, contact = compared(video, settings)
    reasons = tuple(one["code"] for one in found["reasons"])
    return FilmOutcome(
        made.seed,
        made.holding,
        1.0 / video.fps,
        made.log.lag_s,
        truth,
        value,
        low,
        high,
        verdicts=(
            found.get("contact_stiffness_verdict") or found["stiffness_verdict"],
            found.get("modulus_verdict") or "",
        ),
        reasons=reasons,
        encoder=encoder,
        overlap=overlap,
        held=held,
        contact=contact,
        unsure="body-unsure" in reasons,
    )


def _numbers(one: Mapping[str, Any] | None) -> tuple[float, float, float]:
    """Value and interval of a quantity in the JSON."""
    if one is None or one["value"] is None:
        return float("nan"), float("nan"), float("nan")
    low, high = one["interval"] or (float("nan"), float("nan"))
    return float(one["value"]), float(low), float(np.inf if high is None else high)


def compared(video: RenderedVideo, settings: Mapping[str, Any]) -> tuple[float, bool, bool]:
    """Overlap of the region that was used with the true one; whether held parts and contact are right."""
    used = settings["particles"]
    outline = settings.get("outline")
    if outline:
        corners = np.asarray(outline, dtype=np.float64).reshape(-1, 2)
    elif used["roi"] is not None:
        x, y, width, height = used["roi"]
        corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
    else:
        corners = np.array([[0, 0], [video.case.width_px, 0], [video.case.width_px, video.case.height_px]])
        corners = np.vstack([corners, [0, video.case.height_px]])
    shape = (video.case.height_px, video.case.width_px)
    mine, true = _filled(corners, shape), _filled(video.outline, shape)
    overlap = float(np.count_nonzero(mine & true) / np.count_nonzero(mine | true))
    parts = {"contact" if one == "top" and video.case.holding == "plate" else one for one in used["held"]}
    return overlap, parts == set(video.held), _touches(video, used)


def _touches(video: RenderedVideo, used: Mapping[str, Any]) -> bool:
    """Whether the contact is below the tool, and as wide as it."""
    x, _, width, _ = video.contact
    if used["contact"] is None:
        return video.case.holding == "plate" and "top" in used["held"]
    left, top, wide, _ = used["contact"]
    shared = min(x + width, left + wide) - max(x, left)
    either = max(x + width, left + wide) - min(x, left)
    return bool(shared >= FOOTPRINT * either and top < video.roi[1] + video.roi[3] / 3.0)


def _filled(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    image = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(image, [np.rint(corners).astype(np.int32)], 1)
    return image > 0


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class VideosConfig(StudyOptions):
    """Count how far off stiffness, modulus and clock of rendered videos are, how often their intervals hold, and how
    often the body is found without flags."""

    videos: Annotated[int, flags.least(0)] = 40
    """Videos that are fitted with region, held parts and contact stated; each takes a minute or two. Seeds 2140 on."""
    unaided: Annotated[int, flags.least(0)] = 30
    """Videos that are fitted without them: the first ones of the same."""
    softening: Annotated[int, flags.least(0)] = 10
    """Videos with flags of a foam that softens under pressure, a law that the fit does not have: the first ones."""
    tuning: bool = False
    """Take the seeds for choosing constants, 1000 on."""
    small: bool = False
    """Videos of 640 x 480 instead of 1280 x 720."""


def trials(options: VideosConfig) -> list[Trials[FilmCase, FilmOutcome]]:
    """The videos, with and without flags."""
    size = (640, 480) if options.small else (1280, 720)
    every = list(TUNING) if options.tuning else list(INDEPENDENT[FIRST:])

    def of(name: str, count: int, unaided: bool = False, law: Law = "neo-hooke") -> Trials[FilmCase, FilmOutcome]:
        return Trials(name, try_film, [FilmCase(seed, unaided, law, *size) for seed in every[:count]])

    return [
        of("videos", options.videos),
        of("videos without flags", options.unaided, unaided=True),
        of("videos of softening foam", options.softening, law="saint-venant"),
    ]


def report(
    options: VideosConfig,
    seconds: float,
    stated: Sequence[FilmOutcome],
    unaided: Sequence[FilmOutcome],
    softening: Sequence[FilmOutcome],
) -> StudyReport:
    """Accuracy by kind of holding, the clock, the body, and why there was no result."""
    tables: list[Table] = []
    found: dict[str, Any] = {}
    for name, outcomes in (("with flags", stated), ("without flags", unaided), ("of softening foam", softening)):
        if not outcomes:
            continue
        groups = {"all": list(outcomes), **by(outcomes, lambda one: one.holding)}
        lines = [row for holding, some in groups.items() for row in accuracy(holding, some)]
        tables.append(_table(lines, f"{len(outcomes)} videos {name}"))
        found[name] = {
            "rows": lines,
            "errors": counts(one.error for one in outcomes if one.error),
            "reasons": counts(code for one in outcomes for code in one.reasons),
            "encoders": counts(one.encoder for one in outcomes if one.encoder),
            "off": [_described(one) for one in outcomes if _off(one, 1) > NEAR or one.error],
        }
    if unaided:
        done = [one for one in unaided if not one.error]
        wrong = [one for one in done if not one.right]
        rates = {
            f"region overlaps by {ALIKE:g}": Rate.of(one.overlap >= ALIKE for one in done),
            "held parts": Rate.of(one.held for one in done),
            "contact": Rate.of(one.contact for one in done),
            "held parts and contact": Rate.of(one.held and one.contact for one in done),
            "wrong ones called unsure": Rate.of(one.unsure for one in wrong),
            "right ones called unsure": Rate.of(one.unsure for one in done if one.right),
        }
        rows = [(name, rate.cases, share(2)(rate), band(2)(rate)) for name, rate in rates.items()]
        tables.append(Table(rows, ("right", "videos", "share", "95 % band"), "the body found without flags"))
        found["body"] = rates
    return StudyReport(tables, found)


def accuracy(holding: str, outcomes: Sequence[FilmOutcome]) -> list[Row]:
    """A row for each quantity: median error, how many are near, and how often the interval holds the truth."""
    rows = []
    for at, name in enumerate(QUANTITIES):
        known = [one for one in outcomes if np.isfinite(one.value[at])]
        if at == 3:  # a slow display is late by its time constant, whatever its clock says
            known = [one for one in known if one.lag_s == 0.0]
        absolute = name in ("Poisson's ratio", "time of the log")
        off = [_off(one, at) for one in known]
        near = {"time of the log": [one.frame_s for one in known], "Poisson's ratio": [0.1] * len(known)}
        limit = near.get(name, [0.05 if at == 0 else NEAR] * len(known))
        far = [one for one, error, most in zip(known, off, limit, strict=True) if error > most]
        rows.append(
            {
                "holding": holding,
                "quantity": name,
                "median": float(np.median(off)) if off else float("nan"),
                "absolute": absolute,
                "near": Rate.of(error <= most for error, most in zip(off, limit, strict=True)),
                "held": Rate.of(one.low[at] <= one.truth[at] <= one.high[at] for one in known),
                "doubted": Rate.of(bool(one.reasons) for one in far),
                "videos": len(outcomes),
            }
        )
    return rows


def _off(one: FilmOutcome, at: int) -> float:
    """Error of a quantity, for stiffness and modulus as a share of the truth."""
    return abs(one.value[at] - one.truth[at]) / (one.truth[at] if at < 2 else 1.0)


def _described(one: FilmOutcome) -> dict[str, Any]:
    return {
        "seed": one.seed,
        "holding": one.holding,
        "truth": one.truth,
        "value": one.value,
        "verdicts": one.verdicts,
        "reasons": one.reasons,
        "error": one.error,
    }


def _table(lines: Sequence[Row], title: str) -> Table:
    written = [
        (
            *(row["holding"], row["quantity"], f"{row['near'].cases} of {row['videos']}"),
            f"{row['median']:.3f}" if row["absolute"] else f"{row['median']:.1%}",
            *(share(2)(row["near"]), f"{share(2)(row['held'])} ({band(2)(row['held'])})", share(2)(row["doubted"])),
        )
        for row in lines
    ]
    names = ("holding", "quantity", "found", "off (median)", "near", "held (95 % band)", "far ones doubted")
    return Table(written, names, title)


STUDY = Study(VideosConfig, trials, report)
