"""Doubles behind real transports: a pseudo terminal, a CAN bus, a socket.

A wire has one thread, which feeds the double with bytes and time and sends what is due. Cables can be pulled out."""

import contextlib
import dataclasses
import os
import select
import socket
import struct
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self, cast

from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.doubles import Double, PortsDouble
from deformscope_drivers.errors import NotConnected
from deformscope_drivers.pacing import SENDING, be_prompt
from deformscope_drivers.transport import CAN_FRAME_BYTES, CHUNK_BYTES, open_bus

LONGEST_WAIT_S, PORT_TRIES, WAITING_BYTES = 0.1, 50, 1 << 20
LOOPBACK = "127.0.0.1"


class Wire(ABC):
    """`with PtyWire(OptoforceDouble()) as wire: Optoforce(port=wire.port)`.

    port: what a device's configuration names to come to the other end
    lost_bytes: bytes that the double sent without a reader on the wire"""

    port: str
    is_bus = False
    """Whether `port` goes into a configuration's `bus`."""

    def __init__(self, double: Double) -> None:
        self.double = double
        self.lost_bytes = 0
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def __enter__(self) -> Self:
        self.plug()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()
        self._clean()

    def plug(self) -> None:
        """Put the cable in: the double powers up, and its thread starts."""
        self._attach()
        self._stopping.clear()
        self.double.power_up(monotonic_ns())
        self._thread = threading.Thread(target=self._work, name=f"double at {self.port}", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Pull the cable out, even while bytes are being sent. Pulling twice is nothing."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._stopping.set()
        thread.join()
        self._detach()

    @abstractmethod
    def _attach(self) -> None:
        """Create the double's end of the wire, to which a host can connect."""

    @abstractmethod
    def _detach(self) -> None:
        """Remove the double's end of the wire, as an unplugged cable does."""

    @abstractmethod
    def _take(self, wait_s: float) -> bytes:
        """The bytes that the host sent; empty where none came within wait_s [s]."""

    @abstractmethod
    def _give(self, data: bytes) -> int:
        """Send bytes to the host. Returns how many the wire took: fewer than given where its buffer is full."""

    def _clean(self) -> None:  # noqa: B027 (most have nothing left)
        """Remove what outlives a cable that was pulled out."""

    def _work(self) -> None:
        be_prompt(SENDING)
        while not self._stopping.is_set():
            now_ns = monotonic_ns()
            next_ns = self.double.next_ns(now_ns)
            wait_s = LONGEST_WAIT_S if next_ns is None else min(max(next_ns - now_ns, 0) / 1e9, LONGEST_WAIT_S)
            data = self._take(wait_s)
            now_ns = monotonic_ns()
            if data:
                self.double.receive(data, now_ns)
            out = self.double.due(now_ns)
            if out:
                self.lost_bytes += len(out) - self._give(out)


class PtyWire(Wire):
    """A pseudo terminal; `port` stays the same when the cable is pulled out and put back.

    The port is a descriptor of this process under /proc, which other processes of the same user can open. The kernel
    removes it with the process in any case, while a link in a folder would remain. A pseudo-terminal has no baud rate:
    a double that should be slow limits its rate (`doubles.Line`)."""

    def __init__(self, double: Double) -> None:
        super().__init__(double)
        self.port = ""
        self._ours = self._theirs = -1

    def _attach(self) -> None:
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(self._ours, False)
        if self._theirs < 0:  # it stays open here: bytes wait until a host opens it
            self._theirs = theirs
            self.port = f"/proc/{os.getpid()}/fd/{theirs}"
        else:
            os.dup2(theirs, self._theirs, inheritable=False)
            os.close(theirs)

    def _detach(self) -> None:
        with socket.socket(socket.AF_UNIX) as nothing:  # keeps the descriptor's number, and cannot be opened by path
            os.dup2(nothing.fileno(), self._theirs, inheritable=False)
        os.close(self._ours)

    def _clean(self) -> None:
        os.close(self._theirs)
        self._theirs = -1

    def _take(self, wait_s: float) -> bytes:
        ready, _, _ = select.select([self._ours], [], [], wait_s)
        if not ready:
            return b""
        try:
            return os.read(self._ours, CHUNK_BYTES)
        except BlockingIOError:
            return b""

    def _give(self, data: bytes) -> int:
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0  # nobody reads, and the terminal is full: as on a real line, the bytes are gone


class PortsWire(Wire):
    """Ports of a controller on loopback, each for any number of clients; `port` is the URL of the first one.

    Where theirs are not free they have others, with the same distances. Unplugged, it resets its connections."""

    def __init__(self, double: Double) -> None:
        super().__init__(double)
        self.port, self._number = "", 0
        self._ports: Mapping[str, int] = getattr(double, "ports", {"": 0})
        self._servers: dict[socket.socket, str] = {}
        self._clients: dict[socket.socket, tuple[Double, bytearray]] = {}

    def bind(self) -> str:
        """Open its ports, also before it is entered; the URL of the first one."""
        first = next(iter(self._ports.values()))
        numbers = [self._number or first] + [0] * (0 if self._number else PORT_TRIES)
        while not self._servers and numbers:
            number = numbers.pop(0)
            try:
                for name, usual in self._ports.items():
                    server = socket.create_server((LOOPBACK, number + usual - first if number else 0))
                    self._servers[server] = name
                    number = number or server.getsockname()[1]
            except (OSError, OverflowError):
                self._detach()
            self._number, self.port = number, f"socket://{LOOPBACK}:{number}"
        if not self._servers:
            raise NotConnected(f"{len(self._ports)} free ports", "none", "end other doubles", LOOPBACK)
        return self.port

    def _attach(self) -> None:
        self.bind()

    def _detach(self) -> None:
        for client in list(self._clients):
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._close(client)
        while self._servers:
            self._servers.popitem()[0].close()

    def _take(self, wait_s: float) -> bytes:
        """Serve all clients once; then nothing is left to hand over."""
        for end in select.select([*self._servers, *self._clients], [], [], wait_s)[0]:
            if end in self._servers:
                client, _ = end.accept()
                client.setblocking(False)  # a host that connects and never reads must not hold the double up
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients[client] = self._connect(self._servers[end]), bytearray()
            elif end in self._clients:
                data = b""
                with contextlib.suppress(OSError):
                    data = end.recv(CHUNK_BYTES)
                self._clients[end][0].receive(data, monotonic_ns()) if data else self._close(end)
        for client, (connection, waiting) in self._clients.items():
            waiting += connection.due(monotonic_ns())
            with contextlib.suppress(OSError):  # full, or gone, which the next read shows
                del waiting[: client.send(waiting)]
            if len(waiting) > WAITING_BYTES:
                self.lost_bytes += len(waiting)
                waiting.clear()
        return b""

    def _give(self, data: bytes) -> int:
        for _, waiting in self._clients.values():
            waiting += data
        return len(data) if self._clients else 0

    def _close(self, client: socket.socket) -> None:
        self._left(self._clients.pop(client)[0])
        client.close()

    def _connect(self, name: str) -> Double:
        return cast(PortsDouble, self.double).connection(name)

    def _left(self, connection: Double) -> None:
        cast(PortsDouble, self.double).drop(connection)


class TcpWire(PortsWire):
    """A socket on loopback that one host at a time connects to; `port` is pyserial's `socket://` URL."""

    def _connect(self, name: str) -> Double:
        for client in list(self._clients):
            self._close(client)
        return self.double

    def _left(self, connection: Double) -> None:
        """The double stays."""


class DatagramWire(Wire):
    """Datagrams on loopback with one host, the last that sent one; `port` is a `udp://` URL.

    The double's bytes go in datagrams of its `datagram_bytes`."""

    def __init__(self, double: Double) -> None:
        super().__init__(double)
        self._size: int = getattr(double, "datagram_bytes", CHUNK_BYTES)
        self._number = 0
        self.port = ""
        self._socket: socket.socket | None = None
        self._host: tuple[str, int] | None = None

    def _attach(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, self._number))
        self._number = self._socket.getsockname()[1]
        self.port = f"udp://{LOOPBACK}:{self._number}"

    def _detach(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = self._host = None

    def _take(self, wait_s: float) -> bytes:
        assert self._socket is not None
        if not select.select([self._socket], [], [], wait_s)[0]:
            return b""
        try:
            data, self._host = self._socket.recvfrom(CHUNK_BYTES)
        except OSError:  # a datagram has met a port that is closed
            return b""
        return data

    def _give(self, data: bytes) -> int:
        if self._socket is None or self._host is None:
            return 0
        given = 0
        for at in range(0, len(data), self._size):
            try:
                given += self._socket.sendto(data[at : at + self._size], self._host)
            except OSError:
                continue
        return given


class CanWire(Wire):
    """A CAN bus, over which the double's bytes go in frames of up to 8. Ids as the host's `CanTransport` has them.

    bus: as in `CanTransport`; `port` is the same. padded: fill the last frame of a piece up with zeros"""

    is_bus = True

    def __init__(
        self, double: Double, bus: str, *, receive_id: int, send_id: int, bitrate: int = 1_000_000, padded: bool = False
    ) -> None:
        super().__init__(double)
        self.port = bus
        self._ids = receive_id, send_id
        self._bitrate = bitrate
        self._padded = padded
        self._bus: Any = None

    def _attach(self) -> None:
        self._bus = open_bus(self.port, self._ids[1], self._bitrate)

    def _detach(self) -> None:
        self._bus.shutdown()

    def _take(self, wait_s: float) -> bytes:
        message = self._bus.recv(wait_s)
        if message is None or message.arbitration_id != self._ids[1]:
            return b""
        return bytes(message.data)

    def _give(self, data: bytes) -> int:
        import can

        for at in range(0, len(data), CAN_FRAME_BYTES):
            piece = data[at : at + CAN_FRAME_BYTES]
            if self._padded:
                piece = piece.ljust(CAN_FRAME_BYTES, b"\0")
            self._bus.send(can.Message(arbitration_id=self._ids[0], data=piece, is_extended_id=False))
        return len(data)


# Whichever wire a configuration names ---------------------------------------------------------------------------------


def wire_for(double: Double, config: Any, bus: str = "") -> Wire:
    """A wire to a double: by a CAN bus, a socket or datagrams if the configuration names one, else a pseudo terminal.
    bus: replacement of the CAN bus that the configuration names"""
    if hasattr(double, "ports"):
        return PortsWire(double)
    if getattr(config, "bus", ""):
        return CanWire(double, bus, receive_id=config.receive_id, send_id=config.send_id, bitrate=config.bitrate)
    if config.port.startswith("socket:"):
        return TcpWire(double)
    return DatagramWire(double) if config.port.startswith("udp:") else PtyWire(double)


def reaching(config: Any, port: str, *, is_bus: bool = False) -> Any:
    """The configuration with the address of the double at the other end of a wire."""
    links = {"port": port}
    if hasattr(config, "bus"):
        links = {"port": "", "bus": port} if is_bus else {"port": port, "bus": ""}
    return dataclasses.replace(of_any_serial(config), **links)


def of_any_serial(config: Any) -> Any:
    """The configuration, for a device with any serial number: a double has its own."""
    return dataclasses.replace(config, serial=type(config)().serial) if hasattr(config, "serial") else config
