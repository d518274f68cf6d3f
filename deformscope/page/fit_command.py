"""A fit that is set on a page before a command computes it."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import PushFlags
from deformscope.file_io import SAMPLE_SCHEME, ending_of
from deformscope.files.sources import RECORDING_SUFFIX, open_source
from deformscope.page.fit_process import FitProcess
from deformscope.page.fit_settings import COMMANDS, picture_of, settings_of
from deformscope.page.server.fit_messages import FitSettings, FitState
from deformscope.page.server.page_server import PageServer

if TYPE_CHECKING:  # loaded once the page is there
    from deformscope.pictures.evidence import Result
    from deformscope.stages.fit.estimate import Estimate


@contextmanager
def set_on_page(
    config: BetaConfig | ThetaConfig, read_force: Callable[[PushFlags], Any], note: Callable[[str], None]
) -> "Iterator[tuple[BetaConfig | ThetaConfig, Callable[[Estimate, Result], None]]]":
    """Set a fit on a page, until it is stopped there. Yields the chosen options, and the view of the result.
    read_force: reads a force and its log, in another process

    The page is served until the process ends. Raises InputError for unreadable sources."""
    config = dataclasses.replace(config, output=dataclasses.replace(config.output, viewer="none"))
    page = PageServer(" ".join(config.sources), adjusting=True)
    page.open()
    note(page.where)
    try:
        chosen, last = _set(config, read_force, page, note)
        page.session.enter("adjusting", commands=(), reason="the whole fit uses these settings")

        def show(estimate: "Estimate", shown: "Result") -> None:
            from deformscope.page.fit import found_of
            from deformscope.pictures.evidence import results_png

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
    config: BetaConfig | ThetaConfig,
    read_force: Callable[[PushFlags], Any],
    page: PageServer,
    note: Callable[[str], None],
) -> tuple[BetaConfig | ThetaConfig, FitState]:
    """The chosen options, and the last picture."""

    def changed(fit: FitProcess) -> None:
        if fit.goes_on:
            page.session.enter("adjusting", commands=fit.commands, fit=fit.state)

    began = _first_frame(config, page)
    fit = FitProcess(config, read_force, began, page, changed)
    try:
        page.session.bind(fit.start())
        if began.pictures:  # it can be drawn on until the process is there
            page.session.enter("adjusting", commands=COMMANDS, fit=began)
        return fit.result(), fit.state
    finally:
        fit.close()
        if fit.drawn_ms:
            p50, p95 = np.percentile(fit.drawn_ms, (50, 95))
            note(f"slider to picture: p50 {p50:.0f} ms, p95 {p95:.0f} ms, {len(fit.drawn_ms)} changes")


def _first_frame(config: BetaConfig | ThetaConfig, page: PageServer) -> FitState:
    """The first image, before what computes is loaded; without pictures for a pair, and for a sample, whose own
    options are loaded with it."""
    first = str(config.sources[0])
    began = FitState("images", "beta" if isinstance(config, BetaConfig) else "theta", FitSettings())
    if ending_of(first) in (".npz", RECORDING_SUFFIX) or first.startswith(SAMPLE_SCHEME):
        return began
    images = config.images
    with open_source(config.sources, stride=images.stride, fps=images.fps, mask=images.mask) as source:
        image = next(iter(source)).image
    page.offer("rest.jpg", picture_of(image), "image/jpeg")
    shown: dict[str, Any] = {"pictures": ("rest.jpg", "rest.jpg"), "scale": images.scale_from}
    size = float(image.shape[1]), float(image.shape[0])
    return msgspec.structs.replace(began, settings=settings_of(config, images), size_px=size, **shown)
