"""One recording as a row of a catalog: its command, its end and its results, under the names of the JSON."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from deformscope.errors import InputError
from deformscope.frames import SessionNote
from deformscope.recording.items import read_found
from deformscope.recording.ledger import check_recording, discards_of, read_ledger
from deformscope.recording.lock import is_being_written
from deformscope.recording.losses import named
from deformscope.recording.reader import Replay, read_rows
from deformscope.recording.rrd_index import read_index
from deformscope.results.render import HIGH, LOW, cells_of, to_cells
from deformscope.stages.fit.estimate import Estimate
from deformscope.stages.map.exploration import MapEstimate, TouchEstimate
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.recovery import RecoveryEstimate
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.poke.indentation import IndentEstimate, combine
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import ContentPosterior

WHOLE, DAMAGED, UNFINISHED, UNCHECKED, WRITTEN = "whole", "damaged", "unfinished", "unchecked", "being written"
SETTINGS = "settings."


def summarise(path: Path) -> dict[str, Any]:
    """All of it. Damage is reported in `status` and `problem`, with the readable part. Raises OSError and MemoryError
    if the system refuses."""
    row: dict[str, Any] = {"status": WHOLE, "damaged": False, "problem": None}
    if is_being_written(path):
        return row | {"status": WRITTEN}
    row |= _checked(path)
    try:
        for part in _parts(Replay(path, trust=True)):
            row |= part
        if row["status"] == WHOLE and not row.get("complete"):
            row |= {"status": UNFINISHED}
    except InputError as error:
        row |= _damaged(row, str(error).split(" | ")[0])
    except Exception as error:  # damaged bytes make the readers raise what they like
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno):
            raise
        row |= _damaged(row, f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")
    return row


def _damaged(row: Mapping[str, Any], problem: str) -> dict[str, Any]:
    return {"status": DAMAGED, "damaged": True, "problem": row["problem"] or problem}


def _checked(path: Path) -> dict[str, Any]:
    """The recording checked by its ledger, and the SHA-256 of its bytes: the ledger's if that was found to be right."""
    try:
        check = check_recording(path)
    except FileNotFoundError:
        check = None
    if check is not None and check.ended and not check.problems and not check.source_problems:
        return {"sha256": (read_ledger(path).ended or {})["sha256"]}
    with path.open("rb") as file:
        found: dict[str, Any] = {"sha256": hashlib.file_digest(file, "sha256").hexdigest()}
    if check is None:
        return found | {"status": UNCHECKED}
    if problems := check.problems or check.source_problems:
        return found | {"status": DAMAGED, "damaged": True, "problem": problems[0]}
    return found | {"status": UNFINISHED}


def _parts(replay: Replay) -> Iterator[dict[str, Any]]:
    application, recording = replay.identity
    yield {"kind": application.partition("-")[2].partition("-")[0] or "images", "recording": recording}
    said, outcome = replay.properties, replay.outcome
    settings = json.loads(said.get("settings", "{}"))
    yield {"command": " ".join(json.loads(said.get("command", "[]"))) or None, "seed": settings.get("seed")}
    yield {"version": json.loads(said.get("versions", "{}")).get("deformscope"), "label": settings.get("label") or None}
    yield {
        "complete": bool(outcome.get("complete")),
        "frames": outcome.get("frames"),
        "stopped": outcome.get("stopped"),
    }
    counts = json.loads(outcome.get("counts", "{}"))
    devices = sorted(name.removesuffix("/frames") for name in counts if name.endswith("/frames"))
    yield {"devices": ", ".join(devices) or None, "losses": named(json.loads(outcome.get("losses", "{}"))) or None}
    index = read_index(replay.path)
    yield {"duration_s": max((one.to_s for one in index if one.to_s is not None), default=None)}
    yield to_cells({"settings": settings} if isinstance(settings, dict) else {})
    yield from _rows(replay)
    if "calibration/estimate" in {one.entity for one in index} or not index:
        yield from _estimates(replay)


def _rows(replay: Replay) -> Iterator[dict[str, Any]]:
    """Remarks, and the last results of an exploration or a squeeze."""
    notes, last, touches = list[SessionNote](), dict[type, Any](), list[TouchEstimate]()
    for row in read_rows(replay, (SessionNote, TouchEstimate, MapEstimate, SqueezeEvents, ContentPosterior)):
        if isinstance(row.item, SessionNote):
            notes.append(row.item)
        elif isinstance(row.item, TouchEstimate):
            touches.append(row.item)
        last[type(row.item)] = row.item
    discards = discards_of(replay.path, notes)
    yield {"notes": "; ".join(one.text for one in notes if one.about == "note") or None}
    yield {"discarded": "; ".join(map(str, discards)) or None}
    if touches:
        yield _of_touches(touches)
    if (found := last.get(MapEstimate)) is not None:
        about = {"verdict": found.verdict, "verdict_probability": found.probability, "region_count": found.region_count}
        yield {name: value for name, value in (about | {"iou": found.iou}).items() if value is not None}
    if (events := last.get(SqueezeEvents)) is not None:
        yield {"steady_after_s": (events.steady_ns - events.first_ns) / 1e9}
    if (answer := last.get(ContentPosterior)) is not None:
        yield cells_of(answer)


def _of_touches(touches: list[TouchEstimate]) -> dict[str, Any]:
    """How many there are, and the softest place with its interval [N/mm]."""
    found: dict[str, Any] = {"touches": len(touches)}
    if usable := [one for one in touches if one.usable]:
        softest = min(usable, key=lambda one: one.stiffness_n_per_mm)
        low, high = softest.stiffness_interval
        found |= {"stiffness": softest.stiffness_n_per_mm, "stiffness" + LOW: low, "stiffness" + HIGH: high}
    return found


def _estimates(replay: Replay) -> Iterator[dict[str, Any]]:
    """The last result of a calibration, of whatever kind declares it."""
    for kind in (Estimate, AxisEstimate, FieldEstimate, YieldEstimate, RecoveryEstimate):
        if found := read_found(replay, kind):
            yield cells_of(found[-1].as_json())
            return
    if curves := read_found(replay, IndentEstimate):
        yield cells_of(combine(curves) if len(curves) > 1 else curves[0])
