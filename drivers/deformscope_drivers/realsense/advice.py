"""Meanings of librealsense's errors, and remedies: its exceptions are all RuntimeError, and differ by their text."""

from __future__ import annotations

from deformscope_drivers.errors import Busy, DeviceError, NotConnected

INSTALL = "pip install deformscope[realsense]"
UDEV = (
    "librealsense's udev rules (config/99-realsense-libusb.rules into /etc/udev/rules.d), then reconnect it; "
    "in a container pass /dev through as a whole"
)
NO_PICTURES = "a USB 3 port of the computer itself and the camera's own cable; reconnect it"
_BUSY = ("busy", "errno=16", "failed to set power state")
_DENIED = ("status_access", "permission denied", "operation not permitted", "errno=13", "errno=1,")


def meaning(error: Exception, expected: str, where: str) -> DeviceError:
    """The error of a device's that an error of the library's is.

    librealsense words them by the failure below it: `xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or
    resource busy` and `failed to set power state` for a camera that another program uses (issues 1828, 12382, 6555).
    Without udev rules it is `RS2_USB_STATUS_ACCESS` (issue 4951; realsense-ros 1408)."""
    words = " ".join(str(error).split())
    lower = words.lower()
    if any(sign in lower for sign in _BUSY):
        what = "close other programs that read it: realsense-viewer, a ROS node, an earlier run"
        return Busy(f"{expected} that no other program reads", words, what, where)
    if any(sign in lower for sign in _DENIED):
        return NotConnected(f"{expected} that this user may open", words, UDEV, where)
    return NotConnected(expected, words or type(error).__name__, "reconnect it", where)
