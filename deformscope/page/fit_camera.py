"""What a rig's camera sees now, as something that can be fitted: a picture of the thing at rest, and the newest one."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path

import cv2

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.errors import InputError
from deformscope.experiments.kept_motion import KeptMotion
from deformscope.experiments.live_stages import Beside, live_stages
from deformscope.experiments.stage_processes import StageProcesses
from deformscope.file_io import make_folder, new_recording
from deformscope.frames import ColorFrame
from deformscope.images import encode_png
from deformscope.lab.rig_members import member_of
from deformscope.page.devices import picture_of, remark_of
from deformscope.page.fit_subject import MotionSubject, not_on_a_page
from deformscope.rig.rig_file import Rig, RigDevice, load_rig
from deformscope.rig.source import RigSource
from deformscope.session import finish, run
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.see.flow import FlowMethod
from deformscope_drivers.clock import Stamp

FIRST_S = 10.0
"""So long it waits for the first picture."""
NICE = 10
"""Of the process that computes the flow: what a person sets goes first, and so does what reads devices."""


class CameraSubject(MotionSubject):
    """The thing at rest and as it was last seen. Pictures may come from any thread; all else is for one other.

    camera: its name; method: of the flow; beside: computes it in a process, whose OpenCV nothing else uses meanwhile:
    the same pictures give the same to the last bit; next_folder: for pictures that are to be kept
    """

    def __init__(self, camera: str, method: FlowMethod, beside: Beside, next_folder: Callable[[], Path]) -> None:
        self.camera = camera
        self._method, self._beside, self._next_folder = method, beside, next_folder
        self._came = threading.Event()
        self._newest: ImageArray | None = None
        self._pair: tuple[ImageArray, ImageArray] | None = None
        self._asked: Future[KeptMotion] | None = None
        self._folder: Path | None = None
        self._pairs = 0
        self._kept: tuple[str, str] | None = None

    def saw(self, image: ImageArray) -> None:
        """A picture came: it replaces one that was not looked at."""
        self._newest = image
        self._came.set()

    def begin(self, ended: Callable[[], str]) -> None:
        """Wait for the first picture, which is taken for the thing at rest. Raises InputError where none comes."""
        for _ in range(round(10.0 * FIRST_S)):
            if self._came.wait(0.1):
                self.take_rest()
                self.ask(lambda: None)
                self.go_on()
                return
            if reason := ended():
                raise InputError("pictures of the camera", reason, where=self.camera)
        raise InputError("pictures of the camera", f"none within {FIRST_S:g} s", "deformscope doctor RIG", self.camera)

    # What is shown ---------------------------------------------------------------------------------------------------

    def take_rest(self) -> None:
        """The newest picture shows the thing at rest."""
        self._rest, self._asked = self._newest, None

    def ask(self, call: Callable[[], None]) -> None:
        """For the motion from rest to the newest picture, if that is another than what is shown, and none is on its
        way. call: once it is there, in any thread"""
        rest, newest = self._rest, self._newest
        assert rest is not None
        assert newest is not None
        if self._asked is not None or (self._pair is not None and self._pair[0] is rest and self._pair[1] is newest):
            return
        self._wanted = rest, newest
        self._asked = self._beside.submit(motion_of, rest, newest, self._method, cv2.getNumThreads())
        self._asked.add_done_callback(lambda future: call())

    @property
    def is_ready(self) -> bool:
        """Whether what was asked for is there."""
        return self._asked is not None and self._asked.done()

    def go_on(self) -> None:
        """Take what was asked for, once it is there. Raises what went wrong with it."""
        asked, self._asked = self._asked, None
        assert asked is not None
        self._pair = self._wanted  # also where nothing comes of it: it is not asked for again
        motion = asked.result()
        motion.first, motion.last = self._pair  # these very arrays
        self._kept = None
        self.take(motion)

    # What is kept ----------------------------------------------------------------------------------------------------

    def keep(self) -> None:
        """Write both pictures that are shown as files, without loss. Raises OSError, and InputError where they cannot
        be written."""
        if self._kept is not None:
            return
        if self._folder is None:
            folder = self._next_folder()
            make_folder(folder)
            self._folder = folder
        self._pairs += 1
        rest, now = (self._folder / f"{name}-{self._pairs}.png" for name in ("rest", "now"))
        rest.write_bytes(encode_png(self._motion.first))
        now.write_bytes(encode_png(self._motion.last))
        self._kept = str(rest), str(now)

    def named(self, config: BetaConfig | ThetaConfig) -> BetaConfig | ThetaConfig:
        """The options, of the files that were kept. Raises InputError where none were."""
        if self._kept is None:
            raise InputError("pictures of the camera that are kept", "none", "room and rights in [record] folder")
        return dataclasses.replace(config, sources=self._kept, images=dataclasses.replace(config.images, camera=None))


def motion_of(rest: ImageArray, newest: ImageArray, method: FlowMethod, threads: int) -> KeptMotion:
    """From one picture to the other, as of two files. threads: of OpenCV. Raises InputError where the sizes differ."""
    if rest.shape != newest.shape:
        came = f"{newest.shape[1]}x{newest.shape[0]} after {rest.shape[1]}x{rest.shape[0]}"
        raise InputError("pictures of one size", came, "take the one at rest again")
    os.setpriority(os.PRIO_PROCESS, 0, max(NICE, os.getpriority(os.PRIO_PROCESS, 0)))
    cv2.setNumThreads(threads)
    pair = [ColorFrame(Stamp(index), index, image) for index, image in enumerate((rest, newest))]
    return KeptMotion(pair, method, lambda done: None)


@contextmanager
def camera_of(config: BetaConfig | ThetaConfig, remark: Callable[[str, bool], None]) -> Iterator[CameraSubject]:
    """The camera of the rig that the options name, opened; nothing else of the rig is. Its pictures come until the end.

    remark: of what happens to its link, in words, and whether that is bad; from another thread
    Raises InputError where the rig has no such camera, or it gives no pictures.
    """
    if (reason := not_on_a_page(config)) is not None:
        raise InputError("one fit to a picture of a rig's camera", reason, "leave it out")
    rig = load_rig(config.sources[0], trusted=config.trust_rig)
    entry = _camera_in(rig, config.images.camera)
    name = f"{rig.name.replace(':', '-')}-{entry.name}"
    over, ended = threading.Event(), list[str]()
    with (
        StageProcesses(("flow",), quiet_warp) as beside,
        member_of(entry) as member,
        RigSource((member,), raw=False) as source,
    ):
        folder = Path(rig.record.folder)
        subject = CameraSubject(entry.name, config.images.flow, beside["flow"], lambda: new_recording(folder, name, ""))
        watching = _Watching(subject, remark)

        def follow() -> None:
            try:
                run(source, live_stages((), {}, lambda items: over.is_set() or source.ended), watching)
                finish(source, watching)
                ended.extend(source.failures.values() or ["it has come to its end"])
            except Exception as error:
                ended.append(" ".join(str(error).split()) or type(error).__name__)
            if not over.is_set():
                remark(f"{entry.name}: {ended[0]}", True)

        thread = threading.Thread(target=follow, name="deformscope-camera", daemon=True)
        thread.start()
        try:
            subject.begin(lambda: ended[0] if ended else "")
            yield subject
        finally:
            over.set()
            thread.join()


class _Watching:
    """A session's recorder that keeps nothing but the newest picture."""

    def __init__(self, subject: CameraSubject, remark: Callable[[str, bool], None]) -> None:
        self._subject, self._remark = subject, remark

    def write(self, items: object) -> None:
        """As `Recorder.write`."""
        for item in items if isinstance(items, Sequence) else ():
            if (image := picture_of(item, self._subject.camera)) is not None:
                self._subject.saw(image)
            elif (said := remark_of(item)) is not None:
                self._remark(*said)


def _camera_in(rig: Rig, wanted: str | None) -> RigDevice:
    """The one that is named; else the first colour camera, or the first depth camera, whose colour picture is taken."""
    of_kind = {kind: [entry for entry in rig.devices if entry.driver.kind == kind] for kind in ("color", "depth")}
    cameras = of_kind["color"] + of_kind["depth"]
    names = ", ".join(entry.name for entry in cameras) or "none"
    if wanted is None and cameras:
        return cameras[0]
    for entry in cameras:
        if entry.name == wanted:
            return entry
    if wanted is None:
        raise InputError("a rig with a camera", "none", where=rig.name)
    raise InputError("a camera of the rig after --camera", repr(wanted), names, rig.name)
