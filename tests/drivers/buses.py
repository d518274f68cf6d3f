"""CAN buses for tests that other processes may run at the same time."""

import socket


def udp_bus() -> str:
    """A CAN bus over loopback on a port that nobody has: another test process must not hear this one's frames."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        return f"udp_multicast:239.74.163.2?port={taken.getsockname()[1]}"
