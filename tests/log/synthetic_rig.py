"""Made-up readings of a whole rig: a grasp, a poke, an arm on its way, pictures, and how the devices do."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deformscope import frames
from deformscope_drivers.clock import ClockRelation, Stamp
from deformscope_drivers.health import Health, Link, LinkEvent

START_NS = 81_234_567_890_123
FULL_SCALE_PA = 3271.2
PA_PER_COUNT = FULL_SCALE_PA / 4095
PADS = tuple(
    frames.PadLayout(f"{finger}_{part}", rows, 6, (0.0034, 0.0034), 2 * place + row, place, row)
    for place, finger in enumerate(("finger_0", "thumb", "finger_2"))
    for row, (part, rows) in enumerate((("proximal", 14), ("distal", 13)))
)
STREAMS = (
    frames.Stream("fingertip", "wrench", "optoforce", simulated=True, serial="ISE014", fastest_hz=1000.0),
    frames.Stream("skin", "tactile", "dsa", simulated=True, pads=PADS, fastest_hz=12.0, full_scale_pa=FULL_SCALE_PA),
    frames.Stream("jaco", "arm", "jaco", simulated=True, fastest_hz=100.0),
    frames.Stream("hand", "hand", "sdh", fastest_hz=10.0),
    frames.Stream("front", "color", "webcam", fastest_hz=30.0),
    frames.Stream("above", "depth", "openni", simulated=True, fastest_hz=30.0),
)


def ns(time_s: float) -> int:
    return START_NS + round(time_s * 1e9)


def wrench(index: int, device: str = "fingertip", channels: int = 1, torque: bool = False) -> frames.WrenchFrame:
    time_s = index / 1000
    depth = max(0.0, math.sin(2 * math.pi * time_s / 4)) ** 2
    force = np.array([[0.4 * math.sin(7 * time_s), 0.3 * depth, -3.1 * depth]]) + 0.01 * math.sin(1e3 * time_s)
    force_n = np.concatenate([force * (1 + channel) for channel in range(channels)])
    return frames.WrenchFrame(
        stamp=Stamp(ns(time_s) + index % 7, index * 3),
        index=index,
        counts=np.rint(force_n.ravel() * 1000).astype(np.int64),
        force_n=force_n,
        torque_nm=force_n * 0.0123 if torque else None,
        overload=index % 500 == 499,
        usable=index % 400 != 399,
        device=device,
    )


def tactile(index: int, device: str = "skin", rate_hz: float = 12.0) -> frames.TactileFrame:
    time_s = index / rate_hz
    closing = 0.5 - 0.5 * math.cos(2 * math.pi * time_s / 8)
    counts = []
    for pad in PADS:
        y, x = np.mgrid[: pad.rows, : pad.columns]
        middle = (pad.rows / 2 + 2 * math.sin(time_s + pad.index), 2.5 + 0.8 * math.cos(time_s))
        near = np.exp(-((y - middle[0]) ** 2 / 9 + (x - middle[1]) ** 2 / 3))
        counts.append(np.rint(4095 * near * closing * (1.0 if pad.part else 0.45)).astype(np.uint16))
    return frames.TactileFrame(
        stamp=Stamp(ns(time_s), index * 83),
        index=index,
        counts=np.concatenate([pad.ravel() for pad in counts]),
        pressure_pa=tuple(pad * PA_PER_COUNT for pad in counts),
        device=device,
    )


def arm(index: int, device: str = "jaco") -> frames.ArmFrame:
    time_s = index / 100
    swing = math.sin(2 * math.pi * time_s / 10)
    rest = np.array([275.0, 165.0, 75.0, 280.0, 80.0, 75.0])
    velocity = 20 * 2 * math.pi / 10 * math.cos(2 * math.pi * time_s / 10)
    return frames.ArmFrame(
        stamp=Stamp(ns(time_s)),
        index=index,
        joint_deg=rest + swing * np.array([40.0, 15.0, 12.0, 20.0, -20.0, 30.0]),
        joint_velocity_deg_s=np.full(6, velocity),
        joint_torque_nm=np.array([0.1, 9.0 + swing, 4.0, 0.4, 0.3, 0.05]),
        position_m=np.array([0.2 + 0.1 * swing, -0.26, 0.5]),
        rotation_rad=np.array([1.6, 1.1 * swing, 0.1]),
        force_n=np.array([0.2, -0.1, -3.0 * swing]),
        torque_nm=np.array([0.01, 0.02, 0.03 / 7]),
        finger=np.full(3, 0.5 + 0.5 * swing),
        queued=index % 5,
        device=device,
    )


def hand(index: int, device: str = "hand") -> frames.HandFrame:
    time_s = index / 10
    closed = 0.5 - 0.5 * math.cos(2 * math.pi * time_s / 8)
    return frames.HandFrame(
        stamp=Stamp(ns(time_s), None),
        index=index,
        position_deg=closed * np.array([60.0, -30.0, 40.0, -25.0, 45.0, -20.0, 35.0]),
        velocity_deg_s=np.gradient(closed * np.arange(7.0)),
        temperature_c=np.full(9, np.nan) if index < 3 else np.linspace(31.0, 42.0, 9),
        state=("idle",) * 3 + ("positioning" if index % 2 else "blocked",) * 4,
        device=device,
    )


def color(index: int, device: str = "front", size: tuple[int, int] = (480, 640)) -> frames.ColorFrame:
    y, x = np.mgrid[: size[0], : size[1]]
    turn = index / 20
    image = np.stack([x * 255 / size[1], y * 255 / size[0], 128 + 100 * np.sin(x / 40 + turn)], axis=-1)
    return frames.ColorFrame(Stamp(ns(index / 30), index), index, image.astype(np.uint8), device)


def depth(
    index: int, device: str = "above", size: tuple[int, int] = (480, 640), colored: bool = False
) -> frames.DepthFrame:
    y, x = np.mgrid[: size[0], : size[1]]
    rng = np.random.default_rng(index)
    place = size[1] * (0.5 + 0.2 * math.sin(index / 20))
    hill = 160 * np.exp(-((x - place) ** 2 + (y - size[0] / 2) ** 2) / (0.03 * size[1] ** 2))
    seen = np.rint(720 - hill + 0.05 * y + rng.normal(0, 1.0, size)).astype(np.uint16)
    seen[rng.random(size) < 0.01] = 0
    tint = color(index, size=size).image if colored else None
    return frames.DepthFrame(Stamp(ns(index / 30) + 1, None), index, seen, 0.001, tint, device)


def health(time_s: float) -> frames.HealthReport:
    lost = 4.0 < time_s < 6.0
    clock = ClockRelation(1e6 / 7, ns(0.0) - 0.1, 12.5, 2034.7, 9)
    return frames.HealthReport(
        ns(time_s),
        (
            (
                "fingertip",
                Health(
                    Link.CONNECTED,
                    received=int(1000 * time_s),
                    lost=3,
                    skipped_bytes=12,
                    refused={"checksum": 2},
                    resyncs=1,
                    rate_hz=999.7,
                    age_s=0.0013,
                ),
            ),
            ("skin", Health(Link.CONNECTED, received=int(12 * time_s), rate_hz=11.7, age_s=0.04, clock=clock)),
            (
                "jaco",
                Health(Link.CONNECTED, received=int(100 * time_s), rate_hz=99.8, age_s=0.011, extra={"late": 2.0}),
            ),
            (
                "hand",
                Health(Link.LOST, "cable pulled out", 40, lost=20, lost_by_time=20, silent_s=2.0, age_s=time_s - 4.0)
                if lost
                else Health(
                    Link.CONNECTED, received=int(10 * time_s), reconnects=int(time_s >= 6), rate_hz=10, age_s=0.1
                ),
            ),
            ("front", Health(Link.CONNECTED, received=int(30 * time_s), dropped=4, rate_hz=29.9, age_s=0.02)),
            ("above", Health(Link.CONNECTED, received=int(30 * min(time_s, 8.0)), age_s=0.01 + max(0.0, time_s - 8.0))),
        ),
    )


def raw(index: int, device: str = "fingertip") -> list[frames.RawBytes]:
    """Sixteen bytes received, and now and then a command."""
    received = frames.RawBytes(ns(index / 1000), bytes((index * 7 + place) % 256 for place in range(16)), False, device)
    return (
        [received, frames.RawBytes(ns(index / 1000) + 5, b"\xaa\x00\x32\x03", True, device)]
        if index % 250 == 0
        else [received]
    )


def links() -> list[frames.Item]:
    told = [(0.0, Link.CONNECTED, ""), (4.0, Link.LOST, "cable pulled out"), (6.0, Link.CONNECTED, "back")]
    return [frames.LinkChange(LinkEvent(ns(at), link, why), "hand") for at, link, why in told]


def items(seconds: float, size: tuple[int, int] = (480, 640)) -> list[frames.Item]:
    """All devices for a while, in order of time."""
    found: list[frames.Item] = [*links()]
    found += [wrench(index) for index in range(int(1000 * seconds))]
    found += [piece for index in range(int(1000 * seconds)) for piece in raw(index)]
    found += [tactile(index) for index in range(int(12 * seconds))]
    found += [arm(index) for index in range(int(100 * seconds))]
    found += [hand(index) for index in range(int(10 * seconds)) if not 40 <= index < 60]
    found += [color(index, size=size) for index in range(int(30 * seconds))]
    found += [depth(index, size=size) for index in range(int(30 * seconds))]
    found += [health(float(second)) for second in range(int(seconds) + 1)]
    return sorted(found, key=host_ns)


def host_ns(item: frames.Item) -> int:
    if isinstance(item, frames.LinkChange):
        return item.event.host_ns
    return item.host_ns if isinstance(item, frames.RawBytes | frames.HealthReport) else item.stamp.host_ns


def batches(found: list[frames.Item], seconds: float = 0.1) -> Iterator[list[frames.Item]]:
    """The items in portions, as a recorder takes them."""
    by_portion: dict[int, list[frames.Item]] = {}
    for item in found:
        by_portion.setdefault(int((host_ns(item) - START_NS) / (seconds * 1e9)), []).append(item)
    yield from (by_portion[portion] for portion in sorted(by_portion))


URDF = Path(__file__).with_name("arm.urdf")
