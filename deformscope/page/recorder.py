"""A rig that is watched on a page: its devices stay open while the page's buttons begin and end files."""

import shutil
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol

from deformscope.frames import HealthReport, NoteKind, SessionNote, Stream, host_ns
from deformscope.log.layout import RigLayout
from deformscope.page.devices import ShownDevices
from deformscope.page.server import messages
from deformscope.page.server.page_session import PageSession
from deformscope.recording.lateness import RecordingError
from deformscope.recording.losses import since
from deformscope.recording.recent import RecentItems, end_with_recent, write_recent
from deformscope.recording.recorder import Recorder, RecordingSummary
from deformscope.rig.source import RigSource
from deformscope.terminal import Interruption, say
from deformscope_drivers.clock import monotonic_ns

ROOM = 2.0
"""Disk space of a running recording, as a multiple of its size."""


@dataclass(slots=True)
class _FileTake:
    """One file. before: the devices as they were when it began, None = with their opening; begun: it has its streams"""

    recorder: Recorder
    path: Path
    before: HealthReport | None = None
    begun: bool = False

    def write(
        self, items: object, source: RigSource | None, streams: tuple[Stream, ...], lossless: Sequence[str]
    ) -> None:
        """Record the device items of this source; a file that begins meanwhile begins with the first of them. streams:
        streams of the devices as they were opened; one that reconnects may have no kind"""
        if isinstance(items, Sequence):
            if not self.begun and items:
                assert source is not None
                self.before, self.begun = source.look(), True
                start_ns = min(map(host_ns, items)) - source.latest_ns  # what comes later may be put back so far
                self.recorder.start(RigLayout(streams), start_ns, lossless)
            if self.before is not None:
                before = self.before
                items = [since(item, before) if isinstance(item, HealthReport) else item for item in items]
        self.recorder.write(items)


class EpisodeNotes:
    """Notes that wait to be recorded, and the labels of the present and the last episode of the file, empty without
    one."""

    def __init__(self) -> None:
        self._waiting: list[SessionNote] = []
        self.episode = self.last_episode = ""

    def note(self, about: NoteKind, text: str) -> None:
        self._waiting.append(SessionNote(monotonic_ns(), about, text))

    def take(self) -> list[SessionNote]:
        """Remove and return the waiting notes."""
        notes, self._waiting = self._waiting, []
        return notes

    def begin(self, label: str) -> None:
        """Begin an episode, and end the one before it."""
        self.end()
        self.episode = self.last_episode = label
        self.note("episode-begin", label)

    def end(self) -> str:
        """End the episode; returns its label."""
        label, self.episode = self.episode, ""
        if label:
            self.note("episode-end", label)
        return label

    def discard(self, command: messages.DiscardPart) -> tuple[messages.Outcome, str]:
        """Mark the recording, or its last episode, as not to be used."""
        if command.what == "recording":
            self.note("discard-recording", command.reason)
            return "done", "the recording is marked as discarded; it continues"
        if not self.last_episode:
            return "refused", "no episode was begun in this file"
        self.note("discard-episode", command.reason)
        return "done", f"episode {self.last_episode} is marked as discarded"


class BackgroundWork:
    """Slow tasks, each in its own thread. failed: receives the error; ended: called after each task"""

    def __init__(self, failed: Callable[[str], None], ended: Callable[[str], None]) -> None:
        self.busy: set[str] = set()
        self._failed, self._ended = failed, ended
        self._threads: list[threading.Thread] = []

    def start(self, what: str, call: Callable[[], None]) -> None:
        self.busy.add(what)

        def work() -> None:
            try:
                call()
            except Exception as error:
                self._failed(f"{what}: {error}")
            finally:
                self._ended(what)

        thread = threading.Thread(target=work, name=f"deformscope-page-{what}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def join(self) -> None:
        for thread in self._threads:
            thread.join()


class MakeRecorder(Protocol):
    """A recorder into this file, or none, with this viewer; at_once: the items exist already, so that it may wait"""

    def __call__(self, file: Path | None, viewer: Literal["page", "none"], *, at_once: bool = False) -> Recorder: ...


class PageRecorder:
    """A session's recorder whose file is begun and ended from a page, and which carries out the page's other commands.

    file: the first file, None = none yet; next_file: gives a name for each further file
    ended: set if the page requests a stop; recent: the last seconds, which can still be recorded
    at_end: file for items that are in memory at the end"""

    def __init__(
        self,
        make: MakeRecorder,
        file: Path | None,
        next_file: Callable[[], Path],
        ended: Interruption,
        recent: RecentItems | None = None,
        *,
        at_end: Path | None = None,
    ) -> None:
        self._make, self._next_file, self._ended = make, next_file, ended
        self._recent = recent
        self._end_message = None if at_end is None else make(at_end, "none", at_once=True)
        self._watch = make(None, "page")
        self._take = None if file is None else _FileTake(make(file, "none"), file)
        self._source: RigSource | None = None
        self._streams: tuple[Stream, ...] = ()
        self._lossless: Sequence[str] = ()
        self._stages: Sequence[tuple[str, str]] = ()
        self._notes = EpisodeNotes()
        self._work = BackgroundWork(lambda what: self.session.remark(what, bad=True), self._end_work)
        self._failure: Exception | None = None
        self._shown: ShownDevices | None = None
        self.summaries: list[RecordingSummary] = []
        # Held for moments alone: by the session as it hands over, by the page's server as it handles commands.
        self._lock = threading.RLock()

    @property
    def session(self) -> PageSession:
        assert self._watch.page is not None
        return self._watch.page.session

    def __enter__(self) -> "PageRecorder":
        with ExitStack() as stack:
            if self._take is not None:
                stack.enter_context(self._take.recorder)  # its name is taken before anything is opened
            if self._end_message is not None:
                stack.enter_context(self._end_message)
            self._watch.__enter__()
            stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._work.join()
        with ExitStack() as stack:  # each is closed whatever another's closing raises
            stack.callback(self._watch.__exit__, kind, error, trace)
            if self._end_message is not None:
                stack.callback(self._end_last, self._end_message, kind)
            if self._take is not None:
                self._take.recorder.__exit__(kind, error, trace)
                self.summaries.append(self._take.recorder.summary())
        if kind is None and self._failure is not None:
            raise self._failure

    def _end_last(self, recorder: Recorder, kind: type[BaseException] | None) -> None:
        """Record the last seconds before the end. kind: type of the error that ended it"""
        assert self._recent is not None
        recorder.stopped_because(f"the last {self._recent.held_s:.1f} s before the end")
        end_with_recent(recorder, self._recent, self._streams, self._lossless, kind)
        self.summaries.append(recorder.summary())

    # As a session's recorder -----------------------------------------------------------------------------------------

    def start_source(self, source: RigSource, lossless: Sequence[str], stages: Sequence[tuple[str, str]]) -> None:
        """From here on these devices are recorded, and commands are handled."""
        self._source, self._streams, self._lossless, self._stages = source, source.streams, lossless, stages
        layout = RigLayout(self._streams, tuple(stages))
        self._watch.start(layout, source.start_ns, lossless)
        if self._take is not None:
            self._take.recorder.start(layout, source.start_ns, lossless)
            self._take.begun = True
        self._shown = ShownDevices(self.session, self._streams)
        tares = tuple(stream.device for stream in self._streams if hasattr(source.device(stream.device), "zero"))
        self.session.bind(self)
        self.session.show(tares=tares)
        self._enter()

    def write(self, items: object) -> None:
        """See `Recorder.write`."""
        self._watch.write(items)
        with self._lock:
            if isinstance(items, Sequence):
                if self._recent is not None:
                    self._recent.add(items)
                items = [*items, *self._taken_notes()]
            if self._take is not None:
                try:
                    self._take.write(items, self._source, self._streams, self._lossless)
                except RecordingError as error:
                    self._lose_file(self._take, error)
        if isinstance(items, Sequence) and self._shown is not None:
            self._shown.on_items(items)
            if any(isinstance(item, HealthReport) for item in items):
                self._show_file()

    def stopped_because(self, reason: str) -> None:
        """See `Recorder.stopped_because`."""
        self._watch.stopped_because(reason)
        with self._lock:
            if self._take is not None:
                self._take.recorder.stopped_because(reason)

    def summary(self) -> RecordingSummary:
        """Summary of the last file; without a file, of the whole view."""
        return self.summaries[-1] if self.summaries else self._watch.summary()

    def _lose_file(self, take: _FileTake, error: RecordingError) -> None:
        """Its file ends with the data so far, and the live view continues without one."""
        self._take, self._failure = None, error
        self._notes.episode = ""
        self.session.remark(f"the recording has ended: {error}", bad=True)
        say(f"deformscope: the recording has ended, the page continues: {error}")

        def end() -> None:
            take.recorder.__exit__(type(error), error, None)
            self.summaries.append(take.recorder.summary())

        self._work.start("file", end)
        self._enter()

    def _show_file(self) -> None:
        """The stored and recorded amounts, and the remaining time."""
        with self._lock:
            changes: dict[str, Any] = {"held_s": None if self._recent is None else self._recent.held_s}
            if self._take is not None:
                size = self._take.recorder.summary().bytes
                lasted_s = self.session.state.now_s - self.session.state.recorded_since_s
                free = shutil.disk_usage(self._take.path.parent).free
                changes["recorded_bytes"] = size
                changes["free_minutes"] = free / (ROOM * size / lasted_s) / 60.0 if size and lasted_s > 1.0 else None
        self.session.show(**changes)

    # As a page's run -------------------------------------------------------------------------------------------------

    def handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        """See `PageRun.handle`."""
        with self._lock:
            match command:
                case messages.StopRun():
                    self._ended.by = "from the page"
                    self._ended.set()
                    return "done", "it ends now"
                case messages.StartRecording():
                    return self._start_file()
                case messages.StopRecording():
                    return self._stop_file()
                case messages.KeepRecent():
                    return self._keep_recent()
                case messages.WriteNote():
                    self._notes.note("note", command.text)
                    return "done", "noted"
                case messages.BeginEpisode():
                    self._notes.begin(command.label)
                    self._enter()
                    return "done", f"episode {command.label} began"
                case messages.EndEpisode():
                    label = self._notes.end()
                    self._enter()
                    return "done", f"episode {label} ended"
                case messages.DiscardPart():
                    return self._notes.discard(command)
                case messages.TareDevice():
                    return self._tare(command.device)
                case _:
                    return "refused", "not while a rig is shown"

    def _enter(self) -> None:
        """Update the state with the present activity, and the possible requests."""
        take = self._take
        commands = ["stop", *(["tare"] if self.session.state.tares else [])]
        if take is None:
            # stages begin with the first frame: a file that begins later could not be replayed with them
            commands += [] if self._stages or self._work.busy & {"file"} else ["start-recording"]
            commands += [] if self._recent is None or self._work.busy & {"the last seconds"} else ["keep-recent"]
            self.session.enter("live", recording="", episode="", commands=tuple(commands), free_minutes=None)
            return
        commands += ["write-note", "discard", "begin-episode", *(["end-episode"] if self._notes.episode else [])]
        commands += [] if self._stages else ["stop-recording"]
        changes: dict[str, Any] = {"commands": tuple(commands), "episode": self._notes.episode}
        if self.session.state.recording == str(take.path):
            self.session.enter("recording", **changes)
        else:
            self.session.recording_began(str(take.path), **changes)

    def _taken_notes(self) -> list[SessionNote]:
        notes = self._notes.take()
        if self._recent is not None:
            self._recent.add(notes)
        return notes

    def _start_file(self) -> tuple[messages.Outcome, str]:
        path = self._next_file()
        self._work.start("file", lambda: self._open_file(path))
        self._enter()
        return "begun", str(path)

    def _open_file(self, path: Path) -> None:
        recorder = self._make(path, "none")
        recorder.__enter__()
        with self._lock:
            self._take = _FileTake(recorder, path)
            self._notes.last_episode = ""
            self._enter()

    def _stop_file(self) -> tuple[messages.Outcome, str]:
        take = self._take
        assert take is not None
        self._notes.end()
        if take.begun and self._source is not None:
            last = [*self._taken_notes(), self._source.look()]
            take.write(last, self._source, self._streams, self._lossless)
        self._take = None
        self._work.start("file", lambda: self._close_file(take))
        self._enter()
        return "begun", f"{take.path} is being closed"

    def _close_file(self, take: _FileTake) -> None:
        take.recorder.stopped_because("ended from the page")
        try:
            take.recorder.__exit__(None, None, None)
        except Exception as error:
            self._failure = error
            raise
        self._add_summary(take.recorder.summary())

    def _add_summary(self, summary: RecordingSummary) -> None:
        self.summaries.append(summary)
        self.session.remark(f"recorded {summary.path} ({summary.bytes / 1e6:.1f} MB)")

    def _keep_recent(self) -> tuple[messages.Outcome, str]:
        assert self._recent is not None
        if self._source is None or self._recent.taken() is None:
            return "refused", "no data yet"
        self._recent.add([self._source.look()])
        taken, held_s, path = self._recent.taken(), self._recent.held_s, self._next_file()

        def keep() -> None:
            try:
                with self._make(path, "none", at_once=True) as recorder:
                    assert taken is not None
                    write_recent(recorder, taken, self._streams, self._lossless)
                    recorder.stopped_because(f"stored from the page: the last {held_s:.1f} s")
            except Exception as error:
                self._failure = error
                raise
            self._add_summary(recorder.summary())

        self._work.start("the last seconds", keep)
        self._enter()
        return "begun", f"the last {held_s:.1f} s are written to {path}"

    def _tare(self, name: str) -> tuple[messages.Outcome, str]:
        if name not in self.session.state.tares or self._source is None:
            return "refused", f"expected one of {', '.join(self.session.state.tares)}; got {name}"
        if name in self._work.busy:
            return "refused", f"{name} is being tared"
        device: Any = self._source.device(name)

        def tare() -> None:
            device.zero()
            with self._lock:
                self._notes.note("tare", name)
                if self._shown is not None:
                    self._shown.tared(name)
            self.session.remark(f"{name}: tared")

        self._work.start(name, tare)
        return "begun", f"{name}: its present load becomes zero; keep it free of contact"

    def _end_work(self, what: str) -> None:
        with self._lock:
            self._work.busy.discard(what)
            if self.session.state.phase != "stopped":
                self._enter()
