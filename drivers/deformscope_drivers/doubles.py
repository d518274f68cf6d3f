"""Parts of simulated devices: a state machine that receives bytes and time, and a line that sends at its pace.

A double is pure: it opens no port, starts no thread and reads no clock. `deformscope_drivers.wires` puts it behind a
pseudo terminal, a CAN bus or a socket; a simulated laboratory drives it by its own clock."""

import contextlib
import json
import math
import os
import stat
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

FIFO_BYTES = 16
"""Buffer of a serial port's chip before it interrupts its host."""


class Double(Protocol):
    """A byte-exact simulated device, seen from its end of the wire. Times are on one clock that never jumps."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes that the host sent, in pieces of any size."""

    def due(self, now_ns: int) -> bytes:
        """Bytes that have left the device by now and were not handed out before."""

    def next_ns(self, now_ns: int) -> int | None:
        """When `due` next has bytes, without any from the host; None = it only answers bytes from the host."""

    def power_up(self, now_ns: int) -> None:
        """Start as after power-on: settings that are not stored are lost, and nothing is left to send."""


class PortsDouble(Double, Protocol):
    """A double of a controller with several ports. ports: their usual numbers by name"""

    ports: Mapping[str, int]

    def connection(self, name: str) -> Double:
        """What speaks with a new client of a port."""

    def drop(self, connection: Double) -> None:
        """A client has gone."""


class Line:
    """A transmitter that sends whole messages, one after the other, at a line's rate.

    bytes_per_s: 11 520 for 115 200 baud 8N1; None = unlimited (USB and TCP, for 1 kHz of 16 bytes)"""

    def __init__(self, bytes_per_s: float | None = None) -> None:
        self._ns_per_byte = 0.0 if bytes_per_s is None else 1e9 / bytes_per_s
        self._messages: deque[tuple[int, bytes]] = deque()
        self._sent = 0  # bytes of the first message that were handed out
        self.free_ns = 0

    def send(self, message: bytes, now_ns: int) -> None:
        """Send after the bytes that are being sent."""
        start = max(now_ns, self.free_ns)
        self._messages.append((start, message))
        self.free_ns = start + round(len(message) * self._ns_per_byte)

    def due(self, now_ns: int) -> bytes:
        """The bytes that have left by now and were not handed out before."""
        out = bytearray()
        while self._messages:
            start, message = self._messages[0]
            if start > now_ns:
                break
            left = len(message) if not self._ns_per_byte else int((now_ns - start) / self._ns_per_byte)
            out += message[self._sent : left]
            self._sent = max(self._sent, min(left, len(message)))
            if self._sent < len(message):
                break
            self._messages.popleft()
            self._sent = 0
        return bytes(out)

    def next_ns(self) -> int | None:
        """When bytes are due next: the rest of a message, or the content of a full FIFO, whichever comes first. None =
        the line is idle."""
        if not self._messages:
            return None
        start, message = self._messages[0]
        until = min(self._sent + FIFO_BYTES, len(message))
        return start + math.ceil(until * self._ns_per_byte)

    def clear(self) -> None:
        """Forget what was not sent."""
        self._messages.clear()
        self._sent = 0
        self.free_ns = 0


# Registry of running doubles for other processes: each writes its port to a small file while it runs


@dataclass(frozen=True, slots=True)
class RunningDouble:
    """A double that another process runs. driver: name of the package with its driver; port: its end of the wire"""

    driver: str
    port: str
    name: str
    pid: int


def announcements() -> Path:
    """The folder in which running doubles write their ports; it may not exist."""
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"deformscope-doubles-{os.getuid()}"


@contextlib.contextmanager
def announced(driver: str, port: str, name: str) -> Iterator[None]:
    """Announce to other processes that a double runs here, until the end of the context."""
    folder = announcements()
    folder.mkdir(mode=0o700, exist_ok=True)
    if not _is_ours(folder):  # made by another user, who could lead what is written here elsewhere
        yield
        return
    path = folder / f"{os.getpid()}-{name}.json"
    path.write_text(json.dumps({"driver": driver, "port": port, "name": name, "pid": os.getpid()}), encoding="utf-8")
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def running_doubles() -> list[RunningDouble]:
    """The doubles whose processes live; what dead ones left is removed."""
    found = []
    folder = announcements()
    for path in sorted(folder.glob("*.json")) if _is_ours(folder) else []:
        try:
            double = RunningDouble(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            continue
        try:
            os.kill(double.pid, 0)
        except ProcessLookupError:
            path.unlink(missing_ok=True)
            continue
        except PermissionError:  # it lives, and is another user's
            pass
        found.append(double)
    return found


def _is_ours(folder: Path) -> bool:
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
