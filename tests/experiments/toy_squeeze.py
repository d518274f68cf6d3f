"""A hand on a simulated clock that squeezes a box: the real drivers on byte-exact doubles, and the simplest contact.
Pressures grow with the angle beyond contact, until an obstacle holds the fingers."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from deformscope.rig.sections import ContainerSection, HandSection, SqueezeSection
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.setup import CameraView
from deformscope.robot.squeeze_plan import CLOSING_AXES, GripShape, draw_grasp
from deformscope.robot.squeeze_setup import SqueezeNames, SqueezeSetup
from deformscope.runs.opened_devices import SqueezeOpening
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer
from deformscope_drivers.depth_camera import SyntheticDepthCamera, View
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.dsa import Dsa, DsaConfig
from deformscope_drivers.dsa.double import DsaDouble
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.memory import MemoryTransport, SimulatedClock
from deformscope_drivers.sdh import Sdh, SdhConfig
from deformscope_drivers.sdh.double import Port, SdhDouble

POLL_NS = 2_000_000
PAD_SHAPES = [(14, 6), (13, 6)] * 3
T_CAMERA_HAND = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.1], [1.0, 0.0, 0.0, 0.6], [0.0, 0.0, 0.0, 1.0]])
"""The camera looks along the hand's x axis at the pad of finger 2."""


@dataclass(frozen=True)
class ToyTruth:
    """As `robot.squeeze_setup.TrueMoments`; 0 = not yet."""

    contact_ns: int
    steady_ns: int


class ToySqueeze:
    """The devices, a box between the fingers, and what can go wrong.

    gives_deg: how far the fingers go into it; stiffness_pa_deg: pressure of a texel for each degree beyond contact"""

    def __init__(
        self,
        *,
        gives_deg: float = 3.0,
        stiffness_pa_deg: float = 150.0,
        camera: bool = False,
        bytes_per_s: float | None = None,
    ) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        self.squeeze = SqueezeSection(hold_s=0.2)
        self.container = ContainerSection()
        self.shape = GripShape.of(self.container, self.squeeze)
        self.contact_deg = self.shape.contact_deg[1] - 1.0
        self.gives_deg, self.stiffness_pa_deg = gives_deg, stiffness_pa_deg
        self.hand_double = SdhDouble(Port.CAN)
        self.hand_double.place((60.0, -30.0, 10.0, -60.0, 0.0, -30.0, 10.0))
        self.obstruct()
        self.hand_wire = MemoryTransport(self.hand_double, self.clock, "simulated hand")
        self.dsa_double = DsaDouble(scene=self._pressures, noise_counts=2.0, bytes_per_s=bytes_per_s)
        self.dsa_wire = MemoryTransport(self.dsa_double, self.clock, "simulated pads")
        self.hand = Sdh(SdhConfig(bus="virtual:none", rate_hz=50.0), transport=self.hand_wire, clock=self.clock)
        self.tactile = Dsa(DsaConfig(port="none"), transport=self.dsa_wire, clock=self.clock)
        self.devices: dict[str, tuple[str, Device[object]]] = {
            "hand": ("sdh", self.hand),  # type: ignore[dict-item]
            "pads": ("dsa", self.tactile),  # type: ignore[dict-item]
        }
        self.grasp = draw_grasp(self.container, self.squeeze, 1)
        self.focal_px, self.center_px = (280.0, 280.0), (159.5, 119.5)
        if camera:
            renderer = ModelRenderer(
                ContainerModel.box(self.container.size_m), Intrinsics(self.focal_px, self.center_px)
            )
            pixels = np.stack(np.meshgrid(np.arange(320), np.arange(240)), axis=-1).astype(float)
            depth = renderer.render(T_CAMERA_HAND @ self.grasp.T_hand_container, pixels).depth_m
            view = View(np.where(np.isfinite(depth), depth, 1.2))
            config = SyntheticDepthConfig(rate_hz=15.0, missing=0.01)
            self.devices["camera"] = (
                "depth_camera",
                SyntheticDepthCamera(lambda time_s: view, config, clock=self.clock),  # type: ignore[dict-item]
            )
        self.camera = camera
        self.truth = ToyTruth(0, 0)
        self.at: list[tuple[int, Callable[[], None]]] = []

    def obstruct(self) -> None:
        """The box holds both fingers where it gives no more."""
        for axis in CLOSING_AXES:
            self.hand_double.obstruct(axis, high_deg=self.contact_deg + self.gives_deg)

    @property
    def setup(self) -> SqueezeSetup:
        return SqueezeSetup(
            names=SqueezeNames("hand", "pads", "camera" if self.camera else ""),
            hand=HandSection(),
            container=self.container,
            squeeze=self.squeeze,
            camera=CameraView(self.focal_px, self.center_px, rate_hz=15.0),
            open_source=self.source,
            grasp=self.grasp,
            T_camera_hand=T_CAMERA_HAND,
            placed=True,
            simulated=True,
            runs_itself=False,
            truth=lambda: self.truth,
            clock=self.clock,
            wait_until=self.wait_until,
        )

    def source(self) -> RigSource:
        members = [RigMember(name, DRIVERS[driver], device, True) for name, (driver, device) in self.devices.items()]
        return RigSource(members, clock=self.clock, opener=self.open)

    def open(self) -> None:
        for _, device in self.devices.values():
            device.open(own_thread=False)

    def wait_until(self, until_ns: int) -> None:
        """Let time pass: every device is polled at its moments."""
        while (now_ns := self.clock()) < until_ns:
            then_ns = min((now_ns // POLL_NS + 1) * POLL_NS, until_ns)
            if self.at and self.at[0][0] <= then_ns:
                self.clock.advance_to(self.at[0][0])
                self.at.pop(0)[1]()
                continue
            self.clock.advance_to(then_ns)
            self._look()
            for _, device in self.devices.values():
                if device.is_open:
                    try:
                        device.poll(0.0)
                    except DeviceError:
                        continue

    def angle(self) -> float:
        """Of the closing axes, the mean [deg]."""
        angles = self.hand_double.position_deg(self.clock())
        return float(np.mean([angles[axis] for axis in CLOSING_AXES]))

    def _look(self) -> None:
        """When what really happens does."""
        angle, now_ns = self.angle(), self.clock()
        if not self.truth.contact_ns and angle > self.contact_deg:
            self.truth = ToyTruth(now_ns, 0)
        elif self.truth.contact_ns and not self.truth.steady_ns and angle >= self.contact_deg + self.gives_deg - 1e-9:
            self.truth = ToyTruth(self.truth.contact_ns, now_ns)

    def _pressures(self, time_s: float) -> list[npt.NDArray[np.float64]]:
        angles = [axis.position_deg for axis in self.hand_double.motion.axes]
        pads = [np.zeros(shape) for shape in PAD_SHAPES]
        for axis, pad in zip(CLOSING_AXES, (1, 5), strict=True):
            pads[pad][3:7, 1:4] = max(angles[axis] - self.contact_deg, 0.0) * self.stiffness_pa_deg
        return pads


def spoil_arrays(pads: DsaDouble, fault: str, fingers: Sequence[int] = (0, 2)) -> None:
    """From now on the fingertip arrays of some fingers are `dead` (all read 0), or `frozen` (they repeat their next
    frame)."""
    exact, sizes = pads.texels, [matrix.cells for matrix in pads.matrices]
    frozen: list[npt.NDArray[np.uint16]] = []

    def texels(time_s: float) -> npt.NDArray[np.uint16]:
        counts = exact(time_s)
        frozen.append(counts.copy())
        for finger in fingers:
            first = sum(sizes[: 2 * finger + 1])
            own = slice(first, first + sizes[2 * finger + 1])
            counts[own] = 0 if fault == "dead" else frozen[0][own]
        return counts

    pads.texels = texels  # type: ignore[method-assign]


def closing(lab: ToySqueeze) -> bool:
    """Whether the fingers move."""
    return any(abs(lab.hand_double.motion.axes[axis].velocity_deg_s) > 0.0 for axis in CLOSING_AXES)


def limits(lab: ToySqueeze) -> tuple[float, ...]:
    """The limits of the motor currents as the hand has them, (7,) [A]."""
    return tuple(axis.move_current_a for axis in lab.hand_double.motion.axes)


def use_toy_squeeze(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is squeezed is a toy; its content is a stiffness. Returns what of the setup is changed."""
    changes: dict[str, Any] = {}

    def opening(
        name: str, content: str, container: str, session: str, seed: int, *, trusted: bool, place: str
    ) -> SqueezeOpening:
        stiffness = (400.0 if content == "rice" else 100.0) + 17.0 * seed
        lab = ToySqueeze(stiffness_pa_deg=stiffness, gives_deg=2.0 + 0.1 * (seed % 7))
        setup = dataclasses.replace(lab.setup, grasp=draw_grasp(lab.container, lab.squeeze, seed), **changes)
        return SqueezeOpening(setup, {"lab": "toy"}, content or "rice", container or "box-01")

    monkeypatch.setattr("deformscope.runs.squeeze_run.squeeze_setup_of", opening)
    return changes
