"""Pressures on a hand's pads, as one picture of the hand: fingers next to each other, distal above proximal pads."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray, IntArray
from deformscope.frames import PadLayout, Stream, TactileFrame
from deformscope.log.canvas import TEXT
from deformscope.log.rig import columns as sent
from deformscope.pictures.palette import BACKGROUND, colors, round_up, tints_of

FINGER_GAP, PART_GAP = 18, 8
"""Texels between the pads of two fingers, and between those of one: room for labels."""
LEFT, RIGHT, ABOVE, BELOW = 22.0, 10.0, 8.0, 18.0
"""Texels around all."""
OVER, BESIDE = 3.2, 11.0
"""Texels from a pad to its name."""
BAR_STEPS = 128
TEXEL_MM = 3.4
"""Pitch of a pad whose geometry is unknown."""


@dataclass(frozen=True, slots=True)
class Hand:
    """Places of the drawn texels.

    pads: pads in the device's order; corners: (row, column) corners of each one's first texel, in texels; rows,
    columns: size of the whole picture; texel_mm: (width, height) size of a texel"""

    pads: tuple[PadLayout, ...]
    corners: tuple[tuple[int, int], ...]
    rows: int
    columns: int
    texel_mm: tuple[float, float]

    @classmethod
    def of(cls, pads: Sequence[PadLayout]) -> "Hand":
        """The picture of a hand: fingers from left to right, with the part farthest from the palm on top."""
        fingers: dict[int, list[int]] = {}
        for place in sorted(range(len(pads)), key=lambda place: (pads[place].finger, -pads[place].part)):
            fingers.setdefault(pads[place].finger, []).append(place)
        corners = [(0, 0)] * len(pads)
        # The parts of all fingers that lie next to the palm stand on one line.
        heights = {part: max(pad.rows for pad in pads if pad.part == part) for part in {pad.part for pad in pads}}
        tops, top = {}, 0
        for part in sorted(heights, reverse=True):
            tops[part], top = top, top + heights[part] + PART_GAP
        left = 0
        for places in fingers.values():
            below: dict[int, int] = {}  # pads on one part of one finger, which no hand is known to have
            for place in places:
                pad = pads[place]
                corners[place] = tops[pad.part], left + below.get(pad.part, 0)
                below[pad.part] = below.get(pad.part, 0) + pad.columns + FINGER_GAP
            left += max(below.values())
        texel_mm = (pads[0].texel_m[0] * 1e3, pads[0].texel_m[1] * 1e3)
        return cls(tuple(pads), tuple(corners), top - PART_GAP, left - FINGER_GAP, texel_mm)

    @classmethod
    def of_shapes(cls, shapes: Sequence[tuple[int, ...]]) -> "Hand":
        """Pads of which only the texels are known: they are drawn side by side."""
        texel_m = (TEXEL_MM * 1e-3, TEXEL_MM * 1e-3)
        return cls.of(
            [PadLayout(f"pad {at}", shape[0], shape[1], texel_m, at, at, 0) for at, shape in enumerate(shapes)]
        )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the picture."""
        return self.columns * self.texel_mm[0], self.rows * self.texel_mm[1]

    @property
    def bounds_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ranges of a view in x and y: the picture, its labels and its bar."""
        (width, height), (x, y) = self.size_mm, self.texel_mm
        return (-LEFT * x, width + RIGHT * x), (-ABOVE * y, height + BELOW * y)

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(rows, columns) of each pad, in the device's order."""
        return [(pad.rows, pad.columns) for pad in self.pads]

    def places(self) -> IntArray:
        """(texels,) place of each texel in the flattened picture, in the device's order."""
        parts = [
            ((top + np.arange(pad.rows))[:, None] * self.columns + left + np.arange(pad.columns)).ravel()
            for pad, (top, left) in zip(self.pads, self.corners, strict=True)
        ]
        return np.concatenate(parts)

    def below_mm(self) -> list[tuple[float, float]]:
        """The middle of each pad's lower edge, in the device's order."""
        return [
            ((left + pad.columns / 2) * self.texel_mm[0], (top + pad.rows) * self.texel_mm[1])
            for pad, (top, left) in zip(self.pads, self.corners, strict=True)
        ]

    def names(self) -> list[tuple[float, float, str]]:
        """(x, y, text) [mm]: names of fingers above them and of parts next to them; without fingers, each pad's name
        above it."""
        (x, y), placed = self.texel_mm, list(zip(self.pads, self.corners, strict=True))
        over = [((left + pad.columns / 2) * x, (top - OVER) * y) for pad, (top, left) in placed]
        split = [pad.name.rpartition("_") for pad in self.pads]
        fingers = {(pad.finger, finger) for pad, (finger, _, _) in zip(self.pads, split, strict=True)}
        parts = {(pad.part, part) for pad, (_, _, part) in zip(self.pads, split, strict=True)}
        if len(fingers) > len(dict(fingers)) or len(parts) > len(dict(parts)) or len(parts) == 1:
            return [(*place, pad.name) for place, pad in zip(over, self.pads, strict=True)]
        tops = {finger: min(top for pad, (top, _) in placed if pad.finger == finger) for finger, _ in fingers}
        found = []
        for (pad, (top, left)), place, (finger, _, part) in zip(placed, over, split, strict=True):
            if top == tops[pad.finger]:
                found.append((*place, finger))
            if left == 0:
                found.append((-BESIDE * x, (top + pad.rows / 2 - OVER / 2) * y, part))
        return found


def log_tactile(
    batch: sent.Batch,
    device: str,
    frames: Sequence[TactileFrame],
    start_ns: int,
    stream: Stream | None,
    shown: sent.Shown | None = None,
) -> None:
    times = sent.frame_times(frames, start_ns)
    batch.send_columns(
        sent.root("tactile", device, "peak_kpa"), times, sent.scalars([_peaks_kpa(frame) for frame in frames])
    )
    batch.send_columns(sent.root("tactile", device), times, sent.recorded(frames))
    if stream is not None and stream.pads:
        hand = Hand.of(stream.pads)
    elif frames[0].pressure_pa:
        hand = Hand.of_shapes([pad.shape for pad in frames[0].pressure_pa])
        log_hand(batch, device, hand)
    else:
        return
    drawn = [frame for frame in frames if [pad.shape for pad in frame.pressure_pa] == hand.shapes]
    if drawn:
        _log_pictures(batch, device, hand, drawn, start_ns, stream, shown)


def _peaks_kpa(frame: TactileFrame) -> FloatArray:
    """(pads,) the highest pressure on each."""
    return np.array([np.max(pad, initial=0.0) * 1e-3 for pad in frame.pressure_pa])


def log_hand(rec: sent.Sink, device: str, hand: Hand) -> None:
    """Log the constants of a hand's pads: names, places, sizes."""
    path = sent.root("display/tactile", device)
    names = [pad.name for pad in hand.pads]
    sent.log_series(
        rec, sent.root("tactile", device, "peak_kpa"), [f"{name} [kPa]" for name in names], tints_of(len(names))
    )
    sharp = rr.components.MagnificationFilter.Nearest
    shape = rr.components.ImageFormat(
        width=hand.columns, height=hand.rows, color_model=rr.ColorModel.RGB, channel_datatype=rr.ChannelDatatype.U8
    )
    rec.log(f"{path}/picture", rr.Image.from_fields(format=shape, magnification_filter=sharp), static=True)
    rec.log(f"{path}/picture", rr.Transform3D(scale=[*hand.texel_mm, 1.0]), static=True)
    titles = hand.names()
    _log_text(rec, f"{path}/name", [(x, y) for x, y, _ in titles], [title for _, _, title in titles])
    _log_text(rec, f"{path}/peak", hand.below_mm(), None)
    bar = np.repeat(colors(np.linspace(0, 1, BAR_STEPS))[None], 2, axis=0)
    (width, height), (_, texel) = hand.size_mm, hand.texel_mm
    rec.log(f"{path}/bar", rr.Image(bar), static=True)
    place = rr.Transform3D(translation=[0.0, height + 9.0 * texel, 0.0], scale=[width / BAR_STEPS, texel / 2, 1.0])
    rec.log(f"{path}/bar", place, static=True)
    ticks = [(share * width, height + 10.0 * texel) for share in (0.0, 0.5, 1.0)]
    _log_text(rec, f"{path}/scale", ticks, None)


def _log_text(rec: sent.Sink, path: str, places: Sequence[tuple[float, float]], labels: Sequence[str] | None) -> None:
    points = rr.Points2D(places, radii=0.01, colors=TEXT, labels=labels, show_labels=True, draw_order=60.0)
    rec.log(path, points, static=True)


def _log_pictures(
    batch: sent.Batch,
    device: str,
    hand: Hand,
    frames: Sequence[TactileFrame],
    start_ns: int,
    stream: Stream | None,
    shown: sent.Shown | None,
) -> None:
    path = sent.root("display/tactile", device)
    times = sent.moments([frame.stamp.host_ns for frame in frames], start_ns)
    peaks_kpa = np.stack([_peaks_kpa(frame) for frame in frames])
    known = stream is not None and stream.full_scale_pa > 0
    end_kpa = stream.full_scale_pa * 1e-3 if stream is not None and known else round_up(float(peaks_kpa.max()))
    texels_pa = [np.concatenate([np.zeros(0), *(pad.ravel() for pad in frame.pressure_pa)]) for frame in frames]
    share = np.stack(texels_pa) * (1e-3 / end_kpa)
    share = np.sqrt(np.clip(share, 0.0, 1.0))  # a gentle touch is a hundredth of what saturates a texel
    picture = np.full((len(frames), hand.rows * hand.columns, 3), BACKGROUND, np.uint8)
    picture[:, hand.places()] = colors(share.ravel()).reshape(*share.shape, 3)
    batch.send_columns(f"{path}/picture", times, rr.Image.columns(buffer=list(picture.reshape(len(picture), -1))))
    _send_labels(batch, f"{path}/peak", times, [[f"{peak:.2f}" for peak in row] for row in peaks_kpa])
    if sent.is_news(shown, device, end_kpa, frames[0].stamp.host_ns):
        since = sent.moments([frames[0].stamp.host_ns], start_ns)
        _send_labels(batch, f"{path}/scale", since, [[f"{end_kpa * at**2:.3g}" for at in (0.0, 0.5, 1.0)]])


def _send_labels(batch: sent.Batch, path: str, times: Sequence[rr.TimeColumn], labels: Sequence[Sequence[str]]) -> None:
    flat = [label for row in labels for label in row]
    batch.send_columns(path, times, rr.Points2D.columns(labels=flat).partition([len(row) for row in labels]))
