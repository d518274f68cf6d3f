"""The body in a sequence of images: its outline, the sides that are held, and where a tool pushes, out of the motion.

What moves beyond the background, and deforms, is the body; parts of it that stay are those that look like it (GrabCut,
Rother 2004). A second thing that moves as a rigid body is the tool. Image axes: x to the right, y down [px]."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import cv2
import numpy as np
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import BoolArray, FloatArray, ImageArray
from deformscope.stages.see.flow import dense_flow, grey
from deformscope.stages.see.particles import LONG_SIDE_PARTICLES, HeldGroup, Rect

LONG_PX = 480
"""Longer side of the images in which the body is sought [px]."""

SIDES: tuple[Literal["top", "bottom", "left", "right"], ...] = ("top", "bottom", "left", "right")
OPPOSITE: dict[HeldGroup, HeldGroup] = {"top": "bottom", "bottom": "top", "left": "right", "right": "left"}

TEXTURE, RETURNS_PX = 0.5, 0.7
"""Least texture (smaller eigenvalue of the structure tensor, squared grey values) of a pixel whose flow counts, and
largest distance between it and its place after flow there and back [px of the small image]."""

BACKGROUND_PX = 0.4
"""Largest residual of a pixel that moves with the background [px of the small image]."""

RIGID_PX, RIGID = 0.5, 0.1
"""Largest residual of a pixel that moves with a tool [px of the small image], or as a share of its motion."""

BACKGROUND = 0.6
"""Share of the textured rim of the picture that moves as one: that is the background."""

STILL_PX = 0.5
"""Motion beyond the background [px of the small image] below which nothing moves."""

BODY_LIKE = 0.15
"""Frequency of a colour in the body, as a share of its commonest, from which that colour is the body's."""

ENTERS, UNLIKE = 0.7, 1.0
"""Least share of what moves at a side of the picture that follows the tool; least distance of its colour from the
body's, in deviations: another part of the body has the same colour."""

SMALLEST = 0.002
"""Least size of a tool as a share of the picture."""

FEWEST = 40
"""Least number of pixels whose motion is fitted."""

RIM = 0.08
"""Width of the picture's rim as a share of its shorter side."""

OUTSIDE = 1e3
"""Value of a pixel beyond the picture."""

SUSPECT, CUT = 0.5, 0.35
"""Share of the textured pixels that are found in another image below which it may be another scene, and by the flow
with feature matches is one: of one scene 55 % were found at least, of two 19 % at most."""

HELD, FREE = 0.15, 0.4
"""Motion of a side, continued to it from `EDGE_PX` below, as a share of that at `INNER` inside: a held side has less
than the first, a free one more than the second; between them it is not sure."""

EDGE_PX, INNER = 3, 0.15
"""Depths below a side at which motions are compared [px of the small image; share of the body's size]."""

AGREES, SURE, SURE_CONTACT = 0.8, 0.5, 0.65
"""Overlap of two segmentations at which the region is as likely wrong; least confidence of a sure choice, and of a
contact: the overlap of the tool with what moves most."""

ZOOMS, BENDS_PX, MOVES = 0.01, 0.35, 0.03
"""Growth of the background, its residual beyond a shift, turn and zoom [px of the small image], and its shift as a
share of the picture, from which they are named."""

UNMOVED = 0.03
"""Share of the largest motion below which nothing moves at a place."""

DARK = 48.0
"""Brightness of all but 1 % of the pixels of 8 bits, below which noise may hide texture."""

CONTACT_ROWS = 1.25
"""Depth of a footprint in particles, as they are spaced by default."""

TILTS = 0.06
"""Slope of a tool's face against the body that is still one face."""

HOLE = 0.01
"""Least size of a hole, as a share of the body, that is left out."""

CORNERS = 24
"""Largest number of corners of an outline without holes."""

ImageFaultCode = Literal["scene-cut", "mirrored", "zoom", "out-of-plane", "warped", "camera-moves", "still", "dark"]


@dataclass(frozen=True, slots=True)
class ImageFault:
    """What makes images unfit. code: stable name; text: with its numbers; lowers: whether a fit to them is doubtful"""

    code: ImageFaultCode
    text: str
    lowers: bool = True


@dataclass(frozen=True, slots=True)
class FoundBody:
    """What was found, in the first image.

    outline: (n, 2) corners [px], holes joined by cuts; None = the whole image, or nothing was found
    held: sides and `contact`; contact: the tool's footprint; tool: (n, 2) outline of a second thing that moves
    confidence: 0 to 1, for each of region, held and contact; unfit: what makes the images unfit
    doubts: what is not sure, and the flag that says it
    background: (images - 1, 2, 3) motion of the background from the first image [px]: shift, turn and zoom"""

    outline: FloatArray | None = None
    held: tuple[HeldGroup, ...] = ("top", "bottom")
    contact: Rect | None = None
    tool: FloatArray | None = None
    confidence: dict[str, float] = field(default_factory=dict)
    unfit: tuple[ImageFault, ...] = ()
    doubts: tuple[str, ...] = ()
    background: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 3)))

    @property
    def sure(self) -> bool:
        """Whether each choice is likelier right than wrong."""
        return not self.doubts

    @property
    def corners(self) -> tuple[float, ...] | None:
        """x, y of each corner of the outline in turn."""
        return None if self.outline is None else tuple(float(one) for one in self.outline.ravel())

    def without_contact(self) -> "FoundBody":
        """The same body, held at its sides alone, which is not sure."""
        sides = tuple(one for one in self.held if one != "contact")
        return replace(self, held=sides, contact=None, doubts=tuple({*self.doubts, "contact (--contact)"}))

    @property
    def roi(self) -> Rect | None:
        """The rectangle around the outline."""
        if self.outline is None:
            return None
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        return Rect(*(float(one) for one in (*low, *(high - low))))

    def flags(self) -> str:
        """The choices as flags of a command."""
        said = [] if self.roi is None else [f"--roi {self.roi.described()}"]
        if self.corners is not None:
            said.append("--outline " + ",".join(f"{one:g}" for one in self.corners))
        said.append("--held " + ",".join(self.held))
        return " ".join(said + ([] if self.contact is None else [f"--contact {self.contact.described()}"]))


@dataclass(frozen=True, slots=True)
class _Motion:
    """Flow of small images from the first one.

    flow: (n, h, w, 2) [px]; known: (n, h, w) where it counts; away: (n, h, w) length of its part beyond the background
    [px]; shown: (n, h, w) where it explains the image better than the background's motion does; fits: (n, 2, 3) that
    motion; rim: share of the textured rim that moves with it; most: the largest motion beyond it, limit: residual up to
    which a pixel moves with it [px]"""

    flow: FloatArray
    known: BoolArray
    away: FloatArray
    shown: BoolArray
    fits: FloatArray
    rim: float
    most: float
    limit: float


def find_body(images: Sequence[ImageArray]) -> FoundBody:
    """The body in a few images (H, W[, 3]) of a sequence in their order, the first at rest, the last at the largest
    deformation. In fewer than two images, or still ones, nothing is found."""
    if len(images) < 2 or min(images[0].shape[:2]) < 32:
        return FoundBody()
    height, width = images[0].shape[:2]
    scale = min(1.0, LONG_PX / max(height, width))
    size = max(round(width * scale), 16), max(round(height * scale), 16)
    small: list[Any] = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in images]
    shades = _eight_bits(small)
    flows: list[FloatArray] = []
    for shade in shades[1:]:
        flows.append(_dis(shades[0], shade, flows[-1] if flows else None))
    bright = float(np.percentile(small[0], 99)) if small[0].dtype == np.uint8 else 255.0
    if (other := _other_scene(shades, flows)) is not None:
        if bright < DARK:
            text = f"dark ones: 99 % of the pixels are below {bright:.0f} of 255, and neighbouring images share little"
            other = ImageFault("dark", text)
        return FoundBody(unfit=(other,))
    motion = _motion(shades, flows)
    if motion.rim < BACKGROUND:  # a camera that turns, or a stabilised picture
        loose = _motion(shades, flows, 4.0)
        motion = loose if loose.rim >= BACKGROUND and loose.most > 5 * loose.limit else motion
    background = motion.fits.copy()
    background[:, :, 2] /= scale
    if motion.most < STILL_PX:
        text = f"nothing moves: {motion.most / scale:.2g} px at most beyond the background"
        return FoundBody(unfit=(ImageFault("still", text, lowers=False),), background=background)
    region, tool, agree = _region(small[0], shades[0], motion)
    still = motion.rim >= BACKGROUND
    unfit = tuple(_unfit(motion, ~_grown(region | tool, 9), scale, bright) if still else _turned(motion, scale))
    if region.all():
        unsure = () if agree >= AGREES else ("region (--outline or --roi)",)
        return FoundBody(unfit=unfit, background=background, doubts=unsure)
    share = _share_of_motion(motion)
    contact, side, driven, in_contact = _contact(region, tool, share) if still else (None, None, None, 1.0)
    held, in_held = _held(region, share, side, still)
    pushed: HeldGroup | None = "contact" if contact is not None else driven
    parts: tuple[HeldGroup, ...] = held if pushed is None or pushed in held else (*held, pushed)
    in_region = max(0.0, 1.0 - (1.0 - agree) * SURE / (1.0 - AGREES))
    if still and any(0.02 < _cut_off(one, region, share) < 0.5 for one in SIDES):
        in_region *= SURE  # a tool that passes for a part of the body
    confidence = {"region": in_region, "held": in_held, "contact": in_contact}
    flag = {"region": "--outline or --roi", "held": "--held", "contact": "--contact"}
    least = {"region": SURE, "held": SURE, "contact": SURE_CONTACT}
    doubts = tuple(f"{name} ({flag[name]})" for name, one in confidence.items() if one < least[name])
    outline = (polygon(region) + 0.5) / scale - 0.5
    return FoundBody(
        outline=np.clip(np.rint(outline), 0, (width - 1, height - 1)),
        held=parts,
        contact=None if contact is None else _enlarged(contact, scale, (height, width)),
        tool=(polygon(tool) + 0.5) / scale - 0.5 if tool.any() else None,
        confidence=confidence,
        unfit=unfit,
        doubts=doubts,
        background=background,
    )


# Motion --------------------------------------------------------------------------------------------------------------


def _eight_bits(images: Sequence[ImageArray]) -> list[Any]:
    """The images' grey values (h, w) on one scale of 0 to 255, uint8."""
    shades = [grey(one) for one in images]
    low, high = np.percentile(np.stack(shades), (0.1, 99.9))
    factor = 255.0 / max(float(high - low), 1e-6)
    return [np.clip((one - low) * factor, 0, 255).astype(np.uint8) for one in shades]


def _dis(a: Any, b: Any, start: FloatArray | None = None) -> FloatArray:
    """(h, w, 2) flow [px]; edges of moving things stay sharp, unlike in `dense_flow`."""
    dis: Any = cv2.DISOpticalFlow.create(cv2.DISOpticalFlow_PRESET_MEDIUM)
    dis.setVariationalRefinementDelta(0.0)  # gradients alone: light may change
    dis.setFinestScale(0)
    return np.asarray(dis.calc(a, b, None if start is None else start.copy()), dtype=np.float32)


def _follow(image: FloatArray, flow: FloatArray) -> FloatArray:
    """The image (h, w[, c]) at the places that the flow (h, w, 2) leads to; far off outside of it."""
    x, y = np.moveaxis((_places(flow.shape[:2]) + flow).astype(np.float32), -1, 0)
    outside = (OUTSIDE,) * 4
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside))


def _places(size: tuple[int, ...]) -> FloatArray:
    """(h, w, 2) x, y of each pixel."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    return np.stack([x, y], axis=-1)


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))


def _texture(shade: Any) -> FloatArray:
    """(h, w) smaller eigenvalue of the structure tensor [squared grey values]."""
    gx, gy = (cv2.Scharr(shade, cv2.CV_32F, *axis) / 32.0 for axis in ((1, 0), (0, 1)))
    xx, xy, yy = (_blur(one, 4.0) for one in (gx * gx, gx * gy, gy * gy))
    return np.asarray((xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2))


def _share_found(a: Any, b: Any, flow: FloatArray, least: float) -> float:
    """Share of the textured pixels of `a` whose surroundings correlate by `least` with those the flow leads to."""
    there = _follow(b.astype(np.float32), flow)
    first, second = (one - _blur(one, 6.0) for one in (a.astype(np.float32), np.minimum(there, 255.0)))
    power = (_blur(first * first, 6.0) + 4.0) * (_blur(second * second, 6.0) + 4.0)
    judged = (_texture(a) > 8 * TEXTURE) & (there < OUTSIDE)
    return float(np.mean((_blur(first * second, 6.0) / np.sqrt(power))[judged] > least)) if judged.any() else 1.0


def _other_scene(shades: Sequence[Any], flows: Sequence[FloatArray]) -> ImageFault | None:
    """A cut between scenes, or a mirrored image, if there is one. flows: from the first image to each other one"""
    for index, flow in enumerate(flows):
        if _share_found(shades[0], shades[index + 1], flow, 0.7) > SUSPECT:
            continue
        before, after = shades[index], shades[index + 1]
        if _share_found(before, after, dense_flow(before, after).flow_px, 0.5) > CUT:
            continue
        which = f"between images {index + 1} and {index + 2} of the {len(shades)} looked at"
        for turned in (np.ascontiguousarray(np.flip(after, axis)) for axis in (1, 0)):
            if _share_found(before, turned, dense_flow(before, turned).flow_px, 0.5) > CUT:
                return ImageFault("mirrored", f"the picture is mirrored {which}")
        return ImageFault("scene-cut", f"the scene changes {which}")
    return None


def _similarity(at: FloatArray, flow: FloatArray, which: BoolArray, residual_px: float) -> FloatArray | None:
    """(2, 3) shift, turn and zoom that most of the chosen pixels follow; None where too few were chosen."""
    step = max(1, np.count_nonzero(which) // 4000)
    first = np.ascontiguousarray(at[which][::step])
    if len(first) < FEWEST:
        return None
    found, _ = cv2.estimateAffinePartial2D(
        first, first + flow[which][::step], method=cv2.RANSAC, ransacReprojThreshold=residual_px, maxIters=1000
    )
    return np.asarray(found) if np.ndim(found) else None


def _carried(at: FloatArray, fit: FloatArray) -> FloatArray:
    """(h, w, 2) displacement by a (2, 3) motion."""
    return np.asarray(at @ (fit[:, :2].T - np.eye(2)) + fit[:, 2], dtype=np.float32)


def _motion(shades: Sequence[Any], flows: Sequence[FloatArray], slack: float = 1.0) -> _Motion:
    """The motion from the first image, and what of it is the background's: that of the textured rim, if it moves as
    one, else of all that is textured. slack: factor of the residuals at which a pixel still moves with it"""
    first = shades[0]
    at = _places(first.shape)
    textured = _texture(first) > TEXTURE
    rim = _rim(first.shape, RIM)
    details = [one.astype(np.float32) - _blur(one.astype(np.float32), 6.0) for one in shades]
    back: FloatArray | None = None
    each: list[tuple[BoolArray, FloatArray, BoolArray, FloatArray]] = []
    for shade, detail, flow in zip(shades[1:], details[1:], flows, strict=True):
        back = _dis(shade, first, back)
        known = textured & (np.linalg.norm(flow + _follow(back, flow), axis=2) < RETURNS_PX)
        best = -1.0
        fit: FloatArray = np.eye(2, 3)
        for chosen in (known & rim, known):
            if (tried := _similarity(at, flow, chosen, slack * BACKGROUND_PX)) is None:
                continue
            follows = np.linalg.norm(flow - _carried(at, tried), axis=2) < BACKGROUND_PX
            share = float(np.mean(follows[known & rim])) if (known & rim).any() else 0.0
            if share > best + 0.1:
                best, fit = share, tried
        carried = _carried(at, fit)
        left, left_still = (_blur((_follow(detail, one) - details[0]) ** 2, 2.0) for one in (flow, carried))
        each.append((known, np.linalg.norm(flow - carried, axis=2), left < 0.5 * left_still, fit))
    known, away, shown, fits = (np.stack(one) for one in zip(*each, strict=True))
    most = _largest_motion(away, known)
    limit = slack * float(np.clip(0.06 * most, 0.15, 0.5))
    share = float(np.median([_spread(one < limit, seen & rim) for one, seen in zip(away, known, strict=True)]))
    return _Motion(np.stack(flows), known, away, shown, fits, share, most, limit)


def _rim(size: tuple[int, ...], share: float) -> BoolArray:
    """(h, w) pixels near the border of the picture."""
    wide = max(2, round(share * min(size)))
    rim = np.ones(size, dtype=bool)
    rim[wide:-wide, wide:-wide] = False
    return rim


def _largest_motion(away: FloatArray, known: BoolArray) -> float:
    """The largest motion beyond the background, without outliers [px of the small image]."""
    return float(np.percentile(np.max(away, axis=0, where=known, initial=0.0), 99))


def _spread(still: BoolArray, rim: BoolArray) -> float:
    """Share of the known rim that is still; 0 where all of that is at one side: a tool alone may be there."""
    height, width = rim.shape
    y, x = np.nonzero(rim & still)
    if not len(x):
        return 0.0
    sides = np.argmin([y / height, 1 - y / height, x / width, 1 - x / width], axis=0)
    alone = np.bincount(sides, minlength=4).max() > 0.85 * len(x)
    return 0.0 if alone else float(np.mean(still[rim]))


def _unfit(motion: _Motion, background: BoolArray, scale: float, bright: float) -> list[ImageFault]:
    """What the motion of the background (h, w) says of the camera. bright: as `DARK`"""
    found = []
    height, width = motion.known.shape[1:]
    at = _places((height, width))
    zooms = np.hypot(motion.fits[:, 0, 0], motion.fits[:, 1, 0]) - 1.0
    most = int(np.abs(zooms).argmax())
    if abs(zooms[most]) > ZOOMS:
        text = f"the picture grows by {zooms[most]:+.1%}: the focus or the camera's distance changes"
        found.append(ImageFault("zoom", text))
    middle = np.array([width / 2, height / 2])
    shifts = np.linalg.norm(motion.fits[:, :, :2] @ middle + motion.fits[:, :, 2] - middle, axis=1)
    if shifts.max() > MOVES * max(height, width):
        found.append(ImageFault("camera-moves", f"the background moves by {shifts.max() / scale:.0f} px", lowers=False))
    chosen = motion.known[-1] & background & (motion.away[-1] < 10 * motion.limit)
    if np.count_nonzero(chosen) < FEWEST:
        return found
    first, moved = at[chosen], at[chosen] + motion.flow[-1][chosen]
    flat = float(np.median(_off_plane(first, moved)))
    alike = float(np.median(np.linalg.norm(first + _carried(first, motion.fits[-1]) - moved, axis=1)))
    if alike > BENDS_PX and flat < 0.5 * alike:
        text = f"the camera turns out of the picture's plane: {alike / scale:.1f} px beyond shift, turn and zoom"
        found.append(ImageFault("out-of-plane", text))
    elif flat > BENDS_PX:
        why = "image stabilisation, or a rolling shutter" if bright >= DARK else "too little light"
        found.append(ImageFault("warped", f"the background bends by {flat / scale:.1f} px: {why}"))
    return found


def _off_plane(first: FloatArray, moved: FloatArray) -> FloatArray:
    """(n,) distance of moved places (n, 2) from those of a plane in perspective that most of them follow [px]."""
    plane, _ = cv2.findHomography(first, moved, cv2.RANSAC, BACKGROUND_PX)
    turned = np.asarray(cv2.perspectiveTransform(first[:, None], plane)[:, 0]) if np.ndim(plane) else first
    return np.asarray(np.linalg.norm(turned - moved, axis=1))


def _turned(motion: _Motion, scale: float) -> Iterator[ImageFault]:
    """A camera that turns so far out of the picture's plane that no shift, turn and zoom carries the background: the
    rim moves as a plane in perspective, and not as an evenly stretched body."""
    chosen = motion.known[-1] & _rim(motion.known[-1].shape, RIM)
    if np.count_nonzero(chosen) < FEWEST:
        return
    at = _places(chosen.shape)
    first, moved = at[chosen], (at + motion.flow[-1])[chosen]
    stretch, _ = cv2.estimateAffine2D(first, moved, method=cv2.RANSAC, ransacReprojThreshold=BACKGROUND_PX)
    if np.ndim(stretch) == 0:
        return
    off, near = _off_plane(first, moved), np.zeros(chosen.shape, dtype=bool)
    near[chosen] = off < 2 * BACKGROUND_PX
    alike = float(np.median(np.linalg.norm(first + _carried(first, np.asarray(stretch)) - moved, axis=1)))
    if alike > BENDS_PX and np.median(off) < 0.5 * alike and _spread(near, chosen) >= BACKGROUND:
        text = f"the camera turns out of the picture's plane: {alike / scale:.1f} px beyond an even stretch"
        yield ImageFault("out-of-plane", text)


# Region --------------------------------------------------------------------------------------------------------------


def _region(image: ImageArray, shade: Any, motion: _Motion) -> tuple[BoolArray, BoolArray, float]:
    """(h, w) pixels of the body and of a tool, and the overlap of two ways to find the body, 0 to 1."""
    limit, size = motion.limit, shade.shape
    tool: BoolArray = np.zeros(size, dtype=bool)
    lab = _colours(image)
    if textural := motion.rim < BACKGROUND:
        seed = _largest(_open(motion.known[0] & (_texture(shade) > 8 * TEXTURE), 5))
        if np.mean(seed) > 0.9:
            return np.ones(size, dtype=bool), tool, 1.0
        still, seed = ~seed, _shrunk(seed, 11)  # texture is seen beyond the edge, too
    else:
        moving = _open(np.any(motion.known & motion.shown & (motion.away > 2 * limit), axis=0), 3)
        tool = _tool(motion, moving, lab)
        still = np.all(motion.known & (motion.away < limit), axis=0) & ~moving & ~tool
        seed = _largest(_open(moving & ~_grown(tool, 3), 3))
    if not seed.any() or np.count_nonzero(still) < FEWEST:
        return np.ones(size, dtype=bool), tool, 0.0
    labels = np.where(seed, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[_shrunk(seed, 7)] = cv2.GC_FGD
    labels[tool] = cv2.GC_BGD
    light = lab[:, :, 0].astype(np.float32)
    rough = np.clip(3.0 * np.sqrt(np.maximum(_blur(light * light, 2.5) - _blur(light, 2.5) ** 2, 0.0)), 0, 255)
    tint = np.clip(lab[:, :, 1].astype(int) - lab[:, :, 2] + 128, 0, 255)
    views = [lab, np.dstack([_blur(lab[:, :, 0], 1.5), tint, rough]).astype(np.uint8)]
    views = views[::-1] if textural else views
    first = _body(views[0], labels, seed, tool)
    if np.count_nonzero(first) < FEWEST:
        return np.ones(size, dtype=bool), tool, 0.0
    coarse = (labels[::2, ::2], seed[::2, ::2], tool[::2, ::2])
    second = _body(np.ascontiguousarray(views[not textural][::2, ::2]), *coarse)
    agree = float(np.mean(first[::2, ::2] & second) / np.mean(first[::2, ::2] | second))
    stem = _stem(first, tool) if tool.any() else tool
    return first & ~stem, tool | stem, agree


def _colours(image: ImageArray) -> Any:
    """(h, w, 3) Lab of 8 bits without speckles; of grey images three times the grey."""
    eight = image if image.dtype == np.uint8 else (image / max(int(image.max()), 1) * 255).astype(np.uint8)
    colour = (
        eight[:, :, :3] if eight.ndim == 3 and eight.shape[2] >= 3 else cv2.merge([eight.reshape(eight.shape[:2])] * 3)
    )
    return cv2.medianBlur(cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2LAB), 5)


def _tool(motion: _Motion, moving: BoolArray, lab: Any) -> BoolArray:
    """(h, w) what moves as a rigid body, enters from the border of the picture, and looks unlike the rest that
    moves."""
    rigid = max((_rigid(motion, side) for side in SIDES), key=np.count_nonzero)
    seed = moving & ~_grown(rigid, 7)
    if not rigid.any() or np.count_nonzero(seed) < FEWEST:
        return rigid
    spread = 0.5 * (np.cov(lab[rigid].T) + np.cov(lab[seed].T)) + 2.0 * np.eye(3)
    apart = lab[rigid].mean(axis=0) - lab[seed].mean(axis=0)
    if np.sqrt(apart @ np.linalg.solve(spread, apart)) < UNLIKE:
        return np.zeros(rigid.shape, dtype=bool)
    zone = moving | _grown(rigid, 7)
    like_body, like_tool = (_typical(lab, one) for one in (seed, rigid & _rim(rigid.shape, 2 * RIM)))
    tool = rigid & ~((like_body > BODY_LIKE) & (like_body > like_tool))
    labels = np.where(tool, cv2.GC_PR_FGD, np.where(zone, cv2.GC_PR_BGD, cv2.GC_BGD)).astype(np.uint8)
    labels[_shrunk(seed, 3)] = cv2.GC_BGD
    view = lab.copy()
    view[~zone] = np.median(lab[seed], axis=0)
    return _largest(_open(_cut(view, labels) & zone, 3), rigid)


def _typical(lab: Any, sample: BoolArray) -> FloatArray:
    """(h, w) how often the colour of each pixel occurs in a sample, as a share of that of its commonest colour."""
    counts = cv2.calcHist([lab], [0, 1, 2], sample.astype(np.uint8), [32, 32, 32], [0, 256] * 3)
    soft = scipy.ndimage.gaussian_filter(counts, 1.0)
    return np.asarray((soft / max(float(soft.max()), 1e-9))[tuple(np.moveaxis(lab // 8, -1, 0))])


def _rigid(motion: _Motion, side: str) -> BoolArray:
    """(h, w) the largest piece that enters from a side of the picture and moves as a rigid body, if there is one."""
    last, moving = motion.flow[-1], motion.away[-1] > 2 * motion.limit  # also where texture is too faint to be sure
    size = moving.shape
    at, none = _places(size), np.zeros(size, dtype=bool)
    entering, border = none.copy(), none.copy()
    for strip, share in ((entering, 2 * RIM), (border, 0.012)):
        _seen_from(side, strip)[: max(3, round(share * min(size)))] = True
    chosen = entering & moving & motion.known[-1]
    if np.count_nonzero(chosen) < FEWEST:
        return none
    left = np.zeros(size)
    limit = max(RIGID_PX, RIGID * float(np.median(motion.away[-1][chosen])))
    for _ in range(2):  # again with all of it
        if (fit := _similarity(at, last, chosen, limit)) is None:
            return none
        off = _blur((last - _carried(at, fit)) * moving[:, :, None], 2.0)  # compression makes faint texture tremble
        left = np.linalg.norm(off, axis=2) / np.maximum(_blur(moving.astype(np.float32), 2.0), 0.05)
        chosen = moving & motion.known[-1] & (left < limit)
    rigid = (left < limit) & moving
    if np.mean(rigid[entering & moving & motion.known[-1]]) < ENTERS:
        return none
    rigid = _open(rigid, 5)
    pieces = cv2.connectedComponents(rigid.astype(np.uint8))[1]
    counts = np.bincount(pieces[rigid & border], minlength=2)
    piece = np.asarray(pieces == counts.argmax())
    return piece if counts.max() > 4 and np.mean(piece) > SMALLEST else none


def _body(view: Any, labels: Any, seed: BoolArray, tool: BoolArray) -> BoolArray:
    """(h, w) the body in one view (h, w, 3) of the image, one piece without specks."""
    found = _largest(_cut(view, labels) & ~tool, seed)
    return _largest(_open(_closed(found, 7), 7) & ~tool, seed)


def _cut(view: Any, labels: Any) -> BoolArray:
    """(h, w) foreground of a picture (h, w, 3) by its colours. labels: (h, w) as GrabCut begins with"""
    labels, models = labels.copy(), [np.zeros((1, 65)) for _ in range(2)]
    cv2.setRNGSeed(0)
    cv2.grabCut(view, labels, None, *models, 4, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def _largest(mask: BoolArray, seed: BoolArray | None = None) -> BoolArray:
    """The piece of a mask with most pixels (of the seed)."""
    count, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    counted = pieces[mask if seed is None else mask & seed]
    return mask if count < 3 or not counted.size else np.asarray(pieces == np.bincount(counted).argmax())


def _shape(operation: int, mask: BoolArray, size: int) -> BoolArray:
    """A morphological operation by a disc that does not wear off what touches the border of the picture."""
    disc, edge = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), 2 * size
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), edge, edge, edge, edge, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.morphologyEx(padded, operation, disc)[edge:-edge, edge:-edge] > 0)


_open, _closed, _grown, _shrunk = (
    partial(_shape, one) for one in (cv2.MORPH_OPEN, cv2.MORPH_CLOSE, cv2.MORPH_DILATE, cv2.MORPH_ERODE)
)


def polygon(region: BoolArray) -> FloatArray:
    """(n, 2) corners x, y around the largest piece of a mask (h, w); holes are joined to it by cuts."""
    pieces, nested = cv2.findContours(region.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    around = [float(cv2.contourArea(one)) for one in pieces]
    outer = max(range(len(pieces)), key=lambda index: around[index])
    corners = _simplified(pieces[outer])
    for index, one in enumerate(pieces):
        if nested[0][index][3] == outer and around[index] > HOLE * around[outer]:
            hole = _simplified(one)
            apart = np.linalg.norm(corners[:, None] - hole[None], axis=2)
            here, there = np.unravel_index(int(apart.argmin()), apart.shape)
            way_round = np.concatenate([hole[there:], hole[: there + 1]])
            corners = np.concatenate([corners[: here + 1], way_round, corners[here:]])
    return corners


def _simplified(contour: Any) -> FloatArray:
    """(n, 2) few corners of a contour, a pixel off at most, or more where they would be too many."""
    tolerance, corners = 1.0, contour
    while len(corners) > CORNERS or tolerance == 1.0:
        corners, tolerance = cv2.approxPolyDP(contour, tolerance, closed=True), 1.5 * tolerance
    return np.asarray(corners[:, 0], dtype=np.float64)


# Held sides and contact ----------------------------------------------------------------------------------------------


def _share_of_motion(motion: _Motion) -> FloatArray:
    """(h, w) motion beyond the background as a share of the largest, the median of frames; NaN where it is unknown."""
    most = np.array(
        [_largest_motion(motion.away[one : one + 1], motion.known[one : one + 1]) for one in range(len(motion.away))]
    )
    chosen = most > 0.3 * most.max()
    share = np.where(motion.known, motion.away, np.nan)[chosen] / most[chosen][:, None, None]
    known = np.isfinite(share).any(axis=0)
    found = np.full(known.shape, np.nan)
    found[known] = np.nanmedian(share[:, known], axis=0)
    return found


def _seen_from(side: str, field_: Any) -> Any:
    """An array (h, w) turned so that a side is at its top."""
    if side in ("left", "right"):
        field_ = field_.T
    return field_[::-1] if side in ("bottom", "right") else field_


def _strip(
    side: str, region: BoolArray, share: FloatArray, trim: float = 0.1
) -> tuple[Any, Any, FloatArray, FloatArray]:
    """Along a side, without a share `trim` at its ends: columns (n,) and the edge's distance from the border of the
    picture (n,) [px], and the share of motion at the edge and farther inside (n,), NaN where it is not known."""
    body, moved = _seen_from(side, region), _seen_from(side, share)
    columns = np.flatnonzero(body.any(axis=0))
    cut = round(trim * len(columns))
    columns = columns[cut : len(columns) - cut]
    top = body[:, columns].argmax(axis=0)
    at = [np.minimum(top + depth, len(body) - 1) for depth in (EDGE_PX, _inner(body))]
    return columns, top, moved[at[0], columns], moved[at[1], columns]


def _inner(body: BoolArray) -> int:
    """Depth below the top side of a body at which its inside moves [px]."""
    return max(2 * EDGE_PX, round(INNER * np.count_nonzero(body.any(axis=1))))


def _side_of(region: BoolArray, tool: BoolArray) -> Literal["top", "bottom", "left", "right"]:
    """The side of the body at which the tool is."""
    away = cv2.distanceTransform((~region).astype(np.uint8), cv2.DIST_L2, 5)
    tip = tool & (away <= away[tool].min() + EDGE_PX)
    seen = {one: (_seen_from(one, region).any(axis=1).argmax(), _seen_from(one, tip)) for one in SIDES}
    return max(SIDES, key=lambda one: float(seen[one][0] - np.nonzero(seen[one][1])[0].mean()))


def _stem(region: BoolArray, tool: BoolArray) -> BoolArray:
    """(h, w) part of the region that stands out from its side below the tool: a part of that with another colour."""
    side = _side_of(region, tool)
    body, pushed = _seen_from(side, region), _seen_from(side, _grown(tool, 9)).any(axis=0)
    edge, there = body.argmax(axis=0), body.any(axis=0)
    if np.count_nonzero(there & pushed) < EDGE_PX or np.mean(pushed[there]) > 0.8:
        return np.zeros(region.shape, dtype=bool)
    line = float(np.median(edge[there & ~pushed]))
    if np.median(edge[there & pushed]) > line - 2 * EDGE_PX:
        return np.zeros(region.shape, dtype=bool)
    found: BoolArray = np.asarray(body & (np.arange(len(body))[:, None] < line) & pushed)
    back = found[::-1] if side in ("bottom", "right") else found
    return np.asarray(back.T if side in ("left", "right") else back)


def _cut_off(side: str, region: BoolArray, share: FloatArray) -> float:
    """Share of a side that is the border of the picture."""
    return float(np.mean(_strip(side, region, share)[1] <= max(2, 0.015 * min(region.shape))))


def _contact(
    region: BoolArray, tool: BoolArray, share: FloatArray
) -> tuple[Rect | None, HeldGroup | None, HeldGroup | None, float]:
    """The tool's footprint on the body [px of the small image], its side, a side that is driven as a whole, and how
    sure that is, 0 to 1. Without a tool the footprint is where a side moves most."""
    if tool.any():
        side = _side_of(region, tool)
        turned, body = _seen_from(side, tool), _seen_from(side, region)
        both = np.flatnonzero(turned.any(axis=0) & body.any(axis=0))
        gap = body[:, both].argmax(axis=0) - (len(turned) - turned[::-1, both].argmax(axis=0))
        pressed = both[gap <= np.quantile(gap, 0.1) + max(2 * EDGE_PX, TILTS * len(both))] if len(both) else both
    else:
        side = max(SIDES, key=lambda one: np.nansum(_strip(one, region, share)[2]) / len(_strip(one, region, share)[2]))
        pressed = np.zeros(0, dtype=int)
    columns, _, moved, _ = _strip(side, region, share, trim=0)
    seen = np.isfinite(moved)
    if not seen.any():
        return None, None, None, 0.0
    most = np.flatnonzero(moved[seen] > 0.85 * np.quantile(moved[seen], 0.9))
    # the longest run, with gaps of a few at most
    run = columns[seen][max(np.split(most, np.flatnonzero(np.diff(most) > 2 * EDGE_PX) + 1), key=len)]
    run = np.arange(run[0], run[-1] + 1)
    if not len(pressed):
        if len(run) > 0.75 * len(columns):
            return None, side, side, SURE_CONTACT
        return _footprint(side, region, run), side, None, 0.4
    under = np.intersect1d(pressed, columns)
    if not len(under):
        return None, side, None, 0.0
    under = np.arange(under.min(), under.max() + 1)
    overlap = len(np.intersect1d(under, run)) / len(np.union1d(under, run))
    return _footprint(side, region, under), side, None, overlap


def _footprint(side: str, region: BoolArray, columns: Any) -> Rect:
    """The rectangle [px] below a side, at columns (n,) along it, that holds the outermost row of particles."""
    turned = _seen_from(side, region)
    tall, wide = (np.count_nonzero(turned.any(axis=one)) for one in (1, 0))
    deep = max(CONTACT_ROWS * max(tall, wide) / LONG_SIDE_PARTICLES, tall / 6)
    edge = float(np.median(turned[:, columns].argmax(axis=0)))
    along, length = float(columns[0]), float(len(columns))
    if side in ("bottom", "right"):
        edge = len(turned) - edge - deep
    return Rect(along, edge, length, deep) if side in ("top", "bottom") else Rect(edge, along, deep, length)


def _held(
    region: BoolArray, share: FloatArray, contact: HeldGroup | None, background: bool
) -> tuple[tuple[HeldGroup, ...], float]:
    """Sides that stay while the body moves next to them, or that the border of the picture cuts off; how sure that is,
    0 to 1. contact: side that is pressed; background: whether motion is known against a background"""
    held: list[HeldGroup] = []
    sure = 1.0
    for side in SIDES:
        edge, _, at_edge, inside = _strip(side, region, share)
        if _cut_off(side, region, share) > (0.5 if background else 0.2):  # without one there is no tool to be cut off
            held.append(side)
        elif background and side != contact:
            both = np.isfinite(at_edge) & np.isfinite(inside)
            if np.count_nonzero(both) < 0.3 * len(edge) or inside[both].mean() < UNMOVED:
                continue  # no motion comes there: whether it is held makes no difference
            near = EDGE_PX / _inner(_seen_from(side, region))
            ratio = (float(at_edge[both].sum() / inside[both].sum()) - near) / (1.0 - near)
            middle = 0.5 * (HELD + FREE)
            held += [side] if ratio < middle else []
            sure = min(sure, 0.5 * abs(ratio - middle) / (FREE - middle))
    if held:
        return tuple(held), min(sure, 1.0)
    return (("top", "bottom") if contact is None else (OPPOSITE[contact],)), 0.3


def _enlarged(small: Rect, scale: float, size: tuple[int, int]) -> Rect:
    """A rectangle of the small image in the large one of a size (H, W), in whole px."""
    x, y = max(round(small.x / scale), 0), max(round(small.y / scale), 0)
    wide, tall = round(small.width / scale), round(small.height / scale)
    return Rect(x, y, min(wide, size[1] - x), min(tall, size[0] - y))
