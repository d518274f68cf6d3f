"""How images become particles; `deformscope flow`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.options import Flags, RecordedOptions, ViewOptions, either
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class ParticleFlags(Flags):
    """Where particles are seeded in an image, and which of them are held."""

    roi: flags.RectangleFlag = None
    """Region of the image that holds the thing [px]; default: all of it."""
    grid: flags.GridFlag = None
    """Rows and columns of particles over the region, such as 7x15."""
    spacing_px: flags.PositiveFlag = None
    """Distance of neighbouring particles [px], instead of --grid."""
    held: flags.HeldFlag = None
    """Particles whose motion is taken from the images and prescribed, out of top, bottom, left, right, border and
    contact. Default: bottom,contact where --contact is given, else top,bottom."""
    contact: flags.RectangleFlag = None
    """Footprint of the tool in the first image [px]; the particles inside are `contact`."""

    def check(self) -> None:
        either("--grid", "--spacing-px", self.grid, self.spacing_px)
        if self.held is not None and "contact" in self.held and self.contact is None:
            raise InputError("--contact X,Y,WIDTH,HEIGHT with --held contact", "no --contact")
        if self.held is not None and "contact" not in self.held and self.contact is not None:
            held = ",".join((*self.held, "contact"))
            raise InputError("contact among --held with --contact", f"--held {','.join(self.held)}", f"--held {held}")

    def held_parts(self) -> tuple[flags.HeldPart, ...]:
        """The parts to hold: those asked for, else what stands still and what pushes."""
        if self.held is not None:
            return self.held
        return ("bottom", "contact") if self.contact is not None else ("top", "bottom")


@dataclass(frozen=True, slots=True)
class ImageOptions(ParticleFlags):
    """How images become particles. Pair files need none of these."""

    mask: flags.FileFlag = None
    """Image that is not black where the thing is; particles stand there alone. It is left out of a sequence that holds
    it."""
    outline: flags.OutlineFlag = None
    """Corners of a polygon around the thing in the first image [px]; particles stand within it alone."""
    px_per_cm: flags.PositiveFlag = None
    """Scale of the image [px/cm]; with it lengths are reported in metres too."""
    stride: flags.ManyFlag = 1
    """Take every n-th frame."""
    camera: flags.CameraFlag = None
    """Of a recording or a rig with several cameras: the one to take."""
    fps: flags.PositiveFlag = None
    """Frames a second of images that do not say; default: what the video says."""
    flow: Literal["dis", "farneback"] = "dis"
    """Method of the dense optical flow."""


# deformscope flow ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FlowConfig(RecordedOptions):
    """Dense optical flow of two images: where each pixel of BEFORE has gone in AFTER."""

    before: Annotated[Path, Positional, arg(metavar="BEFORE"), flags.Reads()]
    """The first image."""
    after: Annotated[Path, Positional, arg(metavar="AFTER"), flags.Reads()]
    """The second image, of the same size."""
    out: Annotated[Path, arg(metavar="FILE.npz"), flags.ends(".npz"), flags.Writes()]
    """Where `flow_px (height, width, 2)` in (x, y) [px] goes. An existing file is replaced."""
    method: Literal["dis", "farneback"] = "dis"
    """Dense inverse search, or Farneback's polynomials."""
    backward: bool = False
    """Write `backward_px`, the flow from AFTER to BEFORE, as well."""
    picture: flags.PictureFlag = None
    """Draw the flow as arrows and colour. An existing file is replaced."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
