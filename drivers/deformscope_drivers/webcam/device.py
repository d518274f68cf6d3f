"""A webcam: opened by its stable name, set as configured, every setting read back and a mismatch refused."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from deformscope_drivers.clock import Clock, ClockFit, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Device, Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.images import QUEUE_IMAGES, ColorImage, fingerprint
from deformscope_drivers.ports import FoundDevice, stable_name, sysfs_text, usb_device
from deformscope_drivers.webcam.capture import Capture, Setting, open_v4l2

EXPOSURE_UNIT_S = 1e-4
MANUAL_EXPOSURE = 1
FPS_TOLERANCE = 0.01
GAP_PERIODS = 1.5
NO_IMAGE = "undecodable"
WRONG_SIZE = "size"


@dataclass(frozen=True, slots=True)
class WebcamConfig:
    """How a webcam is opened and set.

    port: a path (best one under /dev/v4l/by-id, which is stable when cameras are renumbered), or a number: 0 is
    /dev/video0; width, height [px]; fps [Hz]; fourcc: the format on the wire, such as MJPG or YUYV
    exposure_s, gain, white_balance_k, focus: None = the camera's own (most choose automatically); gain and focus are in
    the driver's own units; autofocus: False switches it off where the camera has it, for a picture whose scale stays
    silence_s: time without an image after which the camera counts as lost; stuck_after_s: the same image for this long
    means a frozen one, None = it may"""

    port: str | int = 0
    width: int = 640
    height: int = 480
    fps: float = 30.0
    fourcc: str = "MJPG"
    exposure_s: float | None = None
    gain: float | None = None
    white_balance_k: float | None = None
    focus: float | None = None
    autofocus: bool = False
    silence_s: float = 3.0
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        if not self.path.startswith("/"):  # an address or a pipeline, which OpenCV might open
            raise NotConnected("a camera's number or path", repr(self.port), "ls /dev/v4l/by-id")
        if not (self.width > 0 and self.height > 0 and self.fps > 0):
            came = f"{self.width} x {self.height} at {self.fps:g} Hz"
            raise SettingsRefused("width, height and fps above 0", came, where=self.path)

    @property
    def path(self) -> str:
        """The port as a path."""
        text = str(self.port)
        return f"/dev/video{text}" if text.isdecimal() else text


class Webcam(Device[ColorImage]):
    """`with Webcam(WebcamConfig(port="/dev/v4l/by-id/...")) as camera: camera.next(1.0).image`

    open() raises SettingsRefused when the camera runs otherwise than configured. `health().extra["gaps"]` counts pauses
    between images longer than one and a half periods, by the camera's timestamps if it gives them. They are lost
    images, or longer exposures in the dark (OpenCV gives no frame counter). Never tried on a camera."""

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self,
        config: WebcamConfig,
        *,
        open_capture: Callable[[str], Capture] = open_v4l2,
        links: Path = Path("/dev/v4l/by-id"),
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        super().__init__(config.path, reconnect=reconnect, stuck_after_s=config.stuck_after_s, clock=clock)
        self.config = config
        self._open_capture = open_capture
        self._links = links
        self._path = config.path
        self._capture: Capture | None = None
        self._heard_ns = 0
        self._gaps = 0
        self._before_ns: int | None = None

    def _connect(self) -> None:
        # Plugged in again, a camera may come back under another number; its stable name stays.
        self._path = stable_name(self._path, self._links)
        self._capture = self._open_capture(self._path)
        apply(self.config, self._capture, self._path)
        self._heard_ns = self._clock()
        self._before_ns = None
        self._clock_fit = ClockFit(1000.0)
        self._expect(self.config.fps)

    def _receive(self, timeout_s: float) -> Iterable[ColorImage]:
        if self._capture is None:
            raise NotConnected("an open camera", "one that is closed", where=self.name)
        if not self._capture.wait(timeout_s):
            silence_s = (self._clock() - self._heard_ns) / 1e9
            if silence_s > self.config.silence_s:
                raise LinkLost("an image", f"none for {silence_s:.3g} s", "check the camera", self._path)
            return []
        # Before decoding, which takes milliseconds that are not the camera's.
        self._heard_ns = host_ns = self._clock()
        stamp = Stamp(host_ns, self._capture.timestamp_us())
        picture = self._capture.retrieve()
        if picture is None:
            self._count_refused(NO_IMAGE)
            return []
        if picture.shape != (self.config.height, self.config.width, 3):
            self._count_refused(WRONG_SIZE)
            return []
        self._watch(stamp)
        return [ColorImage(stamp, picture)]

    def _disconnect(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.close()

    def _fingerprint(self, reading: ColorImage) -> Hashable:
        return fingerprint(reading.image)

    def _extra_health(self) -> dict[str, float]:
        return {"gaps": float(self._gaps)}

    def _watch(self, stamp: Stamp) -> None:
        now_ns = stamp.host_ns if stamp.device_ticks is None else stamp.device_ticks * 1000
        if self._before_ns is not None and now_ns - self._before_ns > GAP_PERIODS * 1e9 / self.config.fps:
            self._gaps += 1
        self._before_ns = now_ns
        if stamp.device_ticks is not None and self._clock_fit is not None:
            self._clock_fit.add(stamp.device_ticks, stamp.host_ns)


def apply(config: WebcamConfig, capture: Capture, where: str) -> None:
    """Set a camera as configured and read every setting back. Raises SettingsRefused.

    The order matters: the format bounds the sizes that there are, and the size bounds the rates."""
    if len(config.fourcc) != 4 or not config.fourcc.isascii():
        raise SettingsRefused("a format of four letters, such as MJPG or YUYV", repr(config.fourcc))
    asked: list[tuple[Setting, float]] = [
        (Setting.FOURCC, float(int.from_bytes(config.fourcc.encode("ascii"), "little"))),  # as V4L2 numbers it
        (Setting.WIDTH, float(config.width)),
        (Setting.HEIGHT, float(config.height)),
        (Setting.FPS, config.fps),
        (Setting.AUTOFOCUS, float(config.autofocus)),
    ]
    if config.exposure_s is not None:
        asked.append((Setting.AUTO_EXPOSURE, MANUAL_EXPOSURE))
        asked.append((Setting.EXPOSURE, float(round(config.exposure_s / EXPOSURE_UNIT_S))))
    if config.gain is not None:
        asked.append((Setting.GAIN, config.gain))
    if config.white_balance_k is not None:
        asked.append((Setting.AUTO_WHITE_BALANCE, 0.0))
        asked.append((Setting.WHITE_BALANCE, config.white_balance_k))
    if config.focus is not None:
        asked.append((Setting.FOCUS, config.focus))
    for setting, value in asked:
        capture.set(setting, value)
    wrong = []
    for setting, value in asked:
        came = capture.get(setting)
        if setting is Setting.AUTOFOCUS and not value and came is None:
            continue  # a camera without autofocus has it off
        tolerance = FPS_TOLERANCE * value if setting is Setting.FPS else 0.5
        if came is None or not abs(came - value) <= tolerance:
            wrong.append((setting, value, came))
    if wrong:
        expected = ", ".join(_to_text(setting, value) for setting, value, _ in wrong)
        seen = ", ".join(_to_text(setting, came) for setting, _, came in wrong)
        raise SettingsRefused(expected, seen, f"v4l2-ctl -d {where} --list-formats-ext --list-ctrls", where)


def _to_text(setting: Setting, value: float | None) -> str:
    name = setting.name.lower().replace("_", " ")
    if value is None:
        return f"no {name}"
    if setting is Setting.FOURCC:
        return f"{name} {int(value).to_bytes(4, 'little').decode('latin-1')!r}"
    return f"{name} {value:g}"


def discover(sysfs: Path = Path("/sys"), dev: Path = Path("/dev")) -> list[FoundDevice]:
    """Every V4L2 camera, by its stable name where there is one.

    A camera's further nodes (metadata, which give no images) are left out. sysfs, dev: where those folders are"""
    nodes = sysfs / "class" / "video4linux"
    found = []
    for node in sorted(nodes.glob("video*"), key=lambda path: (len(path.name), path.name)) if nodes.is_dir() else []:
        if sysfs_text(node / "index") not in ("", "0"):
            continue
        device = dev / node.name
        port = stable_name(str(device), dev / "v4l" / "by-id")
        name = sysfs_text(node / "name")
        usb, interface = None, node / "device"
        if interface.exists():  # it names an interface, a folder below the USB device's
            folder = interface.resolve()
            usb = usb_device(folder) or usb_device(folder.parent)
        notes = [] if port == str(device) else [str(device)]
        if usb is not None:
            notes.append(f"usb {usb.vendor:04x}:{usb.product:04x}")
        serial, revision = (usb.serial, usb.revision) if usb is not None else ("", "")
        found.append(FoundDevice("webcam", port, name, serial, revision, ", ".join(notes)))
    return found
