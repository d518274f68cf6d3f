"""A fit that is set on a page before a command computes it: of files, or of a rig's camera, which is then opened."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.errors import InputError
from deformscope.experiments.live_stages import SOON_S
from deformscope.file_io import new_recording
from deformscope.lab.rig_members import member_of
from deformscope.page.devices import picture_of, remark_of
from deformscope.page.fit import found_of
from deformscope.page.fit_process import FitProcess
from deformscope.page.fit_settings import not_on_a_page
from deformscope.page.server.fit_messages import FitSettings, FitState
from deformscope.page.server.page_server import PageServer
from deformscope.page.server.page_session import PageSession
from deformscope.pictures.evidence import Result, results_png
from deformscope.rig.rig_file import Rig, RigDevice, load_rig
from deformscope.rig.source import RigSource
from deformscope.stages.fit.estimate import Estimate


@contextmanager
def set_on_page(
    config: BetaConfig | ThetaConfig, note: Callable[[str], None]
) -> Iterator[tuple[BetaConfig | ThetaConfig, Callable[[Estimate, Result], None]]]:
    """Set a fit on a page, until it is stopped there. Yields the chosen options, and the view of the result.

    The page is served until the process ends. Raises InputError for unreadable sources.
    """
    if (reason := not_on_a_page(config)) is not None:
        if config.from_rig:
            raise InputError("one fit to a picture of a rig's camera", reason, "leave it out")
        raise InputError("images, or one pair file, for the settings of a page", reason, "leave out --adjust")
    config = dataclasses.replace(config, adjust=False, output=dataclasses.replace(config.output, viewer="none"))
    page = PageServer(" ".join(config.sources), adjusting=True)
    page.open()
    note(page.where)
    try:
        chosen, last = _set(config, page, note)
        page.session.enter("adjusting", commands=(), reason="the whole fit uses these settings")

        def show(estimate: Estimate, shown: Result) -> None:
            page.offer("fit.png", results_png([shown]), "image/png")
            found = found_of(estimate, last.command)
            page.session.show(fit=msgspec.structs.replace(last, found=found, picture="fit.png", busy=""))
            page.session.enter("stopped", "its command has ended")

        yield chosen, show
    except BaseException as error:
        page.session.enter("stopped", " ".join(str(error).split()) or "interrupted")
        page.close()
        raise


def _set(
    config: BetaConfig | ThetaConfig, page: PageServer, note: Callable[[str], None]
) -> tuple[BetaConfig | ThetaConfig, FitState]:
    """The chosen options, and the last picture."""

    def changed(fit: FitProcess) -> None:
        if fit.goes_on:
            page.session.enter("adjusting", commands=fit.commands, fit=fit.state)

    next_folder, camera = None, None
    if config.from_rig:
        rig = load_rig(config.sources[0], trusted=config.trust_rig)
        camera = _camera_in(rig, config.images.camera)
        config = dataclasses.replace(config, images=dataclasses.replace(config.images, camera=camera.name))
        name = f"{rig.name.replace(':', '-')}-{camera.name}"
        next_folder = partial(new_recording, Path(rig.record.folder), name, "")
    began = FitState("images", "beta" if isinstance(config, BetaConfig) else "theta", FitSettings())
    fit = FitProcess(config, began, page, changed, next_folder, keeps_last=True)
    try:
        page.session.bind(fit.start())
        if camera is not None:
            follow(camera, fit, page.session)
        return fit.result(), fit.state
    finally:
        fit.close()
        if fit.drawn_ms:
            p50, p95 = np.percentile(fit.drawn_ms, (50, 95))
            note(f"slider to picture: p50 {p50:.0f} ms, p95 {p95:.0f} ms, {len(fit.drawn_ms)} changes")


def follow(entry: RigDevice, fit: FitProcess, session: PageSession) -> None:
    """Open only a rig's camera, and give its pictures to a fit until the camera or the fit ends. session:
    receives remarks on the camera. Raises InputError if it gives no picture."""
    came = ended = False
    with member_of(entry) as member, RigSource((member,), raw=False) as source:
        while fit.goes_on and not ended:
            ended = source.ended
            for item in source.take(SOON_S):
                if (image := picture_of(item, entry.name)) is not None:
                    came = True
                    fit.on_picture(image)
                elif (remark := remark_of(item)) is not None:
                    words, bad = remark
                    session.remark(words, bad=bad)
        if ended and fit.goes_on:
            why = source.failures.get(entry.name, "it has ended")
            if not came:
                raise InputError("pictures of the camera", why, where=entry.name)
            session.remark(f"{entry.name}: {why}", bad=True)


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
