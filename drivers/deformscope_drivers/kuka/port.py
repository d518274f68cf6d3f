"""Datagrams to and from a controller, one at a time."""

import select
import socket

from deformscope_drivers.doubles import Double
from deformscope_drivers.errors import Busy, LinkLost, NotConnected
from deformscope_drivers.kuka.messages import MOST_BYTES
from deformscope_drivers.transport import Transport
from deformscope_drivers.wires import LOOPBACK, DatagramWire


class UdpPort(Transport):
    """The port to which a controller sends its datagrams; answers go to the sender of the last one.

    `read` gives the newest datagram alone: an older one is answered too late in any case"""

    def __init__(self, address: str, port: int, peer: str = "") -> None:
        """peer: the only address that is listened to; empty = the first that speaks"""
        self.name = f"udp {address}:{port}"
        self._address, self._port, self._peer = address, port, peer
        self._socket: socket.socket | None = None
        self._from: tuple[str, int] | None = None
        self.bound = port
        self.skipped = 0

    def open(self) -> None:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.bind((self._address, self._port))
        except OSError as error:
            opened.close()
            kind = Busy if error.errno in (13, 98) else NotConnected
            raise kind("a UDP port that is free", error.strerror or str(error), "another `port`", self.name) from error
        opened.setblocking(False)
        self._socket, self._from, self.bound = opened, None, opened.getsockname()[1]

    def close(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            opened.close()

    def read(self, timeout_s: float) -> bytes:
        opened = self._opened()
        newest = b""
        wait_s = max(timeout_s, 0.0)
        while select.select([opened], [], [], 0.0 if newest else wait_s)[0]:
            try:
                data, sender = opened.recvfrom(MOST_BYTES + 1)
            except OSError as error:  # as when an answer has met a closed port
                if newest:
                    break
                raise LinkLost("datagrams from the controller", error.strerror or str(error), "", self.name) from error
            if sender[0] != (self._peer or (self._from or sender)[0]):
                continue
            self.skipped += bool(newest)
            newest, self._from = data, sender
        return newest

    def write(self, data: bytes) -> None:
        if self._from is None:
            raise LinkLost("a controller that has sent a datagram", "none yet", where=self.name)
        try:
            self._opened().sendto(data, self._from)
        except OSError as error:
            raise LinkLost("a network that takes answers", error.strerror or str(error), "", self.name) from error

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise NotConnected("an open port", "one that is closed", where=self.name)
        return self._socket


def free_port() -> int:
    """An unused port of this host."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tried:
        tried.bind((LOOPBACK, 0))
        return int(tried.getsockname()[1])


class UdpWire(DatagramWire):
    """A double of a controller, which sends to a port of this host."""

    def __init__(self, double: Double, port: int) -> None:
        super().__init__(double)
        self._to = (LOOPBACK, port)

    def _attach(self) -> None:
        super()._attach()
        self._host, self.port = self._to, f"{LOOPBACK}:{self._to[1]}"
