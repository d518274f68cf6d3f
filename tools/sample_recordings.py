"""The recordings in `recordings/` that are to be opened first: an exploration, a squeeze and a rig, small.

python tools/sample_recordings.py [NAME...]      make samples

Runs the commands of `SAMPLES` in the laboratory, leaves out frames that no result is computed from, and writes ledgers
and manifest. A replay of what is left gives the same numbers; that is tried before a sample takes its place.
"""

import argparse
import hashlib
import json
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from deformscope.cli import main
from deformscope.images import PNG_SIGNATURE
from deformscope.lab import container_setup, scene_lab, touch_lab
from deformscope.recording.facts import read_facts, run_rrd
from deformscope.recording.items import read_results
from deformscope.recording.ledger import write_ledger
from deformscope.recording.reader import Replay, read_rows
from deformscope.stages.map.measured import LookFrames, TouchFrames
from deformscope.stages.squeeze.events import SqueezeEvents
from deformscope.stages.squeeze.trial import SqueezePhase
from deformscope.version import __version__

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
MOST_BYTES = 3_000_000
CAMERA_HZ = 4.0
"""Of the squeeze's camera, whose images are most of its bytes."""
CAMERA_PX = {"width": 160, "height": 120}
"""Of the exploration's camera."""
FORCE_HZ = 333.0
"""Of the exploration's force sensor."""
EVERY = {"depth": 40, "wrench": 20, "arm": 5}
"""Of rows that nothing is computed from, one in so many stays to be looked at, by the first part of their entity."""
USED = {
    "depth": ("depth_ns",),
    "wrench": ("wrench_ns",),
    "arm": ("arm_ns", "pose_ns", "depth_arm_ns", "end_ns", "held_ns"),
}
"""Fields of an exploration's inputs that name rows of each kind of device by their host times [ns]."""


@dataclass(frozen=True, slots=True)
class Sample:
    """command: that records it, before: that is run first; both may name files in {folder}
    keep: gives, of a recording, which rows of a kind of device stay by their host times
    """

    command: str
    what: str
    seed: int
    before: str = ""
    keep: Callable[[Path], Callable[[str, Any], Any]] = lambda path: everything


def used_by_touches(path: Path) -> Callable[[str, Any], Any]:
    """Which rows of an entity an exploration is computed from, by their host times [ns]."""
    used: dict[str, set[int]] = {kind: set() for kind in USED}
    for row in read_results(path, (LookFrames, TouchFrames), trust=True):
        for kind, names in USED.items():
            for value in (getattr(row.item, name, None) for name in names):
                used[kind].update(map(int, np.atleast_1d([] if value is None else value)))
    every = {kind: np.array(sorted(found), np.int64) for kind, found in used.items()}
    return lambda kind, host_ns: np.isin(host_ns, every[kind])


def used_by_squeeze(path: Path) -> Callable[[str, Any], Any]:
    """The same of a squeeze: images from when the fingertips are in the air until they open again, all else."""
    replay = Replay(path, trust=True)
    (events,) = (row for row in read_rows(replay, (SqueezeEvents,)))
    start_ns = events.item.steady_ns - events.session_ns
    phases = {row.item.name: row.session_ns for row in read_rows(replay, (SqueezePhase,))}
    first_ns, last_ns = start_ns + phases["air"], start_ns + phases["open"]
    return lambda kind, host_ns: (kind != "depth") | ((host_ns >= first_ns) & (host_ns < last_ns))


def everything(kind: str, host_ns: Any) -> Any:
    """Every row of a rig stays: its bytes are decoded again."""
    return np.ones(len(host_ns), bool)


SAMPLES = {
    "explore": Sample(
        "explore lab:buried --touches 2 --pace quick --seed 3 --viewer none",
        "Two touches of a simulated piece of foam, 20 by 20 cm, its camera at 160 x 120 pixels, with its maps",
        3,
        keep=used_by_touches,
    ),
    "squeeze": Sample(
        "squeeze lab:containers --model {folder}/contents.npz --content rice --container box-01 --seed 4 --viewer none",
        "A squeeze of a simulated carton of rice, its camera at 4 Hz, its content named meanwhile",
        4,
        "classify sample:squeezes --quick --viewer none --save {folder}/contents.npz",
        keep=used_by_squeeze,
    ),
    "rig": Sample(
        "record recordings/rig.toml --seconds 3.6 --stage flow --stage beta --stage surface --stage tactile"
        " --viewer none",
        "All kinds of devices on a bench, as doubles, with stages that are computed meanwhile",
        0,
    ),
}


def thinned(chunk: Chunk, keep: Callable[[str, Any], Any]) -> list[Chunk]:
    """A portion without the rows of devices that nothing is computed from, but for one in some; images in fewer bytes
    than there is time for while devices run."""
    kind, batch = kind_of(chunk), chunk.to_record_batch()
    if kind == "raw" and not chunk.is_static and keep is not everything:
        return []
    if str(chunk.entity_path).startswith("/display/perception/maps/"):
        return []  # large views of what other entities hold
    if kind in EVERY and not chunk.is_static and keep is not everything:
        names = [name for name in batch.schema.names if name.endswith("Frame:stamp.host_ns")]
        stays = np.arange(batch.num_rows) % EVERY[kind] == 0
        if names:
            stays = keep(kind, np.array([cell[0] for cell in batch.column(names[0]).to_pylist()])) | stays
        batch = batch.take(np.flatnonzero(stays))
    for name in set(batch.schema.names) & CHANGED.keys():
        column = batch.column(name)
        cells = [None if cell is None else [CHANGED[name](cell[0])] for cell in column.to_pylist()]
        place = batch.schema.get_field_index(name)
        batch = batch.set_column(place, batch.schema.field(place), pa.array(cells, column.type))
    return list(Chunk.from_record_batch(batch)) if len(batch) else []


def _again(encoded: list[int]) -> list[int]:
    """The same pixels in fewer bytes; what is no PNG as it is."""
    given = np.array(encoded, np.uint8).tobytes()
    if not given.startswith(PNG_SIGNATURE):
        return encoded
    image = cv2.imdecode(np.frombuffer(given, np.uint8), cv2.IMREAD_UNCHANGED)
    made = [given]
    for chosen in (cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_FILTER_SUB):
        how = [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_STRATEGY, 1, cv2.IMWRITE_PNG_FILTER, chosen]
        made.append(cv2.imencode(".png", image, how)[1].tobytes())
    return list(min(made, key=len))


def _without_folder(stream: str) -> str:
    """What is known of a device, its files named from the checkout on."""
    return stream.replace(f"{RECORDINGS.parent}/", "")


CHANGED: dict[str, Callable[[Any], Any]] = {
    "EncodedDepthImage:blob": _again,
    "EncodedImage:blob": _again,
    "stream": _without_folder,
}
"""What becomes of each value of a column, by its name."""


def kind_of(chunk: Chunk) -> str:
    """The first part of its entity; of what is drawn of an arm, the arm."""
    first, *further = str(chunk.entity_path).strip("/").split("/")
    return "arm" if (first, *further[:1]) == ("display", "arm") else first


def thin(whole: Path, keep: Callable[[str, Any], Any]) -> Path:
    """A recording without the rows that nothing is computed from; its views stay."""
    reader = RrdReader(whole)
    (store,) = reader.recordings()
    paths = {
        str(one.entity_path)
        for one in reader.stream(store=store).to_chunks()
        if kind_of(one) in (*EVERY, "raw", "display")
    }
    rows, rest, less = (whole.with_name(f"{one}.rrd") for one in ("rows", "rest", "less"))
    stream = reader.stream(store=store).filter(content=sorted(paths)).flat_map(partial(thinned, keep=keep))
    stream.write_rrd(rows, application_id=store.application_id, recording_id=store.recording_id)
    drop = [word for path in sorted(paths) for word in ("--drop-entity", path)]
    if refused := run_rrd("filter", *drop, whole, "-o", rest) or run_rrd("merge", rest, rows, "-o", less):
        raise SystemExit(refused)
    return less


def make(name: str, sample: Sample) -> dict[str, object]:
    """Record a sample, and put it in its place once a replay of it gives the same; its line of the manifest."""
    with tempfile.TemporaryDirectory() as scratch:
        whole = Path(scratch) / f"{name}.rrd"
        if sample.before and main(sample.before.format(folder=scratch).split()):
            raise SystemExit(f"{sample.before} failed")
        if main([*sample.command.format(folder=scratch).split(), "--record", str(whole)]) not in (0, 3):
            raise SystemExit(f"{name} was not recorded")
        less = thin(whole, sample.keep(whole))
        facts = read_facts(less)
        write_ledger(less, facts.counts, facts.losses)
        size = less.stat().st_size
        if main(["replay", str(less)]) or size > MOST_BYTES:
            raise SystemExit(f"{name} ({size} bytes) is not to be replaced")
        path = RECORDINGS / f"{name}.rrd"
        path.write_bytes(less.read_bytes())
        write_ledger(path, facts.counts, facts.losses)
    return {
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "command": " && ".join(
            f"deformscope {one.format(folder='runs')}"
            for one in (sample.before, f"{sample.command} --record recordings/{path.name}")
            if one
        ),
        "seed": sample.seed,
        "rerun": version("rerun-sdk"),
        "deformscope": __version__,
        "what": sample.what,
    }


def run() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(SAMPLES)}; default: all")
    names = parser.parse_args().name or list(SAMPLES)
    container_setup.container_lab = partial(container_setup.container_lab, camera_hz=CAMERA_HZ)
    view = scene_lab.DepthViewConfig
    scene_lab.DepthViewConfig = lambda **given: view(**(given | CAMERA_PX))  # type: ignore[misc, assignment]
    touch_lab.OptoforceConfig = partial(touch_lab.OptoforceConfig, rate_hz=FORCE_HZ)  # type: ignore[misc, assignment]
    manifest = RECORDINGS / "manifest.toml"
    text = manifest.read_text(encoding="utf-8")
    entries = {one["file"]: one for one in tomllib.loads(text)["recording"]}
    for name in names:
        found = make(name, SAMPLES[name])
        entries[str(found["file"])] = found
    lines = [line for line in text.splitlines() if line.startswith("#")]
    for entry in entries.values():
        lines += ["", "[[recording]]", *(f"{key} = {json.dumps(value)}" for key, value in entry.items())]
    manifest.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run()
