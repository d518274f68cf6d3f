"""Runs a command where nothing but loopback is reachable, and prints each host name that it looked up: for tests.

python -m tests.offline COMMAND...; needs user namespaces of Linux, and exits with 77 where there are none.
"""

import ctypes
import fcntl
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

NEW_USER, NEW_NET, NEW_MOUNTS, MS_BIND = 0x10000000, 0x40000000, 0x00020000, 4096
SIOCSIFFLAGS, IFF_UP = 0x8914, 1
NO_NAMESPACES = 77


def enter() -> socket.socket:
    """Into namespaces of its own; the socket is that of the only name server. Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    user = os.getuid()
    if libc.unshare(NEW_USER | NEW_NET | NEW_MOUNTS):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH14x", b"lo", IFF_UP))
    with tempfile.NamedTemporaryFile("w") as servers:
        servers.write("nameserver 127.0.0.1\n")
        servers.flush()
        if libc.mount(servers.name.encode(), b"/etc/resolv.conf", None, MS_BIND, None):
            raise OSError(ctypes.get_errno(), "mount")
    asked = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    asked.bind(("127.0.0.1", 53))
    return asked


def print_names(asked: socket.socket) -> None:
    while True:
        query, whom = asked.recvfrom(4096)
        at, labels = 12, []
        while query[at]:
            labels.append(query[at + 1 : at + 1 + query[at]].decode())
            at += 1 + query[at]
        print("looked up", ".".join(labels), flush=True)
        asked.sendto(query[:2] + b"\x81\x83" + query[4:], whom)  # no such name


def main() -> int:
    try:
        asked = enter()
    except OSError as error:
        print(error)
        return NO_NAMESPACES
    threading.Thread(target=print_names, args=(asked,), daemon=True).start()
    return subprocess.run(sys.argv[1:], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
