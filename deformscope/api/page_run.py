"""A rig that is watched on a page: its devices stay open while files come and go as the page's buttons say."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from deformscope.api.rigs import Interruption
from deformscope.frames import HealthReport, Item, LinkChange, SessionNote, Stream, host_ns
from deformscope.page.desk import Desk
from deformscope.page.messages import (
    BeginEpisode,
    DeviceState,
    EndEpisode,
    Outcome,
    PageCommand,
    StartRecording,
    StopRecording,
    StopRun,
    TareDevice,
    WriteNote,
)
from deformscope.recording.losses import since
from deformscope.recording.recorder import Recorder, RecordingSummary
from deformscope.rig.source import RigSource
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.health import Health

MakeRecorder = Callable[[Path | None, Literal["page", "none"]], Recorder]
ROOM = 2.0
"""While it goes on, a recording takes so many times its size on the disk."""


@dataclass(slots=True)
class _FileTake:
    """One file. before: the devices as they were when it began, None = with their opening; begun: it has its streams"""

    recorder: Recorder
    path: Path
    before: HealthReport | None = None
    begun: bool = False


class PageRecorder:
    """A session's recorder whose file is begun and ended from a page, and which carries out the page's other commands.

    make: a recorder into this file, or none, with this viewer; file: to begin with, None = no file yet
    next_file: a name for each that follows; ended: is set where the page asks to stop
    """

    def __init__(
        self, make: MakeRecorder, file: Path | None, next_file: Callable[[], Path], ended: Interruption
    ) -> None:
        self._make, self._next_file, self._ended = make, next_file, ended
        self._watch = make(None, "page")
        self._take = None if file is None else _FileTake(make(file, "none"), file)
        self._source: RigSource | None = None
        self._streams: tuple[Stream, ...] = ()
        self._lossless: Sequence[str] = ()
        self._stages: Sequence[tuple[str, str]] = ()
        self._notes: list[SessionNote] = []
        self._episode = ""
        self._busy: set[str] = set()
        self._threads: list[threading.Thread] = []
        self._failure: Exception | None = None
        self._last: HealthReport | None = None
        self.summaries: list[RecordingSummary] = []
        # Held for moments alone: by the session as it hands over, by the page's server as it obeys.
        self._lock = threading.RLock()

    @property
    def desk(self) -> Desk:
        assert self._watch.page is not None
        return self._watch.page.desk

    def __enter__(self) -> PageRecorder:
        with ExitStack() as stack:
            if self._take is not None:
                stack.enter_context(self._take.recorder)  # its name is taken before anything is opened
            self._watch.__enter__()
            stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for thread in self._threads:
            thread.join()
        try:
            if self._take is not None:
                self._take.recorder.__exit__(kind, error, trace)
                self.summaries.append(self._take.recorder.summary())
        finally:
            self._watch.__exit__(kind, error, trace)
        if kind is None and self._failure is not None:
            raise self._failure

    # As a session's recorder -----------------------------------------------------------------------------------------

    def start_source(self, source: RigSource, lossless: Sequence[str], stages: Sequence[tuple[str, str]]) -> None:
        """From here on these devices are recorded, and commands are obeyed."""
        self._source, self._streams, self._lossless, self._stages = source, source.streams, lossless, stages
        self._watch.start_rig(self._streams, source.start_ns, lossless, stages)
        if self._take is not None:
            self._take.recorder.start_rig(self._streams, source.start_ns, lossless, stages)
            self._take.begun = True
        tares = tuple(stream.device for stream in self._streams if hasattr(source.device(stream.device), "zero"))
        self.desk.attend(self)
        self.desk.show(tares=tares)
        self._enter()

    def write(self, items: object) -> None:
        """As `Recorder.write`."""
        self._watch.write(items)
        with self._lock:
            if self._take is not None:
                self._write_to(self._take, items)
        if isinstance(items, Sequence):
            self._show(items)

    def stopped_because(self, reason: str) -> None:
        """As `Recorder.stopped_because`."""
        self._watch.stopped_because(reason)
        with self._lock:
            if self._take is not None:
                self._take.recorder.stopped_because(reason)

    def summary(self) -> RecordingSummary:
        """Of the last file; where there was none, of what was watched."""
        return self.summaries[-1] if self.summaries else self._watch.summary()

    def _write_to(self, take: _FileTake, items: object) -> None:
        given = [*items, *self._notes] if isinstance(items, Sequence) else items
        if isinstance(given, list):
            self._notes.clear()
            if not take.begun and given:
                assert self._source is not None
                take.before, take.begun = self._source.look(), True
                take.recorder.start_rig(self._streams, min(map(host_ns, given)), self._lossless)
            if take.before is not None:
                before = take.before
                given = [since(item, before) if isinstance(item, HealthReport) else item for item in given]
        take.recorder.write(given)

    def _show(self, items: Sequence[Item]) -> None:
        for item in items:
            if isinstance(item, HealthReport):
                self._last = item
                self._show_devices(item)
            elif isinstance(item, LinkChange):
                reason = f": {item.event.reason}" if item.event.reason else ""
                bad = item.event.link in ("lost", "failed")
                self.desk.remark(f"{item.device}: {item.event.link}{reason}", bad=bad)

    def _show_devices(self, report: HealthReport) -> None:
        known = {stream.device: stream for stream in self._streams}
        changes: dict[str, Any] = {
            "devices": tuple(device_state(name, health, known.get(name)) for name, health in report.devices)
        }
        with self._lock:
            if self._take is not None:
                size = self._take.recorder.summary().bytes
                lasted_s = self.desk.state.now_s - self.desk.state.recorded_since_s
                free = shutil.disk_usage(self._take.path.parent).free
                changes["recorded_bytes"] = size
                changes["free_minutes"] = free / (ROOM * size / lasted_s) / 60.0 if size and lasted_s > 1.0 else None
        self.desk.show(**changes)

    # As a page's run -------------------------------------------------------------------------------------------------

    def obey(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.obey`."""
        with self._lock:
            match command:
                case StopRun():
                    self._ended.by = "from the page"
                    self._ended.set()
                    return "done", "it ends now"
                case StartRecording():
                    return self._start_file()
                case StopRecording():
                    return self._stop_file()
                case WriteNote():
                    self._note("note", command.text)
                    return "done", "noted"
                case BeginEpisode():
                    self._end_episode()
                    self._episode = command.label
                    self._note("episode-begin", command.label)
                    self._enter()
                    return "done", f"episode {command.label} began"
                case EndEpisode():
                    label = self._end_episode()
                    self._enter()
                    return "done", f"episode {label} ended"
                case TareDevice():
                    return self._tare(command.device)
                case _:
                    return "refused", "not while a rig is watched"

    def _enter(self) -> None:
        """Have the state say what goes on, and what can be asked for."""
        take = self._take
        commands = ["stop", *(["tare"] if self.desk.state.tares else [])]
        if take is None:
            # stages begin with the first frame: a file that begins later could not be replayed with them
            commands += [] if self._stages or self._busy & {"file"} else ["start-recording"]
            self.desk.enter("live", recording="", episode="", commands=tuple(commands), free_minutes=None)
            return
        commands += ["write-note", "begin-episode", *(["end-episode"] if self._episode else [])]
        commands += [] if self._stages else ["stop-recording"]
        changes: dict[str, Any] = {"commands": tuple(commands), "episode": self._episode}
        if self.desk.state.recording == str(take.path):
            self.desk.enter("recording", **changes)
        else:
            self.desk.recording_began(str(take.path), **changes)

    def _note(self, about: Literal["note", "episode-begin", "episode-end", "tare"], text: str) -> None:
        if self._take is not None:
            self._notes.append(SessionNote(monotonic_ns(), about, text))

    def _end_episode(self) -> str:
        label, self._episode = self._episode, ""
        if label:
            self._note("episode-end", label)
        return label

    def _start_file(self) -> tuple[Outcome, str]:
        path = self._next_file()
        self._beside("file", lambda: self._open_file(path))
        self._enter()
        return "begun", str(path)

    def _open_file(self, path: Path) -> None:
        recorder = self._make(path, "none")
        recorder.__enter__()
        with self._lock:
            self._take = _FileTake(recorder, path)
            self._enter()

    def _stop_file(self) -> tuple[Outcome, str]:
        take = self._take
        assert take is not None
        self._end_episode()
        if take.begun and self._source is not None:
            self._write_to(take, [self._source.look()])
        self._take = None
        self._beside("file", lambda: self._close_file(take))
        self._enter()
        return "begun", f"{take.path} is being closed"

    def _close_file(self, take: _FileTake) -> None:
        take.recorder.stopped_because("ended from the page")
        try:
            take.recorder.__exit__(None, None, None)
        except Exception as error:
            self._failure = error
            raise
        summary = take.recorder.summary()
        self.summaries.append(summary)
        self.desk.remark(f"recorded {summary.path} ({summary.bytes / 1e6:.1f} MB)")

    def _tare(self, name: str) -> tuple[Outcome, str]:
        if name not in self.desk.state.tares or self._source is None:
            return "refused", f"expected one of {', '.join(self.desk.state.tares)}; got {name}"
        if name in self._busy:
            return "refused", f"{name} is being tared"
        device: Any = self._source.device(name)

        def tare() -> None:
            device.zero()
            with self._lock:
                self._note("tare", name)
            self.desk.remark(f"{name}: tared")

        self._beside(name, tare)
        return "begun", f"{name}: its load is taken for zero; let nothing touch it"

    def _beside(self, what: str, call: Callable[[], None]) -> None:
        """Do what takes its time in a thread of its own; what goes wrong becomes a remark."""
        self._busy.add(what)

        def work() -> None:
            try:
                call()
            except Exception as error:
                self.desk.remark(f"{what}: {error}", bad=True)
            finally:
                with self._lock:
                    self._busy.discard(what)
                    if self.desk.state.phase != "stopped":
                        self._enter()

        thread = threading.Thread(target=work, name=f"deformscope-page-{what}", daemon=True)
        self._threads.append(thread)
        thread.start()


def device_state(name: str, health: Health, stream: Stream | None) -> DeviceState:
    """A device as a page shows it."""
    from deformscope.log.rig.health import word  # it brings rerun

    return DeviceState(
        name=name,
        state=word(health, stream),
        simulated=stream is not None and stream.simulated,
        rate_hz=health.rate_hz,
        age_s=health.age_s,
        received=health.received,
        lost=health.lost,
        dropped=health.dropped,
        refused=sum(health.refused.values()),
        bad_bytes=health.skipped_bytes,
        reconnects=health.reconnects,
        reason=health.reason,
    )
