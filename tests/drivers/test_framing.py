"""A decoder's frame search: nothing lost, nothing counted twice, however the stream is cut."""

from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused, Skipped, find_start


class Toy(FrameDecoder[str]):
    """`<<`, one byte of length, the text, and the low byte of the text's sum."""

    def _find(self, buffer: bytes, start: int) -> int:
        return find_start(buffer, start, b"<<")

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[str] | Refused | None:
        if len(buffer) < start + 3:
            return None
        length = buffer[start + 2]
        if length > 20:
            return Refused("length")
        if len(buffer) < start + 4 + length:
            return None
        text = buffer[start + 3 : start + 3 + length]
        if sum(text) & 0xFF != buffer[start + 3 + length]:
            return Refused("checksum")
        return GoodFrame(text.decode("latin-1"), length + 4)


def frame(text: bytes) -> bytes:
    return b"<<" + bytes([len(text)]) + text + bytes([sum(text) & 0xFF])


def both(decoder: Toy, data: bytes) -> list[str | Skipped]:
    return [*decoder.feed(data), *decoder.finish()]


def test_a_good_frame_within_a_bad_one_is_found() -> None:
    bad = b"<<\x10abc" + frame(b"inner") + b"123456789012"
    assert both(Toy(), bad + frame(b"next")) == [Skipped(6, "checksum"), "inner", Skipped(12, "noise"), "next"]


def test_noise_before_between_and_after() -> None:
    stream = b"xx<y" + frame(b"one") + b"<-" + frame(b"two") + b"<<\x05ab"
    assert both(Toy(), stream) == [Skipped(4, "noise"), "one", Skipped(2, "noise"), "two", Skipped(5, "cut off")]


def test_frames_behind_one_that_never_ends_come_out_when_the_stream_does() -> None:
    decoder = Toy()
    assert list(decoder.feed(b"<<\x14" + frame(b"late"))) == []
    assert decoder.pending == 11
    assert list(decoder.finish()) == [Skipped(3, "cut off"), "late"]
    assert decoder.pending == 0


def test_feed_takes_all_even_if_nobody_looks_at_the_events() -> None:
    decoder = Toy()
    decoder.feed(frame(b"ab")[:3])
    assert list(decoder.feed(frame(b"ab")[3:])) == ["ab"]


PIECES = st.lists(st.one_of(st.binary(max_size=12), st.binary(max_size=20).map(frame), st.just(b"<<")), max_size=12)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(PIECES, st.lists(st.integers(1, 9), min_size=1, max_size=5))
def test_events_do_not_depend_on_how_the_stream_is_cut(pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(pieces)
    whole = both(Toy(), stream)
    decoder, events, at, turn = Toy(), [], 0, 0
    while at < len(stream):
        size = cuts[turn % len(cuts)]
        events += decoder.feed(stream[at : at + size])
        assert decoder.pending < 24
        at, turn = at + size, turn + 1
    events += decoder.finish()
    assert [e for e in events if isinstance(e, str)] == [e for e in whole if isinstance(e, str)]
    assert skipped(events) == skipped(whole)
    assert sum(skipped(whole).values()) + sum(len(e) + 4 for e in whole if isinstance(e, str)) == len(stream)
    assert refused(events) == refused(whole)


def skipped(events: list[str | Skipped]) -> dict[str, int]:
    """Refused bytes: in all."""
    return {"bytes": sum(event.count for event in events if isinstance(event, Skipped))}


def refused(events: list[str | Skipped]) -> list[str]:
    """Refused frames, by reason, in order."""
    return [event.reason for event in events if isinstance(event, Skipped) and event.reason != "noise"]
