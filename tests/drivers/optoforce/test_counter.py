"""Loss by the counter: learned steps, wraps, damage, latecomers, repeats, restarts; the sum of all gaps is the loss."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.optoforce.counter import LEARNED_FROM, CounterStep, CounterTrack

MS = 1_000_000


def follow(track: CounterTrack, counters: list[int], *, period_ns: int = MS, start_ns: int = 0) -> list:
    """Readings that arrive on time, one by one."""
    return [track.follow(counter % 65536, start_ns + at * period_ns) for at, counter in enumerate(counters)]


def track_of(step: int = 1, period_ns: float | None = MS, first: int = 0) -> tuple[CounterTrack, int, int]:
    """A track that knows its step, the last counter it saw, and when the next reading is due."""
    track = CounterTrack(period_ns)
    counters = [first + step * at for at in range(LEARNED_FROM + 1)]
    gaps = follow(track, counters, period_ns=int(period_ns or MS))
    assert [gap.verdict for gap in gaps] == [CounterStep.FIRST] + [CounterStep.NEXT] * LEARNED_FROM
    assert track.step == step
    return track, counters[-1], len(counters) * int(period_ns or MS)


@pytest.mark.parametrize("step", [1, 3, 10, 33, 100])
def test_the_step_is_learned_and_loss_counted_in_readings(step: int) -> None:
    track, last, now_ns = track_of(step, period_ns=step * MS, first=65536 - 4 * step)
    gap = track.follow((last + 4 * step) % 65536, now_ns + 3 * step * MS)
    assert (gap.verdict, gap.lost) == (CounterStep.LOST, 3)
    assert track.lost == 3
    assert track.follow((last + 5 * step) % 65536, now_ns + 4 * step * MS).verdict is CounterStep.NEXT


def test_loss_while_the_step_is_learned_is_reported_when_it_is() -> None:
    track = CounterTrack(MS)
    assert [gap.lost for gap in follow(track, [5, 6, 7, 9, 10, 13, 14, 15, 16])] == [0] * 8 + [3]
    assert track.lost == 3


def test_a_damaged_counter_while_the_step_is_learned_is_no_loss() -> None:
    track = CounterTrack(MS)
    assert [gap.lost for gap in follow(track, [5, 6, 7, 8 ^ 0x2000, 9, 10, 12, 13, 14])] == [0] * 8 + [1]
    assert track.step == 1


def test_a_damaged_counter_is_no_loss() -> None:
    for bit in range(16):
        track, last, now_ns = track_of(first=1000)
        gaps = follow(track, [(last + 1) ^ 1 << bit, last + 2, last + 3], start_ns=now_ns)
        assert gaps[0].verdict is not CounterStep.NEXT
        assert [gap.verdict for gap in gaps[1:]] == [CounterStep.CORRECTED, CounterStep.NEXT]
        assert sum(gap.lost for gap in gaps) == track.lost == 0
        assert track.damaged == 1
        assert track.restarts == track.late == track.repeated == 0


def test_a_damaged_counter_beside_a_loss() -> None:
    for damaged in (40_000, 1500):
        track, last, now_ns = track_of(first=1000)
        gaps = follow(track, [damaged, last + 4, last + 5], start_ns=now_ns)
        assert [gap.verdict for gap in gaps[1:]] == [CounterStep.CORRECTED, CounterStep.NEXT]
        assert sum(gap.lost for gap in gaps) == track.lost == 2


def test_a_reading_that_others_overtook() -> None:
    track, last, now_ns = track_of(first=65530)
    gaps = follow(track, [last + 1, last + 3, last + 2, last + 4], start_ns=now_ns)
    assert [gap.verdict for gap in gaps] == [CounterStep.NEXT, CounterStep.LOST, CounterStep.LATE, CounterStep.NEXT]
    assert sum(gap.lost for gap in gaps) == track.lost == 0
    assert track.late == 1


def test_a_reading_sent_twice() -> None:
    track, last, now_ns = track_of()
    gaps = follow(track, [last + 1, last + 1, last + 2], start_ns=now_ns)
    assert [gap.verdict for gap in gaps] == [CounterStep.NEXT, CounterStep.REPEATED, CounterStep.NEXT]
    assert (track.repeated, track.lost) == (1, 0)


def test_a_reading_sent_twice_before_a_loss_was_not_damaged() -> None:
    track, last, now_ns = track_of()
    gaps = [track.follow(last, now_ns, twin=True), track.follow(last + 2, now_ns + MS)]
    assert [gap.verdict for gap in gaps] == [CounterStep.REPEATED, CounterStep.LOST]
    assert (track.repeated, track.damaged, track.lost) == (1, 0, 1)


@pytest.mark.parametrize("before", [20_000, 50_000, 64_000])
def test_a_restart_is_no_loss(before: int) -> None:
    track, _, now_ns = track_of(first=before)
    gaps = follow(track, [0, 1, 2, 3], start_ns=now_ns + 300 * MS)
    assert [gap.verdict for gap in gaps] == [
        CounterStep.JUMPED,
        CounterStep.RESTARTED,
        CounterStep.NEXT,
        CounterStep.NEXT,
    ]
    assert (track.restarts, track.lost) == (1, 0)


def test_a_restart_with_another_step_is_no_loss() -> None:
    track, _, now_ns = track_of(first=30_000)  # 1 kHz; after power-up it sends every tenth sample
    gaps = follow(track, [0, 10, 20, *range(30, 200, 10)], start_ns=now_ns + 300 * MS, period_ns=10 * MS)
    assert [gap.verdict for gap in gaps[:2]] == [CounterStep.JUMPED, CounterStep.RESTARTED]
    assert (track.restarts, track.lost, track.step) == (1, 0, 10)


@pytest.mark.parametrize("lost", [1, 300, 40_000, 65_000])
def test_a_long_pause_is_loss_up_to_the_counters_range(lost: int) -> None:
    track, last, now_ns = track_of()
    gap = track.follow((last + 1 + lost) % 65536, now_ns + lost * MS)
    assert (gap.verdict, gap.lost) == (CounterStep.LOST, lost)


def test_a_host_that_stalls_and_reads_late_sees_what_was_lost() -> None:
    track, last, now_ns = track_of()
    late_ns = now_ns + 10_000 * MS  # all of these were waiting in the kernel, and then 9000 more were dropped
    gaps = [track.follow(last + 1 + at, late_ns) for at in range(250)]
    gaps += [track.follow(last + 1 + 250 + 9000 + at, late_ns + at * MS) for at in range(50)]
    assert [gap.lost for gap in gaps] == [0] * 250 + [9000] + [0] * 49
    assert track.restarts == 0


def test_another_rate_is_no_loss_for_long() -> None:
    track, last, now_ns = track_of(step=1)
    gaps = follow(track, [last + 10 * at for at in range(1, 30)], start_ns=now_ns, period_ns=10 * MS)
    assert track.step == 10
    assert sum(gap.lost for gap in gaps) == track.lost == 0
    assert track.follow(last + 310, now_ns).lost == 1


def test_a_counter_that_stands_still_repeats_for_ever() -> None:
    track, last, now_ns = track_of()
    assert {gap.verdict for gap in follow(track, [last] * 40, start_ns=now_ns)} == {CounterStep.REPEATED}
    assert track.step == 1


def test_without_a_known_period_a_counter_that_goes_back_has_restarted() -> None:
    track, _, now_ns = track_of(first=20_000, period_ns=None)
    gaps = follow(track, [0, 1], start_ns=now_ns)
    assert [gap.verdict for gap in gaps] == [CounterStep.JUMPED, CounterStep.RESTARTED]


@pytest.mark.parametrize("ppm", [-300, 300])
def test_hours_of_drift_make_no_restart_and_no_loss(ppm: int) -> None:
    track = CounterTrack(MS)
    period = MS * (1 + ppm * 1e-6)
    step = 500  # every 500th reading of three hours; the others behave alike
    track.follow(0, 0)
    for at in range(1, LEARNED_FROM + 1):
        track.follow(at, round(at * period))
    lost = 0
    for at in range(LEARNED_FROM + step, 3 * 3600 * 1000, step):
        for last in (at - 1, at):
            gap = track.follow(last % 65536, round(last * period))
            assert gap.verdict in (CounterStep.LOST, CounterStep.NEXT)
            lost += gap.lost
    assert track.restarts == 0
    assert lost == track.lost == pytest.approx(3 * 3600 * 1000 * (step - 2) / step, rel=1e-3)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.integers(0, 65535), st.sampled_from([1, 3, 10]), st.integers(0, 10_000))
def test_the_sum_of_all_gaps_is_what_was_lost(first: int, step: int, seed: int) -> None:
    luck = random.Random(seed)
    sent = [first + step * at for at in range(2000)]
    kept = [0, *(at for at in range(1, 1999) if luck.random() > 0.1), 1999]
    track = CounterTrack(step * MS)
    gaps = [track.follow(sent[at] % 65536, at * step * MS) for at in kept]
    assert track.lost == sum(gap.lost for gap in gaps) == len(sent) - len(kept)
    assert track.restarts == track.late == track.repeated == 0


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 65535), max_size=60))
def test_any_counters_are_followed(counters: list[int]) -> None:
    track = CounterTrack(MS)
    assert sum(gap.lost for gap in follow(track, counters)) == track.lost
    assert min(track.late, track.repeated, track.damaged, track.restarts) >= 0
