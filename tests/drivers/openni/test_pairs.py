"""Depth and colour of one moment are put together, whichever comes first; and pictures cross to the other process."""

from deformscope_drivers.frame_message import FrameMessage
from deformscope_drivers.hosted import Channel, HostedProcess
from deformscope_drivers.openni.camera import WAITING, Pairs
from deformscope_drivers.openni.library import Frame, PixelFormat
from tests.patience import PATIENCE_S

PERIOD_US = 33_333
PICTURE = FrameMessage(-2, 33_000, 1, 2, 1, 1, 1, b"\x10\x27\0\0", b"\xff\0\7")


def depth(at_us: int, index: int = 0) -> Frame:
    return Frame(at_us, index, 2, 1, PixelFormat.DEPTH_1_MM, b"\1\0\2\0")


def color(at_us: int) -> Frame:
    return Frame(at_us, 0, 1, 1, PixelFormat.RGB888, at_us.to_bytes(3, "little"))


def fed(pairs: Pairs, frames: list[Frame]) -> list[tuple[int, int | None]]:
    """Timestamps of the depth and colour of every picture."""
    found = []
    for host_ns, frame in enumerate(frames):
        for message in pairs.add(frame, host_ns):
            seen = int.from_bytes(message.color, "little") if message.color else None
            found.append((message.timestamp_us, seen))
    return found


def test_depth_alone_goes_straight_through() -> None:
    assert Pairs(30, wanted=False).add(depth(7, 3), 99) == [FrameMessage(99, 7, 3, 2, 1, 0, 0, b"\1\0\2\0", b"")]


def test_colour_first_and_depth_first() -> None:
    assert fed(Pairs(30, wanted=True), [color(100), depth(90)]) == [(90, 100)]
    assert fed(Pairs(30, wanted=True), [depth(90), color(100)]) == [(90, 100)]


def test_colour_may_lag_behind_by_more_than_a_period() -> None:
    frames = [depth(PERIOD_US * 1), depth(PERIOD_US * 2), color(PERIOD_US * 1), depth(PERIOD_US * 3)]
    frames += [color(PERIOD_US * 2), color(PERIOD_US * 3)]
    assert fed(Pairs(30, wanted=True), frames) == [(PERIOD_US * n, PERIOD_US * n) for n in (1, 2, 3)]


def test_the_nearest_colour_is_taken_and_none_that_is_half_a_period_away() -> None:
    frames = [color(1_000), color(12_000), depth(10_000), color(60_000), depth(80_000), color(100_000)]
    assert fed(Pairs(30, wanted=True), frames) == [(10_000, 12_000), (80_000, None)]


def test_depth_without_any_colour_does_not_wait_for_ever() -> None:
    pairs = Pairs(30, wanted=True)
    assert fed(pairs, [depth(PERIOD_US * n) for n in range(WAITING + 2)]) == [(0, None), (PERIOD_US, None)]
    assert len(pairs.rest()) == WAITING
    assert pairs.rest() == []


def test_a_frame_that_is_cut_off_has_no_size() -> None:
    cut = Frame(7, 3, 2, 1, PixelFormat.DEPTH_1_MM, b"\1\0\2")
    cut_color = Frame(7, 0, 1, 1, PixelFormat.RGB888, b"\1\2")
    assert Pairs(30, wanted=False).add(cut, 99) == [FrameMessage(99, 7, 3, 0, 0, 0, 0, b"", b"")]
    pairs = Pairs(30, wanted=True)
    assert pairs.add(cut_color, 98) == []
    assert pairs.add(depth(7), 99) == [FrameMessage(99, 7, 0, 2, 1, 0, 0, b"\1\0\2\0", b"")]


def send_a_picture(channel: Channel) -> None:
    channel.send("frame", PICTURE)


def test_a_picture_crosses_to_the_other_process() -> None:
    process = HostedProcess("a process", "test", None)
    process.start(send_a_picture)
    try:
        assert process.receive(PATIENCE_S) == ("frame", PICTURE)
    finally:
        process.end(PATIENCE_S)


def test_a_count_of_frames_has_32_bits() -> None:
    (message,) = Pairs(30, wanted=False).add(depth(7, -1), 99)
    assert message.index == 0xFFFFFFFF
