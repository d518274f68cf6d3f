"""Dense optical flow between two images: where each pixel of the first is found in the second."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt
import scipy  # its parts are imported as they are first used: who only reads results needs none

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError

T = TypeVar("T")

SMALLEST_PX = 16
"""Shortest image side that the flow is computed for [px]: two DIS patches of 8 px."""

Image = npt.NDArray[Any]
"""(H, W), (H, W, 3) RGB or (H, W, 4) RGBA; uint8, uint16 or float."""


@dataclass(frozen=True, slots=True)
class FlowField:
    """Displacement of every pixel of the first image towards the second.

    flow_px: (H, W, 2) float32, (x, y) [px]; x to the right, y down; noise_px: (H, W) float32, one standard deviation of
    each coordinate [px] as image noise and texture let expect
    misfit: (H, W) float32, 0 to 1, share of the contrast around a pixel that the flow leaves unexplained beyond the
    usual noise: near 1 the pixel is not visible at its new place
    origin_px, scale: where the flow is that of a part of a picture, reduced: corner (x, y) of the part [px], and pixels
    of the picture for one of these; lengths are in pixels of the picture"""

    flow_px: FloatArray
    noise_px: FloatArray | None = None
    misfit: FloatArray | None = None
    origin_px: tuple[int, int] = (0, 0)
    scale: int = 1

    def placed(self, origin_px: tuple[int, int], scale: int) -> "FlowField":
        """This flow of a reduced part as that of its picture."""
        noise = None if self.noise_px is None else self.noise_px * np.float32(scale)
        return FlowField(self.flow_px * np.float32(scale), noise, self.misfit, origin_px, scale)

    def inside(self, xy: FloatArray) -> FloatArray:
        """(K, 2) points of the picture [px], in pixels of this array."""
        return np.asarray((xy - self.origin_px + 0.5) / self.scale - 0.5)


def grey(image: Image) -> FloatArray:
    """The (H, W) float32 grey values of an image, on the image's own scale (ITU-R BT.601 weights; alpha is ignored)."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 2 and image.size:
        return np.ascontiguousarray(image, dtype=np.float32)
    if image.ndim == 3 and image.shape[2] in (3, 4) and image.size:
        rgb = np.ascontiguousarray(image[:, :, :3], dtype=np.float32)
        return np.asarray(cv2.transform(rgb, np.array([[0.299, 0.587, 0.114]], dtype=np.float32)))
    raise InputError("an image of shape (H, W), (H, W, 3) or (H, W, 4)", f"shape {image.shape}")


def dense_flow(before: Image, after: Image) -> FlowField:
    """Flow from `before` to `after`.

    Feature matches that agree with their neighbours (SIFT, Lowe 2004) start DIS (Kroeger 2016), which finds large
    motions. A windowed least-squares refinement (Lucas and Kanade 1981) makes the result sub-pixel. Rms vector error
    against known displacement (this, against DIS "medium" alone; 360 x 360 px, grey noise 2 of 255). Speckles of
    3 px: 5 px shift .003 / .055, 20 % strain .011 / .22, 30 px shift .010 / 30, 10 degrees .011 / .18. Foam: 0.1 px
    waves .03 / .04, 60 px shift .05 / .6; faint texture, 3 degrees .09 / .22. DIC Challenge sample 14 L1: .010 / .028.
    Motion waves shorter than about 60 px are flattened; without texture the flow is a guess.

    Repeatable bit for bit on one machine; DIS splits its work by the number of OpenCV threads, so another thread
    count changes the last digits."""
    a, b = _views(before, after)
    return _flow(_featured(a), _featured(b))


def flow_both_ways(before: Image, after: Image, at: FloatArray | None = None) -> tuple[FlowField, FlowField]:
    """`dense_flow` from `before` to `after` and back; at once where OpenCV is held to one thread. at: (K, 2) points
    (x, y) [px]: if the images correlate by `FITS` at all of them without features, these are not sought"""
    first, second = _views(before, after)
    a, b = _both(lambda: _featured(first), lambda: _featured(second))
    return _both(lambda: _flow(a, b, at), lambda: _flow(b, a, at))


@dataclass(frozen=True, slots=True)
class FlowStep:
    """A step from one image of a sequence to the next.

    forward, backward: flow there and back
    fits: (H, W) each, local correlation of the images under each of them; steady: refined from the step before"""

    forward: FlowField
    backward: FlowField
    fits: tuple[FloatArray, FloatArray]
    steady: bool = False


def flow_onward(before: Image, after: Image, last: FlowStep | None = None, at: FloatArray | None = None) -> FlowStep:
    """Flow both ways in a sequence, in a seventh of the time if the motion continues.

    last: result of the step to `before`. Its flow is refined alone, without features and DIS. If the images then
    correlate worse than in the last step by `FIT_DROP` anywhere, motion or light have changed, and the flow is computed
    as for a pair. at: (K, 2) points (x, y) [px] of a body that moves before another thing: the last flow is carried
    along with it, and the correlation is compared at these points alone"""
    a, b = _views(before, after)
    if last is not None:
        there, back, *was = last.forward.flow_px, last.backward.flow_px, *last.fits
        if at is not None:
            there, back, *was = (_follow(one, last.backward.flow_px)[0] for one in (there, back, *was))
        refine = partial(_refine, passes=PASSES_ONWARD, quick=at is not None)
        fields = _both(lambda: refine(a, b, there), lambda: refine(b, a, back))
        fits = _fits(a, b, fields)
        change = np.linalg.norm(fields[0].flow_px - there, axis=2)
        typical = float(np.median(change if at is None or not len(at) else _nearest(change, at)))
        drops: list[FloatArray] = [one - fit for one, fit in zip(was, fits, strict=True)]
        if at is not None:
            drops = [_nearest(drop, at) for drop in drops]
        if typical < CHANGE_PX and all(float(drop.max(initial=0.0)) < FIT_DROP for drop in drops):
            return FlowStep(*fields, fits, steady=True)
    fields = flow_both_ways(before, after, at)
    return FlowStep(*fields, _fits(a, b, fields))


def refined(before: Image, after: Image, rough: FlowStep, last: tuple[FlowStep, FlowField] | None = None) -> FlowField:
    """Forward flow, from a step between the same images at half or a third of their resolution.

    last: the step before it and its flow in these pixels, if `rough` goes on from it: what is finer than `rough` is
    taken over from there, and one pass is enough"""
    a, b = _views(before, after)
    times = np.float32(round(a.shape[1] / rough.forward.flow_px.shape[1]))
    if last is None:
        return _refine(a, b, _enlarge(rough.forward.flow_px * times, a.shape), PASSES_ONWARD, quick=True)
    step, fine = last
    change = rough.forward.flow_px - _follow(step.forward.flow_px, step.backward.flow_px)[0]
    finer = _follow(fine.flow_px, _enlarge(step.backward.flow_px * times, a.shape))[0]
    return _refine(a, b, finer + _enlarge(change * times, a.shape), PASSES_ONWARD[-1:], quick=True)


def reduced(image: Image, by: int) -> Image:
    """An image (H, W[, c]) averaged over `by` x `by` px, of which H and W are multiples."""
    return image if by == 1 else np.asarray(_shrink(image, by))


def _fits(a: FloatArray, b: FloatArray, fields: tuple[FlowField, FlowField]) -> tuple[FloatArray, FloatArray]:
    """(H, W) each: how well `a` and `b` correlate under the flow from `a` to `b`, and from `b` to `a`."""
    return _fit(a, b, fields[0].flow_px), _fit(b, a, fields[1].flow_px)


def _both(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """The results of two calls, made at once where OpenCV is held to one thread."""
    if cv2.getNumThreads() > 1:
        # two calls would share OpenCV's threads, and DIS's stripes then be other ones from time to time
        return first(), second()
    with ThreadPoolExecutor(1) as beside:
        other = beside.submit(second)
        return first(), other.result()


def _nearest(values: FloatArray, at: FloatArray) -> FloatArray:
    """(K,) values of an (H, W) array at the pixels nearest to points (K, 2) [px]."""
    col, row = np.rint(at).astype(int).clip(0, (values.shape[1] - 1, values.shape[0] - 1)).T
    return np.asarray(values[row, col])


@dataclass(frozen=True)
class _Featured:
    """An image on 0..255, (H, W); rounded to 8 bits; its features: places (n, 2) [px] and their SIFT descriptors."""

    grey: FloatArray
    grey8: Image

    @cached_property
    def features(self) -> tuple[FloatArray, Any]:
        keys, words = cv2.SIFT.create(nfeatures=4000, contrastThreshold=0.02).detectAndCompute(self.grey8, None)
        return np.array([key.pt for key in keys]), words


def _featured(grey: FloatArray) -> _Featured:
    """An image (h, w), 0 to 255, whose features are sought when they are needed."""
    return _Featured(grey, np.clip(np.rint(grey), 0, 255).astype(np.uint8))


def _views(before: Image, after: Image) -> tuple[FloatArray, FloatArray]:
    """Both (H, W), on 0..255."""
    if before.dtype != after.dtype:
        raise InputError("two images of one type", f"{before.dtype} and {after.dtype}", "convert one of them")
    a, b = grey(before), grey(after)
    if a.shape != b.shape:
        raise InputError("two images of one size", f"{a.shape} and {b.shape} (rows, columns)", "crop both alike")
    if min(a.shape) < SMALLEST_PX:
        raise InputError(f"images of at least {SMALLEST_PX} x {SMALLEST_PX} px", f"{a.shape} (rows, columns)")
    return _stretch(a, b)


def _flow(a: _Featured, b: _Featured, at: FloatArray | None = None) -> FlowField:
    return _refine(a.grey, b.grey, _coarse(a, b, at), quick=at is not None)


def _stretch(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both images (h, w) on 0..255 by one common scaling, so that 12 bits in 16 keep their contrast and the pair its
    ratio."""
    low, high = np.percentile(np.stack([a, b]), (0.1, 99.9))
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError("finite grey values", "NaN or infinity in an image")
    if high <= low:  # nearly uniform: what there is may all lie in the tails
        low, high = min(a.min(), b.min()), max(a.max(), b.max())
    scale = 255.0 / max(float(high - low), 1e-6)
    return (a - np.float32(low)) * np.float32(scale), (b - np.float32(low)) * np.float32(scale)


# --- pixel accuracy -------------------------------------------------------------------------------------------------


def _coarse(a: _Featured, b: _Featured, at: FloatArray | None) -> FloatArray:
    """(h, w, 2) flow [px] by DIS, once from rest and once from feature matches; each pixel takes the flow under which
    its window fits. at: see `flow_both_ways`"""
    a8, b8 = a.grey8, b.grey8
    flow = _dis(a8, b8, None)
    if at is not None and (_nearest(_fit(a8, b8, flow), at) > FITS).all():
        return flow
    start = _from_features(a, b)
    if start is None:
        return flow
    other = _dis(a8, b8, start)
    # A repetitive pattern fits in many places: the flow from rest stays unless the other fits clearly better.
    better = _fit(a8, b8, other) > _fit(a8, b8, flow) + 0.03
    return np.where(better[:, :, None], other, flow)


def _dis(a8: Image, b8: Image, start: FloatArray | None) -> FloatArray:
    """(h, w, 2) flow [px] by DIS. start: (h, w, 2), from which it is sought"""
    dis: Any = cv2.DISOpticalFlow.create(cv2.DISOpticalFlow_PRESET_MEDIUM)
    # Gradients alone, held together more firmly: lighting may change, and noise weighs less.
    dis.setVariationalRefinementDelta(0.0)
    dis.setVariationalRefinementAlpha(60.0)
    if min(a8.shape) >= 96:  # larger patches stand more noise, but leave a small image too few levels
        dis.setPatchSize(12)
        dis.setPatchStride(4)
    return np.asarray(dis.calc(a8, b8, None if start is None else start.copy()), dtype=np.float32)


def _from_features(a: _Featured, b: _Featured) -> FloatArray | None:
    """A rough flow from SIFT matches (Lowe 2004), (H, W, 2) [px]; None where too few agree with their neighbours."""
    (a_at, a_words), (b_at, b_words) = a.features, b.features
    if min(len(a_at), len(b_at)) < 2:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a_words, b_words, k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < 8:
        return None
    found = a_at[[match.queryIdx for match in good]]
    at, first_of = np.unique(found, axis=0, return_index=True)
    motion = b_at[[good[i].trainIdx for i in first_of]] - at
    # A right match moves like half its neighbours at least: within 3 px and 30 % strain.
    far, near = scipy.spatial.cKDTree(at).query(at, min(9, len(at)))
    agree = np.linalg.norm(motion[near] - motion[:, None], axis=2) < 3.0 + 0.3 * far
    kept = agree.mean(axis=1) >= 0.5
    if kept.sum() < 8:
        return None
    at, motion = at[kept], motion[kept]
    height, width = a.grey8.shape
    rows, cols = -(-height // 8), -(-width // 8)
    y, x = np.mgrid[:rows, :cols]
    nodes = np.stack([(x + 0.5) * width / cols - 0.5, (y + 0.5) * height / rows - 0.5], axis=-1)
    _, near = scipy.spatial.cKDTree(at).query(nodes, 6)
    rough: FloatArray = np.median(motion[near], axis=2).astype(np.float32)
    return _enlarge(_blur(rough, 1.5), (height, width))


def _fit(a: Image, b: Image, flow: FloatArray) -> FloatArray:
    """Zero-mean normalised correlation of each pixel's window with the window that the flow leads to, (H, W)."""
    b, inside = _follow(b.astype(np.float32), flow)
    a, b = (x - _wide_blur(x, 8.0) for x in (np.asarray(a, dtype=np.float32), b))
    floor = 4.0  # squared grey values: below this contrast a window says nothing
    power = (_wide_blur(a * a, 8.0) + floor) * (_wide_blur(b * b, 8.0) + floor)
    return np.asarray(_wide_blur(a * b * inside, 8.0) / np.sqrt(power))


# --- sub-pixel accuracy ---------------------------------------------------------------------------------------------

PASSES = (8.0, 8.0, 6.0, 6.0, 6.0)
"""Standard deviation of the Gaussian window of each refinement pass [px]."""

PASSES_ONWARD = PASSES[-2:]
"""Passes that start from the previous step's flow, or from that of a lower resolution: a third pass changes no
particle's error (docs/results/fits.md)."""

FITS = 0.9
"""Correlation in a window of 8 px of images that surely show the same."""

CHANGE_PX = 1.0
"""Change of the flow between two steps of a sequence [px], in the median, that its refinement surely follows: a pass
corrects by 1 px at most, and a smooth texture correlates well a pixel off its place."""

FIT_DROP = 0.25
"""Fall of the correlation in a window of 8 px, between two steps of a sequence, that noise does not explain. In steady
motion the largest drop in an image is .10 to .17, in a jump of 3 px 1.3."""

SMOOTHING_PX = (24.0, 11.0, 5.0)
"""Standard deviations of the flow's smoothing [px], one of which is chosen by texture and noise."""

PASSED = (0.15, 0.5, 1.15)
"""Noise variance after each of these smoothings, in units of that of one window of 6 px (set on known motions)."""


def _refine(
    a: FloatArray, b: FloatArray, flow: FloatArray, passes: Sequence[float] = PASSES, *, quick: bool = False
) -> FlowField:
    """Windowed Lucas-Kanade steps from a flow that is right to about a pixel.

    Each pass warps `b` by the flow and matches its local brightness and contrast to `a`. It solves the 2 x 2 normal
    equations of every window for a correction, and smooths the result. The flow lives on every second pixel: it is
    smoother than that, and it saves three quarters of the work. quick: the widest smoothing is worked out on a coarser
    grid"""
    a, b = (_blur(x, 0.7) for x in (a, b))  # noise that no interpolation follows
    unit = max(float(np.std(a)), 1e-3)
    a, fine = a / unit, _double(b / unit)
    u = _shrink(flow)
    start = u
    left = misfit = texture = rr = np.zeros_like(u[:, :, 0])
    for index, window in enumerate(passes):
        if index and window != passes[index - 1]:
            start = u
        full = _enlarge(u, a.shape)
        warped, inside = _follow(fine, full, 2)
        target, warped = _alike(a, warped, inside)
        gx, gy = (0.5 * (p + q) for p, q in zip(_gradient(target), _gradient(warped), strict=True))
        gx, gy = gx * inside, gy * inside
        r = (target - warped) * inside
        sigma = window / 2
        gxx, gxy, gyy = _window_means(sigma, gx * gx, gx * gy, gy * gy)
        bx, by, rr = _window_means(sigma, gx * r, gy * r, r * r)
        # What one window leaves open, in units of squared gradient times squared px: its mean squared residual over
        # its number of independent pixels (the blur above ties neighbours: about four to one).
        open_ = rr * (4.0 / (4.0 * np.pi * window * window))
        damping = open_ / 0.3**2 + 1e-5  # a correction is 0.3 px, as far as known beforehand
        texture = (gxx * gyy - gxy * gxy) / (gxx + gyy + 1e-12)
        gxx, gyy = gxx + damping, gyy + damping
        bx, by = bx + damping * (start - u)[:, :, 0], by + damping * (start - u)[:, :, 1]
        step = np.dstack([gyy * bx - gxy * by, gxx * by - gxy * bx]) / (gxx * gyy - gxy * gxy)[:, :, None]
        length = np.sqrt((step * step).sum(axis=2, keepdims=True))
        u = u + step / np.maximum(1.0, length)
        (contrast,) = _window_means(sigma, (target * target + warped * warped) * inside)
        misfit = np.clip((rr - 2.0 * np.median(rr)) / (contrast + 1e-4), 0.0, 1.0)
        weight = (1.0 - misfit) * texture / (texture + damping) + 1e-3
        u, left = _smooth(u, weight, (open_ + 1e-7) / (texture + 1e-7), quick)
    # Noise has gradients too, about 0.15 of the residual's power: those say nothing.
    left = left * (texture + 1e-7) / (np.maximum(texture - 0.15 * rr, 0.25 * texture) + 1e-7)
    flow, noise, misfit = (_enlarge(x, a.shape) for x in (u, np.sqrt(np.minimum(left, 100.0)), misfit))
    return FlowField(flow, noise, misfit)


def _alike(a: FloatArray, b: FloatArray, inside: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both images (h, w) without their local mean, `b` with the local contrast of `a`, so that light may change.
    inside: (h, w) 1 where known"""
    known = _wide_blur(inside, 20.0) + 1e-3
    a, b = ((x - _wide_blur(x * inside, 20.0) / known) * inside for x in (a, b))
    gain = (_wide_blur(a * a, 20.0) + 1e-4) / (_wide_blur(b * b, 20.0) + 1e-4)
    return a, b * np.sqrt(np.clip(gain, 0.25, 4.0))


def _smooth(
    u: FloatArray, weight: FloatArray, variance: FloatArray, quick: bool = False
) -> tuple[FloatArray, FloatArray]:
    """The flow smoothed as widely as noise alone explains what a narrower smoothing would add (Wiener's rule).

    u: (h, w, 2) on the half grid; weight: (h, w) certainty; variance: (h, w) variance of one coordinate [px^2]
    returns the smooth flow and the variance that is left, (h, w) [px^2]"""
    sigmas = [sigma / 2 for sigma in SMOOTHING_PX]
    blur = _wide_blur if quick else _blur
    smooth, left = _certain_blur(u, weight, sigmas[0], blur), PASSED[0] * variance
    for wider, sigma, passed in zip(sigmas, sigmas[1:], np.diff(PASSED), strict=False):
        detail = _certain_blur(u, weight, sigma, blur) - smooth
        seen = blur((detail * detail).sum(axis=2), wider)
        # Noise of two coordinates, of which about half reaches the detail.
        share = np.clip(1.0 - 0.5 * 2.0 * variance / (seen + 1e-12), 0.0, 1.0)
        smooth = smooth + share[:, :, None] * detail
        left = left + passed * share * variance
    return smooth, left


def _certain_blur(
    u: FloatArray, weight: FloatArray, sigma: float, blur: Callable[[FloatArray, float], FloatArray]
) -> FloatArray:
    """Normalised Gaussian smoothing of u (h, w, c) by weights (h, w), twice, the second time of what the first took
    away: quadratics pass unchanged. sigma: [px]"""
    w = weight[:, :, None]
    norm = blur(weight, sigma)[:, :, None]
    once = blur(w * u, sigma) / norm
    return np.asarray(once + blur(w * (u - once), sigma) / norm)


def _follow(b: FloatArray, flow: FloatArray, scale: int = 1) -> tuple[FloatArray, FloatArray]:
    """`b`, sampled `scale` times per px, seen from the first image, (H, W), and where that lies inside (1, else 0)."""
    height, width = flow.shape[:2]
    x = flow[:, :, 0] + np.arange(width, dtype=np.float32)
    y = flow[:, :, 1] + np.arange(height, dtype=np.float32)[:, None]
    inside: BoolArray = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    warped = cv2.remap(b, x * scale, y * scale, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped), inside.astype(np.float32)


def _double(image: FloatArray) -> FloatArray:
    """The image's cubic spline at every half pixel, (2 H, 2 W); sample 2 i lies on pixel i.

    OpenCV's own bicubic and Lanczos kernels displace a pattern by up to 0.04 and 0.009 px (measured on speckles).
    Linear interpolation between the samples of a spline displaces it by less than 0.001 px."""
    knots = scipy.ndimage.spline_filter(image, order=3, output=np.float32, mode="mirror")
    knots = cv2.pyrUp(knots)  # (1 4 6 4 1) / 8 is the refinement of a cubic B-spline
    at_knot, one = np.array([1, 4, 1], dtype=np.float32) / 6, np.ones(1, dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(cv2.sepFilter2D(knots, cv2.CV_32F, at_knot, one), cv2.CV_32F, one, at_knot))


def _gradient(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """d/dx and d/dy by the five-point rule, [1/px]."""
    rule, one = np.array([1, -8, 0, 8, -1], dtype=np.float32) / 12, np.ones(1, dtype=np.float32)
    return (
        np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, rule, one)),
        np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, one, rule)),
    )


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))


def _window_means(sigma: float, *images: FloatArray) -> list[FloatArray]:
    """Gaussian means of full images (h, w) on the half grid; sigma in half-grid pixels."""
    return [_blur(_shrink(image), sigma) for image in images]


def _wide_blur(image: FloatArray, sigma: float) -> FloatArray:
    """A Gaussian blur of an image (h, w), worked out on a coarser grid. sigma: [px]"""
    coarse = max(1, int(sigma / 4))
    return _enlarge(_blur(_shrink(image, coarse), sigma / coarse), image.shape)


def _shrink(image: FloatArray, by: int = 2) -> FloatArray:
    """Means of an image (h, w) or (h, w, c) over `by` x `by` px."""
    height, width = image.shape[:2]
    return np.asarray(cv2.resize(image, (-(-width // by), -(-height // by)), interpolation=cv2.INTER_AREA))


def _enlarge(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """An image (h, w) or (h, w, c) of another size, interpolated linearly."""
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))
