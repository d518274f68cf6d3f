"""A hosted process: what crosses between it and the program, and that it ends with the program and within its limit."""

import os
import signal
import time
from collections.abc import Iterator

import pytest

from deformscope_drivers.errors import CommandRefused, DeviceError, LinkLost
from deformscope_drivers.hosted import Channel, HostedProcess, ProcessEnded, ask_hosted
from tests.patience import PATIENCE_S


def echo(channel: Channel, first: str) -> None:
    channel.send("opened", first)
    while True:
        channel.send(*channel.receive())


def refuse(channel: Channel) -> None:
    raise CommandRefused(7, "no", "opening")


def lose(channel: Channel) -> None:
    raise LinkLost("a camera", "none (unplugged?)")


def refuse_by_a_class_of_its_own(channel: Channel) -> None:
    raise type("OfVendor", (LinkLost,), {})("an arm that answers", "silence", "look at its cable")


def hang(channel: Channel) -> None:
    channel.send("opened", os.getpid())
    time.sleep(10 * PATIENCE_S)


def crash(channel: Channel) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def process() -> Iterator[HostedProcess]:
    process = HostedProcess("a process", "test", None)
    yield process
    process.end(0.0)


def test_settings_and_messages_cross_both_ways(process: HostedProcess) -> None:
    process.start(echo, "settings", quiet=True)
    assert process.opened(PATIENCE_S) == "settings"
    process.send("command", 1.5)
    assert process.receive(PATIENCE_S) == ("command", 1.5)
    assert process.receive(0.0) is None


def test_an_error_crosses_with_its_class_and_its_code(process: HostedProcess) -> None:
    process.start(refuse)
    with pytest.raises(CommandRefused, match=r"error 7 \(no\)") as caught:
        process.opened(PATIENCE_S)
    assert caught.value.code == 7


def test_an_error_that_has_no_name_elsewhere_crosses_in_words(process: HostedProcess) -> None:
    process.start(refuse_by_a_class_of_its_own)
    with pytest.raises(DeviceError, match=r"an arm that answers; got silence \| try: look at its cable"):
        process.opened(PATIENCE_S)


def test_a_link_that_is_lost_while_opening_is_not_taken_for_the_end_of_the_process(process: HostedProcess) -> None:
    process.start(lose)
    with pytest.raises(LinkLost, match="unplugged") as caught:
        process.opened(PATIENCE_S)
    assert not isinstance(caught.value, ProcessEnded)


def test_signals_to_the_programs_group_do_not_end_it(process: HostedProcess) -> None:
    process.start(echo, "", quiet=True)
    process.opened(PATIENCE_S)
    assert process.process_id is not None
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process.process_id, number)
    process.send("still there")
    assert process.receive(PATIENCE_S) == ("still there",)


def test_a_process_that_hangs_is_killed_after_its_limit(process: HostedProcess) -> None:
    process.start(hang)
    number = process.opened(PATIENCE_S)
    process.end(0.1)
    assert process.process_id is None
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_a_process_that_crashes_has_ended(process: HostedProcess) -> None:
    process.start(crash)
    with pytest.raises(ProcessEnded, match="expected a process; got one that has ended"):
        process.opened(PATIENCE_S)
    assert process.exit_status(PATIENCE_S) == -signal.SIGKILL
    process.end(PATIENCE_S)
    with pytest.raises(ProcessEnded, match="got none"):
        process.send("anyone")


def test_asking_gives_nothing_where_the_process_crashes() -> None:
    assert ask_hosted(crash, timeout_s=PATIENCE_S) is None
