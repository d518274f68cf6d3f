"""What one squeeze found: its JSON, its table and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deformscope.api.result import LibraryResult
from deformscope.arrays import FloatArray
from deformscope.pictures.report import Figure, Table
from deformscope.results.render import Rows


@dataclass(frozen=True, slots=True)
class SqueezeResult(LibraryResult):
    """What came of one squeeze.

    found: the JSON of `deformscope squeeze`; features: its arrays by modality, as classifiers take them: `tactile`
    (72,) [counts], `physical` (13,), and where the container could be tracked `vision` (3721,) and `vision_small`
    (121,) [m]; png: the depth change drawn, empty without one
    """

    found: Mapping[str, Any]
    features: Mapping[str, FloatArray]
    png: bytes = b""

    @property
    def content(self) -> str:
        """What was asked for, or, in the laboratory, drawn."""
        return str(self.found["content"])

    @property
    def named(self) -> str | None:
        """What the model takes the content for; None without one."""
        return self.found.get("named")

    @property
    def posterior(self) -> Mapping[str, float]:
        """The probability of each content; empty without a model."""
        return dict(self.found.get("posterior", {}))

    @property
    def physical(self) -> Mapping[str, float]:
        """Force, area, indentation, stiffness..., by name, in SI units; NaN where it could not be measured."""
        return dict(self.found["physical"])

    def __repr__(self) -> str:
        answer = "" if self.named is None else f", named {self.named}"
        return f"<squeeze {self.found['trial']}: {self.physical['force_n']:.1f} N{answer}>"

    def as_json(self) -> dict[str, Any]:
        return dict(self.found)

    def tables(self) -> tuple[Table, ...]:
        return (squeeze_table(self.found),)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(self.png, f"Depth change of {self.found['trial']}"),) if self.png else ()


def squeeze_table(found: Mapping[str, Any]) -> Table:
    """found: as in the JSON"""
    rig = found["rig"]
    return Table(_squeeze_rows(found), caption=f"{rig} (simulated)" if found["simulated"] else str(rig))


def _squeeze_rows(found: Mapping[str, Any]) -> Rows:
    rows = [
        ("content", found["content"] if found["content_given"] else "not given"),
        ("container", found["container"] or "not given"),
    ]
    if (events := found.get("events")) is not None:
        (first, steady), physical = (events["first_interval_s"], events["steady_interval_s"]), found["physical"]
        took_s = events["steady_s"] - events["first_s"]
        change = f"none: {found['vision_reason']}"
        if "vision" in found["features"]:
            wide_cm, missing = 1e2 * found["patch_width_m"], found["vision_missing"]
            change = f"seen on {wide_cm:.1f} cm of width, {missing:.0%} of it without depth, "
            change += f"noise of a pixel {1e3 * found['vision_noise_m']:.1f} mm"
        rows += [
            ("first contact", f"{events['first_s']:.2f} s after the start, to {1e3 * (first[1] - first[0]):.0f} ms"),
            ("steady state", f"{took_s:.2f} s after first contact, to {1e3 * (steady[1] - steady[0]):.0f} ms"),
            ("force of a finger", f"{physical['force_n']:.2f} N; stiffness {physical['stiffness_n_per_m']:.0f} N/m"),
            ("depth change", change),
        ]
    if "named" in found:
        order = sorted(found["posterior"].items(), key=lambda one: -one[1])
        words = ", ".join(f"{label} {100 * share:.0f} %" for label, share in order)
        rows.append(("named", f"{found['named']} by {found['named_by']} ({words})"))
        if found["simulated"] and not found["content_given"]:
            rows.append(("truth", found["content"]))
    if (stop := found["discarded"]) is not None:
        rows.append(("discarded", f"{stop['kind']}: {stop['reason']}"))
    rows.append(("hand", hand_words(found)))
    rows += [
        (words, str(found[name]))
        for words, name in (("data set", "dataset"), ("recording", "recording"))
        if found[name]
    ]
    return rows


def hand_words(found: Mapping[str, Any]) -> str:
    """Whether the hand stands, and may be used again as it was. found: `hand_stands`, `limits_restored`"""
    if not found["hand_stands"]:
        return "COULD NOT BE STOPPED: it may still press; switch it off"
    return "stands" if found["limits_restored"] else "stands; ITS CURRENT LIMITS ARE NOT AS THEY WERE: switch it off"
