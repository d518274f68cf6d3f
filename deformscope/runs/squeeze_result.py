"""Result of one squeeze: its JSON, its table and its picture."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.pictures.report import Figure, Table
from deformscope.plain import Json
from deformscope.results.render import Rows, derived, reported, to_json
from deformscope.runs.result import LibraryResult

if TYPE_CHECKING:
    from deformscope.experiments.squeeze.features import TrialFeatures
    from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement
    from deformscope.stages.squeeze.trial import ContentPosterior, SqueezeStop


@dataclass(frozen=True, slots=True, repr=False)
class SqueezeResult(LibraryResult):
    """Outcome of one squeeze: `to_dict()`, or `found`, is the JSON of `deformscope squeeze`.

    content: the requested content or, in the laboratory, a random one; stop: why it ended before its steady state
    start_ns: start of the recording; computed: features and events, None if it was stopped; answer: answer of a model,
    None without one
    placement, sightings: placement and sightings of an arm that placed the hand, None and none where a person did;
    withdrawal: why the arm stopped on its way back
    hand_stands, arm_stands, limits_restored: hand and arm could be stopped, the hand's current limits are restored
    truth: true times of the contact with the laboratory's container and of the hold [s]; untracked: why tracking of the
    container ended, or empty"""

    rig: str = field(metadata=reported())
    simulated: bool = field(metadata=reported())
    trial: str = field(metadata=reported())
    content: str = field(metadata=reported())
    content_given: bool = field(metadata=reported())
    container: str = field(metadata=reported())
    stop: "SqueezeStop | None" = field(metadata=reported(key="discarded"))
    start_ns: int

    @property
    @derived(optional=True)
    def events(self) -> Json | None:
        """First contact and steady state, each with its interval, since the recording's start [s]."""
        if self.computed is None:
            return None
        events = self.computed.events
        return {
            "first_s": self._since_s(events.first_ns),
            "first_interval_s": [*map(self._since_s, events.first_interval_ns)],
            "steady_s": self._since_s(events.steady_ns),
            "steady_interval_s": [*map(self._since_s, events.steady_interval_ns)],
        }

    @property
    @derived(optional=True, json=lambda by_name: {name: len(one) for name, one in by_name.items()} or None)
    def features(self) -> Mapping[str, FloatArray]:
        """Features for classifiers, by modality: `tactile` (72,) [counts], `physical` (13,), and if the container could
        be tracked `vision` (3721,) and `vision_small` (121,) [m]; empty if the squeeze was stopped."""
        return {} if self.computed is None else self.computed.modalities

    computed: "TrialFeatures | None" = field(metadata=reported(flat=True))
    untracked: str

    @property
    @derived(optional=True)
    def tracking(self) -> Json | None:
        """Tracking of the container, and its pose in each image; None after a stop."""
        if self.computed is None or not self.computed.tracked:
            return None
        poses = [one.container for one in self.computed.tracked]
        lags_s = [one.lag_s for one in poses if one.live and one.lag_s is not None]
        median_s, most_s = map(float, np.percentile(lags_s, [50, 95])) if lags_s else (None, None)
        return {
            "images": len(poses),
            "refused": dict(Counter(one.reason for one in poses if not one.good)),
            "live": len(lags_s),
            "skipped": sum(one.skipped or 0 for one in poses),
            "lag_median_s": median_s,
            "lag_p95_s": most_s,
            "ended": self.untracked,
            "poses": poses,
        }

    answer: "ContentPosterior | None" = field(metadata=reported(flat=True))
    hand_stands: bool = field(metadata=reported())
    arm_stands: bool = field(metadata=reported())
    limits_restored: bool = field(metadata=reported())
    placement: "HandPlacement | None" = field(metadata=reported(optional=True))
    sightings: "tuple[ContainerSighting, ...]" = field(metadata=reported(key=None))

    @property
    @derived(optional=True)
    def container_seen(self) -> list[Json] | None:
        """Size and pose from the depth images: before the squeeze, when the hand was placed, and after it."""
        return [to_json(one) for one in self.sightings] or None

    withdrawal: "SqueezeStop | None" = field(metadata=reported(optional=True))
    losses: Mapping[str, Mapping[str, float]] = field(metadata=reported())
    truth: Mapping[str, float | None] | None = field(metadata=reported())
    dataset: Path | None = field(metadata=reported())
    recording: Path | None = field(metadata=reported())

    @property
    def found(self) -> Json:
        """The JSON."""
        return self.to_dict()

    @property
    def named(self) -> str | None:
        """The model's classification of the content; None without one."""
        return None if self.answer is None else self.answer.content

    @property
    def posterior(self) -> Mapping[str, float]:
        """The probability of each content; empty without a model."""
        return {} if self.answer is None else self.answer.shares

    @property
    def physical(self) -> Mapping[str, float]:
        """Force, area, indentation, stiffness..., by name, in SI units; NaN where it could not be measured."""
        return {} if self.computed is None else self.computed.features.by_name

    @property
    def png(self) -> bytes:
        """The depth change drawn, empty without one."""
        from deformscope.pictures.figures import depth_change_png

        if self.computed is None or (change := self.computed.features).vision is None:
            return b""
        return depth_change_png(change.vision, change.patch_width_m, change.missing)

    def __repr__(self) -> str:
        answer = "" if self.named is None else f", named {self.named}"
        return f"<squeeze {self.trial}: {self.physical['force_n']:.1f} N{answer}>"

    def as_json(self) -> Json:
        return to_json(self)

    def tables(self) -> tuple[Table, ...]:
        return (Table(self.rows(), caption=f"{self.rig} (simulated)" if self.simulated else self.rig),)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(png, f"Depth change of {self.trial}"),) if (png := self.png) else ()

    def rows(self) -> Rows:
        """The results, as names and values."""
        rows = [
            ("content", self.content if self.content_given else "not given"),
            ("container", self.container or "not given"),
        ]
        if self.placement is not None:
            at = self.placement
            words = f"{1e3 * at.along_m:.0f} mm along, tilted {at.tilt_deg:.0f} deg, turned {at.turn_deg:.0f} deg"
            rows.append(("placed by", "; ".join([f"{at.by}: {words}", f"tried {len(at.refused)}", *at.reasons])))
        rows += [(f"container {one.when}", one.words) for one in self.sightings]
        if not self.arm_stands:
            rows.append(("arm", "COULD NOT BE STOPPED: use its emergency stop"))
        elif self.stop is not None and self.placement is not None and self.placement.reached in ("approach", "grasp"):
            rows.append(("arm", "is at the container: move it away by its joystick before the next squeeze"))
        if self.withdrawal is not None:
            rows.append(("arm", f"stopped during withdrawal: {self.withdrawal.kind}: {self.withdrawal.reason}"))
        if self.computed is not None:
            events, seen = self.computed.events, self.computed.features
            force_n, stiffness = self.physical["force_n"], self.physical["stiffness_n_per_m"]
            first_ms, steady_ms = (0.5e-6 * (b - a) for a, b in (events.first_interval_ns, events.steady_interval_ns))
            began_s, took_s = self._since_s(events.first_ns), (events.steady_ns - events.first_ns) / 1e9
            change = f"none: {seen.reason}"
            if seen.vision is not None:
                change = f"seen on {1e2 * seen.patch_width_m:.1f} cm of width, {seen.missing:.0%} of it without depth, "
                change += f"noise of a pixel {1e3 * (seen.noise_m or 0.0):.1f} mm"
            rows += [
                ("first contact", f"{began_s:.2f} s after the start, within \u00b1{first_ms:.0f} ms"),
                ("steady state", f"{took_s:.2f} s after first contact, within \u00b1{steady_ms:.0f} ms"),
                ("force of a finger", f"{force_n:.2f} N; stiffness {stiffness:.0f} N/m"),
                ("depth change", change),
            ]
        if (tracking := self.tracking) is not None:
            behind = ", {lag_median_s:.2f} s behind (95 %: {lag_p95_s:.2f})" if tracking["live"] else ""
            words = ("{images} images, {live} during the squeeze, {skipped} left out" + behind).format(**tracking)
            refused = "; ".join(
                f"{count} refused: {why}" for why, count in cast("dict[str, int]", tracking["refused"]).items()
            )
            rows.append(("tracked", "; ".join(filter(None, (words, refused, self.untracked)))))
        if self.answer is not None:
            order = sorted(self.posterior.items(), key=lambda one: -one[1])
            words = ", ".join(f"{label} {100 * share:.0f} %" for label, share in order)
            rows.append(("named", f"{self.answer.content} by {self.answer.modality} ({words})"))
            if self.simulated and not self.content_given:
                rows.append(("truth", self.content))
        if self.stop is not None:
            rows.append(("discarded", f"{self.stop.kind}: {self.stop.reason}"))
        written = (("data set", self.dataset), ("recording", self.recording))
        return [*rows, ("hand", self.hand_text), *((words, str(path)) for words, path in written if path)]

    @property
    def hand_text(self) -> str:
        """Whether the hand is at rest, and ready for use."""
        if not self.hand_stands:
            return "COULD NOT BE STOPPED: it may still press; switch it off"
        if not self.limits_restored:
            return "at rest; ITS CURRENT LIMITS WERE NOT RESTORED: switch it off"
        return "stands"

    def _since_s(self, time_ns: int) -> float:
        return (time_ns - self.start_ns) / 1e9
