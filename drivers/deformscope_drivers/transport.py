"""Transports to a device: serial ports, sockets and CAN buses.

A transport carries bytes. A transport decodes nothing; it reports immediately when the link is lost. Rig files, which
may come from anywhere, name ports and buses. pyserial and python-can have more kinds than are accepted here, some of
which write files (`spy://`) or load classes (`alt://`)."""

import contextlib
import errno
import os
import re
import select
import socket
import threading
import urllib.parse
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

from deformscope_drivers.errors import Busy, DeviceError, LibraryMissing, LinkLost, NotConnected

CHUNK_BYTES = 4096
WRITE_TIMEOUT_S = 1.0
CAN_FRAME_BYTES = 8
UDP_BUFFER_BYTES = 1 << 20
"""What the kernel holds while the host is busy: some seconds at 7 kHz. Linux gives less where its limit is lower."""
CAN_DRAIN_FRAMES = 512

PORTS = "a device's path, socket://HOST:PORT, rfc2217://HOST:PORT or udp://HOST:PORT"
_NETWORK_PORT = re.compile(r"(socket|rfc2217|udp)://([\w.-]+|\[[0-9a-fA-F:.]+\]):\d{1,5}")

_NAME = re.compile(r"[\w.-]+")
_BUS_CHANNELS = {
    "socketcan": _NAME,
    "virtual": _NAME,
    "udp_multicast": re.compile(r"[0-9a-fA-F.:]+"),
    "pcan": _NAME,
    "kvaser": re.compile(r"\d+"),
    "slcan": re.compile(r"/dev/[\w./-]+(@\d+)?"),
}
"""Interfaces of python-can, and what each may be given as a channel."""
_BUS_OPTIONS = frozenset({"fd", "hop_limit", "port", "tty_baudrate"})

T = TypeVar("T")


class Transport(ABC):
    """Bytes to and from one device. One thread at a time uses it; only `wake` may be called from others.

    name: the port or bus, for messages"""

    name: str

    @abstractmethod
    def open(self) -> None:
        """Open it and discard waiting bytes; raises NotConnected (Busy if another program has it)."""

    @abstractmethod
    def close(self) -> None:
        """Close it, whatever state it is in; never raises."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes:
        """Received bytes, immediately if there are any; empty after the time, or when woken. Raises LinkLost."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all bytes; raises LinkLost."""

    def wake(self) -> None:  # noqa: B027 (most cannot)
        """End a `read` that waits, where the transport can."""

    def drain(self, first_s: float, quiet_s: float, limit_bytes: int = 1 << 20) -> bytes:
        """Read bytes: wait `first_s` for the first one, then until none came for `quiet_s`, or that many bytes came."""
        found = self.read(first_s)
        while found and len(found) < limit_bytes and (more := self.read(quiet_s)):
            found += more
        return found


def check_port(port: str) -> None:
    """Raises NotConnected for a text that is neither a path nor an address of a documented kind; opens nothing."""
    if "://" in port and not _NETWORK_PORT.fullmatch(port):
        raise NotConnected(PORTS, "another kind of port", 'port = "/dev/ttyACM0"', port)


class SerialTransport(Transport):
    """A serial port, or one behind the network: `/dev/ttyACM0`, `socket://host:port`, `rfc2217://host:port`.

    port: a port that `check_port` accepts; baudrate: 8N1, no flow control (USB and sockets ignore it)"""

    def __init__(self, port: str, baudrate: int) -> None:
        self.name = port
        self._baudrate = baudrate
        self._serial: Any = None
        self._descriptor = -1
        self._wake_read = self._wake_write = -1
        self._wake_lock = threading.Lock()  # a descriptor that was closed may be another's the next moment

    def open(self) -> None:
        import termios

        import serial

        check_port(self.name)
        try:
            self._serial = serial.serial_for_url(
                self.name, baudrate=self._baudrate, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError, termios.error) as error:
            raise _not_opened(error, self.name) from error
        try:
            self._descriptor = self._serial.fileno()
        except (OSError, AttributeError, NotImplementedError):
            self._descriptor = -1  # a URL whose bytes come from a thread of its own
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        with contextlib.suppress(serial.SerialException, OSError, termios.error):  # termios.error is no OSError
            self._serial.reset_input_buffer()

    def close(self) -> None:
        opened, self._serial = self._serial, None
        if opened is not None:
            held = getattr(opened, "_socket", None)  # which pyserial forgets to close when its other end is gone
            with contextlib.suppress(Exception):  # of a port that is gone, everything may fail
                opened.close()
            if held is not None:
                held.close()
        with self._wake_lock:
            ends, self._wake_read, self._wake_write = (self._wake_read, self._wake_write), -1, -1
            for end in ends:
                if end >= 0:
                    os.close(end)

    def read(self, timeout_s: float) -> bytes:
        if self._serial is None:
            raise NotConnected("an open port", "one that is closed", where=self.name)
        if self._descriptor < 0:
            return self._guard(self._read_without_descriptor, timeout_s)
        return self._guard(self._read_descriptor, timeout_s)

    def write(self, data: bytes) -> None:
        if self._serial is None:
            raise NotConnected("an open port", "one that is closed", where=self.name)
        self._guard(self._serial.write, data)

    def wake(self) -> None:
        with self._wake_lock, contextlib.suppress(BlockingIOError):
            if self._wake_write >= 0:
                os.write(self._wake_write, b".")

    def _read_descriptor(self, timeout_s: float) -> bytes:
        """The quickest read: one system call to wait and one to read."""
        ready, _, _ = select.select([self._descriptor, self._wake_read], [], [], max(timeout_s, 0.0))
        if self._wake_read in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake_read, CHUNK_BYTES)
        if self._descriptor not in ready:
            return b""
        try:
            data = os.read(self._descriptor, CHUNK_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise LinkLost("bytes from the device", "the end of the port (unplugged?)", where=self.name)
        return data

    def _read_without_descriptor(self, timeout_s: float) -> bytes:
        if self._serial.timeout != timeout_s:
            self._serial.timeout = timeout_s
        first: bytes = self._serial.read(1)
        waiting = min(self._serial.in_waiting, CHUNK_BYTES) if first else 0
        return first + (self._serial.read(waiting) if waiting else b"")

    def _guard(self, action: Callable[..., T], *arguments: object) -> T:
        import serial

        try:
            return action(*arguments)
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLost("a port that works", _format_error(error), "check the cable", self.name) from error


class UdpTransport(Transport):
    """Datagrams to and from one address, `udp://host:port`; a `read` gives one datagram.

    Datagrams that get lost are not noticed here: the device's own counter shows them."""

    def __init__(self, port: str) -> None:
        check_port(port)
        self.name = port
        address = urllib.parse.urlsplit(port)
        self._to = (address.hostname or "", address.port or 0)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        try:
            family, kind, protocol, _, to = socket.getaddrinfo(*self._to, type=socket.SOCK_DGRAM)[0]
            opened = socket.socket(family, kind, protocol)
        except OSError as error:
            raise NotConnected(
                "the address of a host", _format_error(error), 'port = "udp://HOST:PORT"', self.name
            ) from error
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, UDP_BUFFER_BYTES)
        opened.setblocking(False)
        try:
            opened.connect(to)  # from now on only its datagrams are received
        except OSError as error:
            opened.close()
            raise NotConnected(
                "a host that can be reached", _format_error(error), "check cable and address", self.name
            ) from error
        self._socket = opened

    def close(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            opened.close()

    def read(self, timeout_s: float) -> bytes:
        opened = self._require()
        if not select.select([opened], [], [], max(timeout_s, 0.0))[0]:
            return b""
        try:
            return opened.recv(CHUNK_BYTES)
        except BlockingIOError:  # its checksum was wrong
            return b""
        except OSError as error:  # refused: nothing listens at the device's port
            raise LinkLost(
                "datagrams from the device", _format_error(error), "check power, cable and address", self.name
            ) from error

    def write(self, data: bytes) -> None:
        try:
            self._require().send(data)
        except OSError as error:
            raise LinkLost(
                "a network that takes datagrams", _format_error(error), "check cable and address", self.name
            ) from error

    def _require(self) -> socket.socket:
        if self._socket is None:
            raise NotConnected("an open port", "one that is closed", where=self.name)
        return self._socket


class CanTransport(Transport):
    """A byte stream over a CAN bus: the device's frames of one id, one after the other; ours in pieces of 8 bytes.

    bus: `interface:channel`, both as python-can calls them (`socketcan:can0`, `virtual:lab`), and options behind a
    question mark (`udp_multicast:239.74.163.2?port=43113`, which stays within this host); as `parse_bus` accepts it
    receive_id, send_id: the device's and the host's 11-bit identifiers; bitrate: bits a second"""

    def __init__(self, bus: str, receive_id: int, send_id: int, bitrate: int) -> None:
        self.name = bus
        self._receive_id, self._send_id = receive_id, send_id
        self._bitrate = bitrate
        self._bus: Any = None

    def open(self) -> None:
        self._bus = open_bus(self.name, self._receive_id, self._bitrate)

    def close(self) -> None:
        opened, self._bus = self._bus, None
        if opened is not None:
            with contextlib.suppress(Exception):
                opened.shutdown()

    def read(self, timeout_s: float) -> bytes:
        if self._bus is None:
            raise NotConnected("an open bus", "one that is closed", where=self.name)
        found = bytearray()
        for taken in range(CAN_DRAIN_FRAMES):
            message = self._guard(self._bus.recv, 0.0 if taken else max(timeout_s, 0.0))
            if message is None:
                break
            if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
                continue
            if message.arbitration_id == self._receive_id:
                found += message.data
        return bytes(found)

    def write(self, data: bytes) -> None:
        import can

        if self._bus is None:
            raise NotConnected("an open bus", "one that is closed", where=self.name)
        for at in range(0, len(data), CAN_FRAME_BYTES):
            message = can.Message(
                arbitration_id=self._send_id, data=data[at : at + CAN_FRAME_BYTES], is_extended_id=False
            )
            self._guard(self._bus.send, message, WRITE_TIMEOUT_S)

    def _guard(self, action: Callable[..., T], *arguments: object) -> T:
        import can

        try:
            return action(*arguments)
        except (can.CanError, OSError, ValueError) as error:
            advice = "check cable, termination and bit rate"
            raise LinkLost("a bus that works", _format_error(error), advice, self.name) from error


def parse_bus(bus: str) -> tuple[str, str, dict[str, Any]]:
    """Interface, channel and options of `interface:channel?option=value&...`; opens nothing.

    Raises NotConnected if a part is missing or not accepted."""
    interface, colon, rest = bus.partition(":")
    channel, _, query = rest.partition("?")
    if not colon or not interface or not channel:
        raise NotConnected("a bus as interface:channel", repr(bus), "socketcan:can0")
    if interface not in _BUS_CHANNELS:
        raise NotConnected(f"a bus of {', '.join(_BUS_CHANNELS)}", interface, "socketcan:can0", bus)
    if not _BUS_CHANNELS[interface].fullmatch(channel):
        raise NotConnected(f"a channel of {interface}", repr(channel), "socketcan:can0", bus)
    options = urllib.parse.parse_qsl(query, keep_blank_values=True)
    if unknown := [key for key, _ in options if key not in _BUS_OPTIONS]:
        raise NotConnected(f"options of {', '.join(sorted(_BUS_OPTIONS))}", ", ".join(unknown), where=bus)
    return interface, channel, {key: _number(value) for key, value in options}


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def open_bus(bus: str, receive_id: int, bitrate: int) -> Any:
    """A python-can bus that gives the frames of one id. bus: as in `CanTransport`; raises NotConnected."""
    import can

    interface, channel, options = parse_bus(bus)
    chosen: dict[str, Any] = {"bitrate": bitrate, **options}
    if interface == "udp_multicast":
        chosen = {"hop_limit": 0, "fd": False, **options}  # hop limit 0: never beyond this host
    filters = [{"can_id": receive_id, "can_mask": 0x7FF, "extended": False}]
    try:
        return can.Bus(interface=interface, channel=channel, can_filters=filters, **chosen)
    except ImportError as error:
        raise LibraryMissing(f"what python-can needs for {interface}", _format_error(error), where=bus) from error
    except (can.CanError, OSError, ValueError, TypeError, NotImplementedError) as error:
        advice = f"ip link show {channel}; sudo ip link set {channel} up type can bitrate {bitrate}"
        linux = interface == "socketcan"
        raise NotConnected("a CAN bus", _format_error(error), advice if linux else "", bus) from error


def check_way(port: str, bus: str) -> None:
    """Raises NotConnected for a port or a bus of a kind that is not accepted, where they are named; opens nothing."""
    check_port(port)
    if bus:
        parse_bus(bus)


def serial_or_can(
    port: str, bus: str, *, baudrate: int, receive_id: int = 0, send_id: int = 0, bitrate: int = 1_000_000
) -> Transport:
    """The transport that a configuration names: exactly one of `port` (serial, socket, datagrams) and `bus`."""
    if bool(port) == bool(bus):
        came = "both" if port else "neither"
        raise NotConnected("a port or a bus", came, 'port = "/dev/ttyACM0" or bus = "socketcan:can0"')
    if bus:
        return CanTransport(bus, receive_id, send_id, bitrate)
    return UdpTransport(port) if port.startswith("udp:") else SerialTransport(port, baudrate)


def _not_opened(error: Exception, port: str) -> DeviceError:
    """Why a port did not open, and what to do."""
    number = getattr(error, "errno", None)
    text = _format_error(error)
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "exclusively lock" in text:
        return Busy("a free port", "one that another program has open", f"fuser {port}", port)
    if number == errno.EACCES:
        return NotConnected("a port that may be opened", "permission denied", "sudo usermod -aG dialout $USER", port)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "No such file" in text:
        return NotConnected("a port that is there", "none", "check the cable; deformscope devices", port)
    return NotConnected("a port that can be opened", text, "check power and address; deformscope devices", port)


def _format_error(error: BaseException) -> str:
    """An error's message on one line."""
    words = " ".join(str(error).split()) or type(error).__name__
    return words[:200]
