"""Messages between the page's script and its server: JSON objects with a `kind`, all of one version.

A page says `Hello` first. From then on it gets a `PageState` with every change, and a `CommandReply` to each command;
its `Beat`s get no reply."""

from typing import Annotated, Literal

import msgspec

VERSION = 1
"""Version of these messages. A page of another version is refused, and has to be loaded again."""
LONGEST_MESSAGE = 16 << 10
"""Most bytes of a message from a page."""

Phase = Literal["idle", "live", "recording", "exploring", "squeezing", "paused", "stopped"]
Outcome = Literal["done", "begun", "refused"]
Words = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
Number = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Length = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]


class FromPage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """id: number that the reply repeats"""

    id: Number


class Hello(FromPage, frozen=True, tag="hello"):
    """The first message. version: version of the page's script; page: its unique name, reused after reconnection"""

    version: int
    page: Name


class Beat(FromPage, frozen=True, tag="beat"):
    """Sign that the page is present, ten times a second. visible: whether the page is visible"""

    visible: bool


class TakeControls(FromPage, frozen=True, tag="take-controls"):
    """From now on only this page steers."""


class StartRecording(FromPage, frozen=True, tag="start-recording"):
    """Record into a new file."""


class StopRecording(FromPage, frozen=True, tag="stop-recording"):
    """End the recording: its file gets its name; the devices stay open."""


class KeepRecent(FromPage, frozen=True, tag="keep-recent"):
    """Record the held last seconds, into a separate file."""


class WriteNote(FromPage, frozen=True, tag="write-note"):
    """Write a note into the recording, at the time of its arrival."""

    text: Words


class BeginEpisode(FromPage, frozen=True, tag="begin-episode"):
    label: Words


class EndEpisode(FromPage, frozen=True, tag="end-episode"): ...


class DiscardPart(FromPage, frozen=True, tag="discard"):
    """Mark the newest episode of the file, or the whole file, as not to be used. Nothing is deleted."""

    what: Literal["episode", "recording"]
    reason: Words


class TareDevice(FromPage, frozen=True, tag="tare"):
    """Use the device's present load as its zero."""

    device: Name


class StopRun(FromPage, frozen=True, tag="stop"):
    """End the run. Stop the run, from any page, with or without the controls."""


class ConfirmMove(FromPage, frozen=True, tag="confirm"):
    """Carry out the waiting motion. number: number of the `PendingMove`"""

    number: Number


class SeeMove(FromPage, frozen=True, tag="seen"):
    """The page has drawn the request for a confirmation: its time counts from now. number: the `PendingMove`'s"""

    number: Number


class CancelMove(FromPage, frozen=True, tag="cancel"):
    """Cancel the request for a confirmation."""

    number: Number


class StartExploring(FromPage, frozen=True, tag="explore"):
    """Begin the planned touches, or continue them. Waits for a confirm."""


class PauseExploring(FromPage, frozen=True, tag="pause"):
    """Begin no further touch. A touch that has begun is completed."""


class StartSqueezing(FromPage, frozen=True, tag="squeeze"):
    """Permit the hand's waiting motion. Waits for a confirm."""


class VetoTouch(FromPage, frozen=True, tag="veto"):
    """Do not touch the planned place: choose another one."""


class TouchNext(FromPage, frozen=True, tag="touch-next"):
    """Touch the planned place, and pause again. Waits for a confirm."""


class TouchAt(FromPage, frozen=True, tag="touch-at"):
    """Touch this place of the surface [m], and pause again. Waits for a confirm."""

    x_m: Length
    y_m: Length


class TouchPicked(FromPage, frozen=True, tag="touch-picked"):
    """Touch a place selected in the viewer: an entity, and the place on it [m, the view's frame]."""

    entity: Words
    position_m: tuple[Length, Length, Length]


PageCommand = (
    TakeControls
    | StartRecording
    | StopRecording
    | KeepRecent
    | WriteNote
    | BeginEpisode
    | EndEpisode
    | DiscardPart
    | TareDevice
    | StopRun
    | ConfirmMove
    | SeeMove
    | CancelMove
    | StartExploring
    | PauseExploring
    | StartSqueezing
    | VetoTouch
    | TouchNext
    | TouchAt
    | TouchPicked
)


class ToPage(msgspec.Struct, frozen=True, tag_field="kind"):
    """A message to the page."""


class CommandReply(ToPage, frozen=True, tag="reply"):
    """Reply to the command with this id. begun: a later state's remarks will have the outcome; words: for people"""

    id: int
    outcome: Outcome
    words: str = ""


class DriftState(msgspec.Struct, frozen=True):
    """Drift of a force sensor since its tare, while nothing touches it. lasted_s: time since then [s]; unit: N or
    counts

    now: present drift of each axis; line: its length at equal distances in time, from the tare to now; empty before it
    is known; loaded: the force changes faster than any drift, so that something touches the sensor; `now` and `line`
    are older"""

    lasted_s: float
    unit: str
    now: tuple[float, ...]
    line: tuple[float, ...]
    loaded: bool = False


class DeviceState(msgspec.Struct, frozen=True):
    """State of one device, from its health. state: state in one word; rate_hz: readings a second [1/s]; age_s: age of
    the newest [s]

    jitter_s: standard deviation of the time between readings [s]; drift: drift of a force sensor"""

    name: str
    state: str
    simulated: bool = False
    rate_hz: float = 0.0
    age_s: float | None = None
    jitter_s: float = 0.0
    received: int = 0
    lost: int = 0
    dropped: int = 0
    refused: int = 0
    bad_bytes: int = 0
    reconnects: int = 0
    reason: str = ""
    drift: DriftState | None = None


class Remark(msgspec.Struct, frozen=True):
    """A remark on an event. number: from 1; at_s: time since the page's server began [s]"""

    number: int
    at_s: float
    words: str
    bad: bool = False


class PendingMove(msgspec.Struct, frozen=True):
    """Something that moves when it is confirmed. number: number that a confirmation repeats; what: the motion; until_s:
    when it expires, on the clock of `PageState.now_s`; seen: the page that steers has drawn the request"""

    number: int
    what: str
    until_s: float
    seen: bool = False


class NextPlace(msgspec.Struct, frozen=True):
    """The planned next touch [m], and its reason."""

    x_m: float
    y_m: float
    reason: str


class ForceCurve(msgspec.Struct, frozen=True):
    """The forecast of a touch's force curve, and the measured one.

    x_m, y_m: where; known: source of the forecast, as text; force_n: forces; depth_mm, depth_low_mm,
    depth_high_mm: the dent at each force, and its 90 % interval; felt_mm, felt_n: measured curve, empty before the
    touch; words: how the two compare"""

    x_m: float
    y_m: float
    known: str
    force_n: tuple[float, ...]
    depth_mm: tuple[float, ...]
    depth_low_mm: tuple[float, ...]
    depth_high_mm: tuple[float, ...]
    felt_mm: tuple[float, ...] = ()
    felt_n: tuple[float, ...] = ()
    words: str = ""


class Chapter(msgspec.Struct, frozen=True):
    """A part of a recording, by the time since its start [ns]."""

    name: str
    from_ns: int
    until_ns: int


class Playback(msgspec.Struct, frozen=True):
    """A recording that a page plays.

    timeline: timeline of the viewer; from_ns, until_ns: its ends [ns]; step_ns: step time of a single step; layer: a
    file of the page that is shown over the recording, empty = none"""

    timeline: str
    until_ns: int
    step_ns: int
    chapters: tuple[Chapter, ...] = ()
    layer: str = ""
    from_ns: int = 0


class PageState(ToPage, frozen=True, tag="state"):
    """State that a page shows around the viewer.

    now_s: time since the server began [s]; title: title of the session; reason: why it stopped; recording: the file;
    recorded_since_s: when the recording began, on the clock of now_s; free_minutes: time until the disk is full at the
    present rate; episode: label of the present one; held_s: number of last seconds that can still be recorded
    commands: requests that are possible at present, by kind; tares: devices that can be tared
    controls: the page that steers; pages: how many there are; pending: motion that waits for a confirmation;
    next_place, curve: next place and curve of an exploration; beat_s: time without a `Beat` after which motions stop
    that a page confirmed [s]; playback: playback of a page that shows a recording"""

    version: int = VERSION
    now_s: float = 0.0
    title: str = ""
    phase: Phase = "idle"
    reason: str = ""
    devices: tuple[DeviceState, ...] = ()
    recording: str = ""
    recorded_since_s: float = 0.0
    recorded_bytes: int = 0
    free_minutes: float | None = None
    held_s: float | None = None
    episode: str = ""
    commands: tuple[str, ...] = ()
    tares: tuple[str, ...] = ()
    remarks: tuple[Remark, ...] = ()
    controls: str = ""
    pages: int = 0
    pending: PendingMove | None = None
    next_place: NextPlace | None = None
    curve: ForceCurve | None = None
    beat_s: float = 0.3
    playback: Playback | None = None


class Drawn(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """From the page, over the viewer's websocket: all batches up to this one were drawn."""

    batch: Number


class PieceBatch(msgspec.Struct, frozen=True):
    """To the page, after the pieces of a batch. behind_s: age of the newest drawn piece when this batch was sent;
    skipped: pieces so far that were too old to be sent; until_ns: session time of its newest data [ns], 0 = unknown"""

    batch: int
    last: int
    until_ns: int
    behind_s: float | None
    skipped: int
