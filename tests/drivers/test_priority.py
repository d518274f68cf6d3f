"""Threads that a robot waits for run before ordinary ones, where the system lets them, and what they begin does not."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from deformscope_drivers.pacing import READING, SENDING, STEERING, be_prompt, may_be_prompt
from deformscope_drivers.transport import SerialTransport
from deformscope_drivers.wires import PtyWire
from tests.drivers.toy import Toy, ToyDouble

REAL_TIME = pytest.mark.skipif(not may_be_prompt(), reason="this user may not have real-time threads")


def in_a_thread(action: Callable[[], Any]) -> Any:
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(action).result()


def priority_of(thread_id: int) -> int:
    """0 = an ordinary thread."""
    return os.sched_getparam(thread_id).sched_priority


@REAL_TIME
def test_a_prompt_thread_is_real_time_and_what_it_begins_is_not() -> None:
    def look() -> tuple[bool, int, int, str]:
        made = be_prompt(READING)
        print_policy = [sys.executable, "-S", "-c", "import os; print(os.sched_getscheduler(0))"]
        of_a_process = subprocess.run(print_policy, capture_output=True, text=True, check=True).stdout
        return made, priority_of(0), in_a_thread(lambda: priority_of(0)), of_a_process

    assert in_a_thread(look) == (True, READING, 0, f"{os.SCHED_OTHER}\n")
    assert priority_of(0) == 0


def test_who_hears_devices_comes_before_who_steers_and_doubles_before_both() -> None:
    assert 1 <= STEERING < READING < SENDING < 50


def test_where_it_is_not_allowed_a_thread_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused, raising=False)
    assert not in_a_thread(lambda: be_prompt(READING))
    assert not may_be_prompt()


def test_where_there_is_no_such_call_a_thread_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setscheduler", raising=False)
    assert not may_be_prompt()


@REAL_TIME
def test_a_device_that_a_robot_waits_for_and_its_double_are_prompt() -> None:
    with PtyWire(ToyDouble()) as wire, Toy(SerialTransport(wire.port, 115_200)) as device:
        device.next(5.0)
        found = {one.name: priority_of(one.native_id) for one in threading.enumerate() if one.native_id is not None}
    assert found[f"device {wire.port}"] == READING
    assert found[f"double at {wire.port}"] == SENDING
    assert found["MainThread"] == 0
