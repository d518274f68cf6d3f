"""The recording and views of a rig: every item without loss, in batches, and views for people.

Measurements are at `KIND/DEVICE`, one row per frame, each field of it a component (`deformscope.rows`);
`deformscope.recording.items` reads them. Every row is at `session`, the time since the recording's start, and frames
also at `frame`, their place in the device's own stream. In an exploration's recording that place is on the timeline
`index`, and `frame` is the depth camera's frame for all devices.

    wrench/DEVICE             counts, forces, flags; below it plots force_n/CHANNEL and torque_nm/CHANNEL
    tactile/DEVICE            counts, pressures; below it the plot peak_kpa, one value a pad
    arm/DEVICE, hand/DEVICE   all quantities; below them plots of some, as joint_deg
    color/DEVICE              the image: JPEG, or PNG without loss
    depth/DEVICE              the image: PNG without loss, and the colour image on its pixels as a component
    raw/DEVICE                the bytes on the wire, received or sent
    link/DEVICE               when the link was made and lost, and why
    input                     files that were given, with their names
    note                      notes, episodes and tares
    health                    a table for people; below it each device's counters
    display/...               false colours, labels and transforms, all derived from the above"""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import rerun as rr

from deformscope import frames
from deformscope.log.rig import health
from deformscope.log.rig.arm import log_pose, log_shape
from deformscope.log.rig.blueprint import rig_blueprint
from deformscope.log.rig.cameras import log_color, log_depth
from deformscope.log.rig.columns import Batch, Place, Shown, moments, recorded, root, states
from deformscope.log.rig.numbers import log_numbers, log_numbers_stream
from deformscope.log.rig.tactile import Hand, log_hand, log_tactile
from deformscope.rows import ENTITIES, to_json
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link, LinkEvent

__all__ = [
    "Batch",
    "Place",
    "Shown",
    "log_items",
    "log_streams",
    "prepare_input",
    "prepare_items",
    "rig_blueprint",
    "warm_up",
]

NUMBERS = {frames.WrenchFrame: "wrench", frames.ArmFrame: "arm", frames.HandFrame: "hand"}


def log_streams(rec: rr.RecordingStream, streams: Sequence[frames.Stream]) -> None:
    """Descriptions before the first frame: names and colours of series, pads, the arm's shape."""
    for stream in streams:
        rec.log(root(stream.kind, stream.device), rr.AnyValues(stream=to_json(stream)), static=True)
        log_numbers_stream(rec, stream)
        if stream.kind == "tactile" and stream.pads:
            log_hand(rec, stream.device, Hand.of(stream.pads))
        elif stream.kind == "arm":
            log_shape(rec, stream)
    for device in sorted({stream.device for stream in streams}):
        rec.log(root("link", device), states(health.LINK_COLORS), static=True)
        rec.log(root("health", device), states(health.COLORS), static=True)


def log_items(
    rec: rr.RecordingStream,
    items: Sequence[frames.Item],
    start_ns: int,
    streams: Sequence[frames.Stream],
    lossless: Collection[str] = (),
) -> None:
    """Log a batch of items to one stream; arguments as in `prepare_items`."""
    prepare_items(items, start_ns, streams, lossless).send(rec)


def prepare_items(
    items: Sequence[frames.Item],
    start_ns: int,
    streams: Sequence[frames.Stream],
    lossless: Collection[str] = (),
    place: Place | None = None,
    shown: Shown | None = None,
    *,
    changes_only: bool = False,
) -> Batch:
    """Prepare a batch of items, in any order, for one stream or several. The cost is for each device; a single item
    costs little.

    start_ns: host time at which `session` is 0 [ns]; lossless: devices whose 8 bit colour images are stored as PNG
    rather than JPEG, because something is computed from them (about 9 ms for 640 x 480 instead of 1 ms, and ten times
    the bytes); place: place on an exploration's timelines
    shown: data that a viewer has already, reused from call to call: they are not sent again
    changes_only: log only changes of a device's state relative to `shown`"""
    batch = Batch(place)
    known = {(stream.kind, stream.device): stream for stream in streams}
    by_device: dict[tuple[type, str], list[Any]] = {}
    for item in items:
        by_device.setdefault((type(item), getattr(item, "device", "")), []).append(item)
    for (kind, device), group in by_device.items():
        if kind in NUMBERS:
            log_numbers(batch, NUMBERS[kind], device, group, start_ns)
        if kind is frames.ArmFrame:
            log_pose(batch, device, group, start_ns, known.get(("arm", device)))
        elif kind is frames.TactileFrame:
            log_tactile(batch, device, group, start_ns, known.get(("tactile", device)), shown)
        elif kind is frames.ColorFrame:
            log_color(batch, device, group, start_ns, device in lossless)
        elif kind is frames.DepthFrame:
            log_depth(batch, device, group, start_ns, device in lossless, shown)
        elif kind is frames.RawBytes:
            times = moments([piece.host_ns for piece in group], start_ns)
            batch.send_columns(root("raw", device), times, recorded(group))
        elif kind is frames.LinkChange:
            health.log_link(batch, device, group, start_ns, streams)
        elif kind is frames.HealthReport:
            health.log_health(batch, group, start_ns, streams, shown if changes_only else None)
        elif kind is frames.SessionNote:
            health.log_notes(batch, group, start_ns)
        elif kind not in NUMBERS:
            raise TypeError(f"no twin in deformscope.log.rig shows a {kind.__name__}")
    return batch


def prepare_input(given: frames.InputFile, frame: int, session_ns: int) -> Batch:
    """Prepare an input for recording. frame, session_ns: when it was given"""
    batch = Batch()
    times = [*moments([session_ns], 0), rr.TimeColumn("frame", sequence=[frame])]
    batch.send_columns(ENTITIES[frames.InputFile], times, recorded([given]))
    return batch


def warm_up() -> None:
    """Start rerun and the encoders before any device is opened, which takes up to half a second."""
    stamp, nothing = Stamp(0), np.zeros(3)
    small: list[frames.Item] = [
        frames.WrenchFrame(stamp, 0, np.zeros(3, np.int64), nothing[None]),
        frames.TactileFrame(stamp, 0, np.zeros(4, np.uint16), (np.zeros((2, 2)),)),
        frames.ColorFrame(stamp, 0, np.zeros((16, 16, 3), np.uint8), "color"),
        frames.DepthFrame(stamp, 0, np.full((16, 16), 1000, np.uint16), 0.001),
        frames.RawBytes(0, b"\0", False, "wrench"),
        frames.LinkChange(LinkEvent(0, Link.CONNECTED), "wrench"),
        frames.HealthReport(0, (("wrench", Health(Link.CONNECTED)),)),
    ]
    rec = rr.RecordingStream("deformscope-warm-up", send_properties=False)
    rec.memory_recording()
    log_items(rec, small, 0, ())
    rec.disconnect()
