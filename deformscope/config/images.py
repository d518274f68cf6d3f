"""Options that turn images into particles; `deformscope flow`."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.options import Flags, RecordedOptions, ViewOptions, either
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class ParticleFlags(Flags):
    """Where particles are placed in an image, and which of them are held."""

    roi: flags.RectangleFlag = None
    """Region of the image that holds the body [px]; default: the whole image, or what `calibrate` finds."""
    grid: flags.GridFlag = None
    """Rows and columns of particles over the region, such as 7x15."""
    spacing_px: flags.PositiveFlag = None
    """Distance of neighbouring particles [px], instead of --grid."""
    held: flags.HeldFlag = None
    """Particles whose motion is measured in the images and prescribed: top, bottom, left, right, border or contact.
    Default: bottom,contact with --contact, else top,bottom, or what `calibrate` finds."""
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
        """The held parts: the requested ones, else the fixed part and the pushing part."""
        if self.held is not None:
            return self.held
        return ("bottom", "contact") if self.contact is not None else ("top", "bottom")


@dataclass(frozen=True, slots=True)
class ImageOptions(ParticleFlags):
    """Options that turn images into particles. Pair files need none of these."""

    mask: flags.FileFlag = None
    """Image that is not black on the body; particles are placed there alone. A mask image among the frames of a
    sequence is left out."""
    outline: flags.OutlineFlag = None
    """Corners of a polygon around the body in the first image [px]; particles are placed within it alone."""
    px_per_cm: flags.PositiveFlag = None
    """Scale of the image [px/cm]; with it lengths are also reported in metres."""
    scale_from: flags.ScaleFlag = None
    """The scale by a known length in the plane of the body: two places in the first image [px] and their distance, such
    as 120,40,320,40=50mm of a ruler or a coin."""
    stride: flags.ManyFlag = 1
    """Take every n-th frame."""
    camera: flags.CameraFlag = None
    """For a recording or a rig with several cameras: the camera to use."""
    fps: flags.PositiveFlag = None
    """Frame rate [Hz]; default: the times in the source."""

    def check(self) -> None:
        ParticleFlags.check(self)
        either("--px-per-cm", "--scale-from", self.px_per_cm, self.scale_from)

    @property
    def scale_px_per_cm(self) -> float | None:
        """The scale that one of both flags gives [px/cm]."""
        if self.scale_from is None:
            return self.px_per_cm
        x, y, to_x, to_y, metres = self.scale_from
        return math.hypot(to_x - x, to_y - y) / (100.0 * metres)


# deformscope flow ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FlowConfig(RecordedOptions):
    """Dense optical flow of two images: the displacement of each pixel from BEFORE to AFTER."""

    before: Annotated[Path, Positional, arg(metavar="BEFORE"), flags.Reads()]
    """The first image."""
    after: Annotated[Path, Positional, arg(metavar="AFTER"), flags.Reads()]
    """The second image, of the same size."""
    out: Annotated[Path, arg(metavar="FILE.npz"), flags.ends(".npz"), flags.Writes()]
    """Output file of `flow_px (height, width, 2)` in (x, y) [px]. An existing file is replaced."""
    backward: bool = False
    """Write `backward_px`, the flow from AFTER to BEFORE, as well."""
    picture: flags.PictureFlag = None
    """Draw the flow as arrows and colour. An existing file is replaced."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
