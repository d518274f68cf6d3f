"""A driver in a separate process: how it is started, what is exchanged, and how it ends.

`HostedProcess` is the end of the program that uses the device. The program starts `python -m deformscope_drivers.hosted
FD` and gives it one end of a socket pair. The first message is a function of the driver's package with its settings.
The function runs there with a `Channel`, the other end, as its first argument. Messages are pickled tuples that begin
with their kind: `("opened", report)` when the device is open, and `("failed", error)` for a DeviceError that ends the
process. Drivers and their devices may add others.

When the program ends, for any reason, the socket closes: the function detects that in `Channel.poll` and
`Channel.receive`, and ends. When the process ends, hangs or crashes, the program gets `ProcessEnded`, or kills it after
a time limit. Nothing here imports numpy: the process starts quickly.
"""

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe
from typing import Any

from deformscope_drivers.errors import DeviceError, LinkLost

ROUND_S = 0.05
ASK_END_S = 2.0


class ProcessEnded(LinkLost):
    """The hosted process has ended, or its end of the socket is closed."""


class HostedProcess:
    """The program's end of a process that hosts a driver. Messages may be sent from any thread.

    expected, where: words of the error that reports that the process has ended; status_s: time to wait for its
    exit status then [s], None = not at all, for urgent calls"""

    def __init__(self, expected: str, where: str, status_s: float | None) -> None:
        self._expected, self._where, self._status_s = expected, where, status_s
        self._sending = threading.Lock()
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def process_id(self) -> int | None:
        """Identifier of the process that was started; None where none runs."""
        return None if self._process is None else self._process.pid

    def start(self, serve: Callable[..., None], *settings: object, quiet: bool = False) -> None:
        """Start the process and have it run `serve(channel, *settings)`. quiet: its error output is dropped too"""
        ours, theirs = Pipe()
        with theirs:
            self._connection = ours
            self._process = subprocess.Popen(
                # -P: without modules of the working folder
                [sys.executable, "-S", "-P", "-m", "deformscope_drivers.hosted", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL if quiet else None,
                env=hosted_environment(),
            )
        self.send(serve, *settings)

    def opened(self, timeout_s: float, closing: threading.Event | None = None) -> Any:
        """The process's report on the opened device; None without a report in time, or if `closing` is set meanwhile.
        Raises the error with which opening failed there, and ProcessEnded."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until and not (closing is not None and closing.is_set()):
            match self.receive(ROUND_S):
                case ("opened", report):
                    return report
                case ("failed", error):
                    raise error
        return None

    def send(self, *message: object) -> None:
        """Send a message: its kind, then its values. Raises ProcessEnded."""
        try:
            with self._sending:
                self._running().send(message)
        except OSError as error:
            raise self._ended() from error

    def receive(self, timeout_s: float) -> tuple[Any, ...] | None:
        """The next message; None when none comes in time. Raises ProcessEnded."""
        connection = self._running()
        try:
            return connection.recv() if connection.poll(timeout_s) else None
        except (EOFError, OSError) as error:
            raise self._ended() from error

    def exit_status(self, timeout_s: float) -> int | None:
        """Exit status of a process whose end of the socket is closed; None if it has not ended in time."""
        if self._process is None:
            return None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        return self._process.returncode

    def end(self, timeout_s: float) -> None:
        """Close the socket, which ends the process; kill it where it has not ended after `timeout_s`."""
        connection, self._connection = self._connection, None
        process, self._process = self._process, None
        if connection is not None:
            connection.close()
        if process is not None:
            try:
                process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _running(self) -> Connection:
        if self._connection is None:
            raise ProcessEnded(self._expected, "none", where=self._where)
        return self._connection

    def _ended(self) -> ProcessEnded:
        status_s = self._status_s
        came = "one that has ended" if status_s is None else f"its end (exit status {self.exit_status(status_s)})"
        return ProcessEnded(self._expected, came, where=self._where)


class Channel:
    """The process's end of the socket to the program that uses the device. Messages may be sent from any thread."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._sending = connection, threading.Lock()

    def send(self, *message: object) -> None:
        """A message to a program that has ended is dropped: `poll` and `receive` notice that. An error of a class that
        is unknown there arrives with its text, as a DeviceError: it must not end the process that moves an arm."""
        with self._sending, contextlib.suppress(OSError):
            try:
                self._connection.send(message)
            except OSError:
                raise
            except Exception:  # of several classes, where something cannot be sent
                parts = (DeviceError.from_text(str(one)) if isinstance(one, Exception) else one for one in message)
                self._connection.send(tuple(parts))

    def receive(self) -> tuple[Any, ...]:
        """Wait for the next message. Raises EOFError or OSError when the program has ended."""
        message: tuple[Any, ...] = self._connection.recv()
        return message

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Whether a message, or the program's end, waits."""
        return self._connection.poll(timeout_s)


def hosted_environment() -> dict[str, str]:
    """The process finds packages where this one does, and nowhere else (-S)."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def ask_hosted(ask: Callable[..., None], *settings: object, timeout_s: float) -> Any:
    """Report of `ask(channel, *settings)`, in a process that is ended after it; None if the process crashes or does not
    answer in time. Raises the DeviceError that `ask` raises."""
    process = HostedProcess("an answer", ask.__module__, None)
    try:
        process.start(ask, *settings, quiet=True)
        return process.opened(timeout_s)
    except (ProcessEnded, OSError):
        return None
    finally:
        process.end(ASK_END_S)


def exit_without_cleanup() -> None:
    """For a process that loads a vendor's library: at exit the interpreter ends before what the library registers."""
    atexit.register(os._exit, 0)


def main(descriptor: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the program that uses the device decides; its end closes the socket
    channel = Channel(Connection(descriptor))
    try:
        serve, *settings = channel.receive()
    except (EOFError, OSError):  # the program has ended already
        return
    try:
        serve(channel, *settings)
    except DeviceError as error:
        channel.send("failed", error)


if __name__ == "__main__":
    main(int(sys.argv[1]))
