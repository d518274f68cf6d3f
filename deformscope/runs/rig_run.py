"""A rig's devices recorded, shown, and evaluated by live stages, from the options to the outcome."""

import contextlib
import dataclasses
import hashlib
import os
import signal
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from deformscope.config import OutputOptions, RigRunOptions
from deformscope.config.rigs import StageOptions
from deformscope.experiments.live.live_stages import StageCounts, live_stages
from deformscope.file_io import new_recording
from deformscope.frames import HealthReport, Item, StageResult, Stream
from deformscope.lab.rig_members import members_of
from deformscope.log.layout import RIG, RigLayout
from deformscope.page.devices import remark_of
from deformscope.page.recorder import PageRecorder
from deformscope.pictures.report import Table
from deformscope.plain import plain
from deformscope.recording.losses import losses_of, lost_by, since, to_text
from deformscope.recording.recent import LastRecorder, RecentItems, WatchedRecorder
from deformscope.recording.recorder import Recorder, RecordingSummary
from deformscope.rig.rig_file import Rig, load_rig
from deformscope.rig.source import RigSource
from deformscope.runs.recordings import RecordResult
from deformscope.runs.result import ViewerChoice, open_recorder
from deformscope.runs.skeleton import open_run, signal_word
from deformscope.session import run as run_session
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.terminal import Interruption, say, until_interrupted
from deformscope_drivers.health import Health

if TYPE_CHECKING:
    from deformscope.experiments.live.device_stages import LiveOptions, Stage, StageName
    from deformscope.experiments.live.live_stages import StageProcesses

REPORT_EVERY_S = 10.0
PAGE_HOLDS_S = 30.0
"""Default number of past seconds that a page can still record."""


@dataclasses.dataclass(frozen=True, slots=True)
class RigRun:
    """Outcome of a rig's run.

    result: result of the recording; failures: reason of each device that failed, by name; why: why it ended; early_by:
    signal that ended it early, 0 = none"""

    result: RecordResult
    failures: Mapping[str, str]
    why: str
    early_by: int


def run_rig(config: RigRunOptions, auto: Literal["none", "native"], *, always_record: bool) -> RigRun:
    """Run a rig until its end or Ctrl-C. auto: the viewer that is used if none is requested; always_record: record also
    without a name for the file, which then gets one"""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    file = config.output.record
    if file is None and always_record:
        file = _new_file(rig)
    viewer = auto if config.output.viewer == "auto" else config.output.viewer
    output = dataclasses.replace(config.output, record=file, viewer=viewer)
    settings = {"rig": rig.text, "rig_name": rig.name, "label": config.label, "seed": config.output.seed}
    settings["simulated"] = [entry.name for entry in rig.devices if entry.double]
    names = config.stages.names
    options = live_options(config.stages, rig) if names else None
    if options is not None:
        settings["stages"] = dataclasses.asdict(options)
    recent = _recent(config.keep_last, viewer, names)
    at_end = config.keep_last is not None and always_record
    with (
        until_interrupted() as asked,
        _recorder(output, settings, rig, names, asked, recent, at_end=at_end) as recorder,
        _processes(options.names) if options is not None else contextlib.nullcontext({}) as processes,
        members_of(rig) as members,
    ):
        say(f"opening {', '.join(member.name for member in members)}")
        with open_run(RigSource(members, raw=rig.record.raw), recorder) as opened:
            source = opened.source
            stages = () if options is None else _stages(options, source.streams)
            shown = [(stage.name, stage.device) for stage in stages]
            if isinstance(recorder, PageRecorder):
                recorder.start_source(source, rig.record.lossless, shown)
            else:
                recorder.start(RigLayout(source.streams, tuple(shown)), source.start_ns, rig.record.lossless)
            what = f"holding the last {config.keep_last:g} s for" if at_end else "recording into"
            say(f"{what} {file}: Ctrl-C ends it" if file else "watching: Ctrl-C ends it")
            end = _Ending(asked, config.seconds, opened.source)
            lossless = options is not None and options.lossless
            experiment = live_stages(stages, processes, end, lossless=lossless, watch=end.watch)
            counts = run_session(opened.source, experiment, recorder)
        last = opened.last
        assert last is not None
        if at_end and recent is not None and (taken := recent.taken()) is not None:
            last = since(last, taken[0])  # as in the recording
        failures = dict(opened.source.failures)
        why = end.reason + "".join(f"; {name} failed: {reason}" for name, reason in failures.items())
        recorder.stopped_because(why)
    files = recorder.summaries if isinstance(recorder, PageRecorder) else None
    result = _result(config, recorder.summary(), last, failures, why, counts, files)
    return RigRun(result, failures, end.reason, end.early_by)


def _recorder(
    output: OutputOptions,
    settings: Mapping[str, object],
    rig: Rig,
    names: Sequence[str],
    asked: Interruption,
    recent: RecentItems | None,
    *,
    at_end: bool,
) -> Recorder | WatchedRecorder | PageRecorder:
    """A recorder of one file from the beginning to the end, or of the recent items at the end; on a page, of as many
    files as it requests."""

    def make(file: Path | None, viewer: ViewerChoice, *, at_once: bool = False) -> Recorder:
        files = dataclasses.replace(output, record=file, viewer=viewer)
        return open_recorder(files, settings, RIG.variant(_variant(rig, names)), real_time=not at_once)

    def next_file() -> Path:
        return _new_file(rig)

    if output.viewer == "page":
        first, last = (None, output.record) if at_end else (output.record, None)
        return PageRecorder(make, first, next_file, asked, recent, at_end=last)
    if at_end and recent is not None:
        return LastRecorder(make(None, output.viewer), make(output.record, "none", at_once=True), recent)
    if output.viewer == "native" and output.record is not None:
        return WatchedRecorder(make(None, "native"), make(output.record, "none"))
    return make(output.record, output.viewer)


def _recent(keep_last_s: float | None, viewer: ViewerChoice, stages: Sequence[str]) -> RecentItems | None:
    """Memory of the last seconds, if they can be recorded later."""
    if keep_last_s is not None:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        return RecentItems(keep_last_s, memory // 4)
    return RecentItems(PAGE_HOLDS_S) if viewer == "page" and not stages else None


def _new_file(rig: Rig) -> Path:
    return new_recording(Path(rig.record.folder), rig.name.replace(":", "-"))


def live_options(flags: StageOptions, rig: Rig, streams: Sequence[Stream] = ()) -> "LiveOptions":
    """The options of the requested stages. Raises InputError if the rig lacks a device for one of the stages. streams:
    streams of the devices, where they are not the rig's"""
    from deformscope.experiments.fit.calibration_inputs import particle_options
    from deformscope.experiments.live.device_stages import LiveOptions, for_rig

    own = {"names": flags.names, "color": flags.camera or "", "particles": particle_options(flags)}
    return for_rig(LiveOptions(**flags.shared(LiveOptions) | own), rig, streams)


# What stages need takes seconds to load: only where there are some.


def _processes(names: "Sequence[StageName]") -> "StageProcesses":
    from deformscope.experiments.live.live_stages import StageProcesses

    return StageProcesses(names, quiet_warp)


def _stages(options: "LiveOptions", streams: Sequence[Stream]) -> "tuple[Stage, ...]":
    from deformscope.experiments.live.device_stages import stages_of

    return stages_of(options, streams)


class _Ending:
    """Whether a recording's time is over; reports now and then how it goes. reason: why it ended"""

    def __init__(self, asked: Interruption, seconds: float | None, source: RigSource) -> None:
        self._source = source
        self._last: HealthReport | None = None
        self._asked = asked
        self._seconds = seconds
        self._began = self._reported_at = time.monotonic()
        self.reason = ""
        self._newest: dict[str, StageResult] = {}
        self._counts: Counter[str] = Counter()

    def watch(self, result: StageResult) -> None:
        """A stage's result has come."""
        self._newest[result.stage] = result
        self._counts[result.stage] += 1

    @property
    def early_by(self) -> int:
        """The signal that ended it before its end; 0 = none did. Ctrl-C is the end of a run without a duration."""
        number = self._asked.signal_number
        return 0 if number == signal.SIGINT and self._seconds is None else number

    def __call__(self, items: Sequence[Item]) -> bool:
        for item in items:
            if isinstance(item, HealthReport):
                self._last = item
            elif (remark := remark_of(item)) is not None:
                say(remark[0])
        if self._last is not None and time.monotonic() - self._reported_at > REPORT_EVERY_S:
            since_s, self._reported_at = time.monotonic() - self._reported_at, time.monotonic()
            say(", ".join(f"{name} {health.rate_hz:.4g}/s" for name, health in self._last.devices))
            if self._newest:
                late = ((name, self._counts[name] / since_s, one.late_s * 1e3) for name, one in self._newest.items())
                say("stages: " + ", ".join(f"{name} {rate:.3g}/s {ms:.0f} ms behind" for name, rate, ms in late))
                self._counts.clear()
        lasted_s = time.monotonic() - self._began
        early = "" if self._seconds is None else f", earlier than the requested {self._seconds:g} s"
        if self._asked.is_set():
            by = self._asked.by or f"by {signal_word(self._asked.signal_number)}"
            self.reason = f"{by} after {lasted_s:.1f} s{early}"
        elif self._source.ended:
            self.reason = f"after {lasted_s:.1f} s{early}: every device has ended"
            say("every device has ended")
        elif self._seconds is not None and lasted_s >= self._seconds:
            self.reason = f"after {self._seconds:g} s, as requested"
        return bool(self.reason)


def _result(
    config: RigRunOptions,
    summary: RecordingSummary,
    last: HealthReport,
    failures: Mapping[str, str],
    ended: str,
    stages: Mapping[str, StageCounts],
    files: Sequence[RecordingSummary] | None,
) -> RecordResult:
    """Summary of the recording, device by device, as a table and as JSON. files: begun and ended from a page"""
    devices = dict(last.devices)
    rows = [(name, _to_text(health, failures.get(name))) for name, health in devices.items()]
    rows += [(f"stage {name}", counts.to_text()) for name, counts in stages.items()]
    rows.append(("ended", ended))
    for one in [summary] if files is None else files:
        if one.path is not None:
            rows.append(("recording", f"{one.path} ({one.bytes / 1e6:.1f} MB)"))
    found: dict[str, object] = {
        "recording": summary.path,
        "frames": summary.frames,
        "bytes": summary.bytes,
        "live_dropped": summary.dropped,
        "devices": devices,
        "losses": losses_of(last),
        "failures": failures,
        "ended": ended,
    }
    if files is not None:
        found["recordings"] = [one.path for one in files]
    if stages:
        found["stages"] = {name: counts.as_json() for name, counts in stages.items()}
    return RecordResult(cast("dict[str, Any]", plain(found)), Table(rows, caption=config.label or config.rig))


def _to_text(health: Health, failure: str | None) -> str:
    """A device's summary: its frames and losses, and their reason if known."""
    why = f"FAILED: {failure}" if failure else health.reason
    return ", ".join(part for part in (f"{health.received} readings", to_text(lost_by(health)), why) if part)


def _variant(rig: Rig, stages: Sequence[str]) -> str:
    """The same for rigs with the same devices and stages, which have the same views."""
    devices = repr([*((entry.name, entry.driver.name) for entry in rig.devices), *stages])
    return hashlib.sha256(devices.encode()).hexdigest()[:8]
