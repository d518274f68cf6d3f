"""Content of a squeeze's recording: its phases, the fingertips' pressures, the tracked container, its features, and the
classification of its content."""

import math
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.results.render import derived, reported

PHYSICAL = (
    "force_n",
    "contact_area_m2",
    "center_x_m",
    "center_y_m",
    "orientation_rad",
    "elongation",
    "peak_pa",
    "indentation_m",
    "onset_rate_n_per_s",
    "stiffness_n_per_m",
    "stiffness_low_n_per_m",
    "stiffness_high_n_per_m",
    "relaxation",
)
"""Physical features, in this order. Forces, areas, centres, orientations and peaks are means over the fingers."""
DEGREES = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")
"""Degrees of freedom of a container, in its frame."""


@dataclass(frozen=True, slots=True)
class SqueezePhase:
    """The hand begins with something: pre-shape, close, squeeze, hold, open, stopped."""

    name: str


@dataclass(frozen=True, slots=True)
class FingertipPressure:
    """Pressures on the squeezing fingertips in one tactile frame (as drawn in Thesis fig. 2.4); the last axis or all of
    each array is by finger.

    index: the frame's place in its stream; center_m: (2, 2) centre of pressure (x along the columns, y along the rows)
    from the outer corner of the array's first texel [m], NaN without contact; axis_rad: (2,) orientation of the
    pressure's principal axis, from the columns towards the rows; elongation: (2,) from 0 (round) to 1 (a line)
    force_n: (2,); area_m2: (2,) area of the texels in contact
    """

    index: int
    center_m: FloatArray
    axis_rad: FloatArray
    elongation: FloatArray
    force_n: FloatArray
    area_m2: FloatArray


@dataclass(frozen=True, slots=True)
class TrackedContainer:
    """The rigid model's pose in a depth image. index: the image's place in its stream; T_camera_container: (4, 4)

    good, reason: whether features may be taken from it, and why not; observed: (6,) which directions of motion the
    image observes; agreeing: share of the compared pixels within the noise; edges_px: (n, 2, 2) ends of the model's
    visible edges in the image; since_s: time since the first contact [s], below 0 = before it, NaN = it was not known
    then; directions: (6, 6) directions of `observed`, a direction each row, container frame: translation, then rotation
    times half the container's radius; deviation_m: (6,) standard deviation along each, from the eigenvalues of the
    normal matrix; lag_s: age of the image at the time of the result [s], NaN = it was computed after the hand had
    opened, None = the same, in the median of several images; skipped: images before it that were left out to keep up"""

    index: int = field(metadata=reported())
    T_camera_container: FloatArray = field(metadata=reported())
    good: bool
    reason: str = field(metadata=reported(key="refused"))
    observed: FloatArray
    agreeing: float
    edges_px: FloatArray
    since_s: float = field(metadata=reported())
    directions: FloatArray | None = None
    deviation_m: FloatArray | None = field(default=None, metadata=reported())
    lag_s: float | None = field(default=None, metadata=reported())
    skipped: int | None = field(default=None, metadata=reported())

    @property
    def live(self) -> bool:
        """Whether it was known while the hand squeezed."""
        return self.lag_s is not None and math.isfinite(self.lag_s)

    @property
    @derived(key="degrees_of_freedom")
    def degrees(self) -> str:
        """Number of observed degrees of freedom, and the unobserved ones, each named by its largest part."""
        free = [] if self.directions is None else self.directions[self.observed == 0.0]
        names = sorted(DEGREES[int(np.abs(one).argmax())] for one in free)
        return f"{int(self.observed.sum())} of 6 observed" + f", not {', '.join(names)}" * bool(names)


@dataclass(frozen=True, slots=True)
class ContainerChange:
    """Difference of depth around the nearer fingertip in one image from that of the rigid container at its pose: data
    minus model, a dent is positive (Thesis ch. 2).

    index: the image's place in its stream; since_s: as in `TrackedContainer`; reason: why there is none
    change_m: (61, 61) [m], NaN where nothing was measured; small_m: (11, 11) means of its blocks; missing: share of NaN
    noise_m: deviation of a measured pixel; center_px: (2,) column and row of its middle; width_m: width on the surface
    """

    index: int
    since_s: float
    reason: str = ""
    change_m: FloatArray | None = None
    small_m: FloatArray | None = None
    center_px: FloatArray | None = None
    width_m: float = 0.0
    missing: float = 1.0
    noise_m: float = 0.0


@dataclass(frozen=True, slots=True)
class SqueezeFeatures:
    """The features of one squeeze, float64.

    tactile: (72,) cells at F_steady [counts]; vision: (61, 61) depth change data minus model at F_steady [m], NaN where
    nothing was measured; vision_small: (11, 11) means of its blocks; None without an image. missing: share of NaN in
    vision; noise_m: deviation of one of its pixels; reason: why there is none
    patch_px: (2,) column and row of its middle; patch_width_m: width of the patch on the container's surface
    physical: (n,) in the order of `PHYSICAL`, NaN where it could not be measured
    series_s: (k,) times since F_first, every 0.1 s [s]; series: (k, 72) tactile cells then"""

    tactile: FloatArray
    physical: FloatArray

    @property
    @derived(key="physical")
    def by_name(self) -> dict[str, float]:
        """The physical features by their names in `PHYSICAL`."""
        return dict(zip(PHYSICAL, self.physical.tolist(), strict=True))

    series_s: FloatArray
    series: FloatArray
    vision: FloatArray | None = None
    vision_small: FloatArray | None = None
    missing: float = field(default=1.0, metadata=reported(key="vision_missing"))
    reason: str = field(default="", metadata=reported(key="vision_reason"))
    noise_m: float | None = field(default=None, metadata=reported(key="vision_noise_m"))
    patch_px: FloatArray | None = None
    patch_width_m: float = field(default=0.0, metadata=reported())


@dataclass(frozen=True, slots=True)
class ContentPosterior:
    """A model's posterior of the content.

    since_s: since the first contact [s]; modality: its input; labels; probability: (k,) probability of each
    index: the newest tactile frame's place in its stream, -1 = it is of all features at steady state
    vision_index: index of the image whose change of depth was used too, None = none"""

    since_s: float

    @property
    @derived(key="named")
    def content(self) -> str:
        """The most probable one."""
        return self.labels[int(self.probability.argmax())]

    modality: str = field(metadata=reported(key="named_by"))
    labels: tuple[str, ...]
    probability: FloatArray
    index: int
    vision_index: int | None = None

    @property
    @derived(key="posterior")
    def shares(self) -> dict[str, float]:
        """The probability of each content, by label."""
        return dict(zip(self.labels, self.probability.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class SqueezeStop:
    """Why a squeeze ended before its time. kind: its kind, in a few words; reason: its reason, with numbers; advice:
    what to see to

    stands: the hand confirmed that it stopped; restored: the limits of its currents are restored"""

    kind: str
    reason: str
    advice: str
    stands: bool
    restored: bool
