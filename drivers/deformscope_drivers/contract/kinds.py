"""What a device of each kind owes its users besides, as tests."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from deformscope_drivers.arm.device import JointVelocity
from deformscope_drivers.arm.kinematics import pose_error
from deformscope_drivers.contract.devices import PATIENCE_S, Bench, Contract
from deformscope_drivers.depth_camera.synthetic import View
from deformscope_drivers.device import Device
from deformscope_drivers.errors import MotionStopped
from deformscope_drivers.framing import Skipped
from deformscope_drivers.interface import VERSION, DeviceDriver, Kind

LOAD = (2.0, -3.0, 8.0, 0.02, -0.03, 0.04)
"""Load of a force sensor in the test, after it was zeroed [N, N m]."""
TIMES_READ = 40
ZEROED_WITHIN = 50
"""Readings after `zero` that may come before it takes effect."""


class KindContract(Contract):
    """Every kind of device passes this."""

    kind: Kind

    def test_its_declaration_is_of_this_interface(self, driver: DeviceDriver) -> None:
        assert driver.kind == self.kind
        assert driver.interface == VERSION
        assert dataclasses.is_dataclass(driver.config)
        config = driver.doubled_config
        assert isinstance(config, driver.config)
        assert driver.lacks(config) == ""
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(config, dataclasses.fields(config)[0].name, None)

    def test_readings_take_another_stamp(self, device: Device[Any]) -> None:
        """As of a device with a calibrated delay."""
        reading = device.next(PATIENCE_S)
        assert dataclasses.replace(reading, stamp=reading.stamp.put_back(1)).stamp != reading.stamp

    def test_its_decoder_takes_any_bytes(self, driver: DeviceDriver, device: Device[Any]) -> None:
        if driver.redecoder is None:
            pytest.skip("it exchanges no bytes")
        raw, random = device.raw(), np.random.default_rng(1)
        device.next(PATIENCE_S)
        sent = b"".join(chunk.data for chunk in raw.take() if not chunk.sent)
        noise = random.integers(0, 256, 20_000, dtype=np.uint8).tobytes()
        damaged = bytes(byte ^ int(random.random() < 0.02) << 3 for byte in sent)
        again = driver.redecoder(device.config, device.describe(), device.name)  # type: ignore[attr-defined]
        decoder = again.begin()
        events = [*decoder.feed(noise), *decoder.feed(damaged), *decoder.finish()]
        for event in events:
            if not isinstance(event, Skipped):
                again.measure(event, 0)
        assert sum(one.count for one in events if isinstance(one, Skipped)) <= len(noise) + len(damaged)


class ForceContract(KindContract):
    """A force sensor of three or six axes."""

    kind = "wrench"

    def scene(self, time_s: float) -> Any:
        return getattr(self, "load", (0.0,) * 6)

    def test_readings_have_the_shape_that_it_describes(self, device: Any) -> None:
        reading, said = device.next(PATIENCE_S), device.describe()
        counts, force_n, torque_nm = np.array(reading.counts), reading.force_n, reading.torque_nm
        assert force_n.shape == (said.channels, 3)
        assert (torque_nm is not None) == said.torques
        assert counts.shape == (said.channels, 6 if said.torques else 3)
        assert counts.dtype.kind == "i"
        assert said.rate_hz == device.config.rate_hz

    def test_zeroed_it_shows_the_load_in_newtons_by_axis_and_sign(self, device: Any) -> None:
        device.zero()
        readings = device.readings()
        for _ in range(ZEROED_WITHIN):
            readings.get(PATIENCE_S)
        self.load = LOAD
        waited = [readings.get(PATIENCE_S) for _ in range(4 * TIMES_READ)][-TIMES_READ:]  # its filter has settled
        np.testing.assert_allclose(np.mean([one.force_n[0] for one in waited], axis=0), LOAD[:3], atol=0.1, rtol=0.02)
        if waited[0].torque_nm is not None:
            torque_nm = np.mean([one.torque_nm[0] for one in waited], axis=0)
            np.testing.assert_allclose(torque_nm, LOAD[3:], atol=5e-3, rtol=0.02)
        assert all(one.usable and not one.overload for one in waited)

    def test_its_bytes_give_the_same_readings(self, driver: DeviceDriver, bench: Bench) -> None:
        if driver.redecoder is None:
            pytest.skip("it exchanges no bytes")
        raw, readings = bench.device.raw(), bench.device.readings()
        with bench.device.open() as device:
            for _ in range(TIMES_READ):
                device.next(PATIENCE_S)
            said, config = device.describe(), device.config  # type: ignore[attr-defined]
        again = driver.redecoder(config, said, device.name)
        decoder, found = again.begin(), []
        for chunk in raw.take():
            if chunk.sent:
                again.send(chunk.data)
            else:
                found += [again.measure(one, chunk.host_ns) for one in decoder.feed(chunk.data) if again.listening]
        found = [one for one in found if one is not None and hasattr(one, "stamp")]
        published = readings.take()
        assert len(found) == len(published) >= TIMES_READ
        for one, other in zip(found, published, strict=True):
            assert one.stamp == other.stamp
            for name in again.compares:
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


class ColorContract(KindContract):
    """A colour camera."""

    kind = "color"

    def scene(self, time_s: float) -> Any:
        picture = np.zeros((48, 64, 3), np.uint8)
        picture[..., 0], picture[..., 2] = 200, round(20 * time_s) % 200
        return picture

    def test_images_are_rgb_of_8_bits(self, device: Device[Any]) -> None:
        image = device.next(PATIENCE_S).image
        assert image.dtype == np.uint8
        assert image.ndim == 3
        assert image.shape[2] == 3


class DepthContract(KindContract):
    """A depth camera."""

    kind = "depth"

    def scene(self, time_s: float) -> Any:
        depth_m = np.full((48, 64), 0.6 + 0.01 * (round(20 * time_s) % 5))
        return View(depth_m, np.full((48, 64, 3), 90, np.uint8))

    def test_images_are_distances_in_its_unit(self, device: Device[Any]) -> None:
        image = device.next(PATIENCE_S)
        assert image.depth.dtype == np.uint16
        assert image.depth.ndim == 2
        assert 1e-5 <= image.unit_m <= 1e-2
        assert image.color is None or (image.color.dtype == np.uint8 and image.color.shape[2] == 3)


class TactileContract(KindContract):
    """Pads of a hand."""

    kind = "tactile"

    def test_pads_have_the_layout_that_it_describes(self, device: Any) -> None:
        reading, said = device.next(PATIENCE_S), device.describe()
        shapes = [(pad.rows, pad.columns) for pad in said.pads]
        assert [pad.shape for pad in reading.pads] == shapes
        assert [pad.index for pad in said.pads] == list(range(len(shapes)))
        pressures_pa = device.pressure_pa(reading)
        assert [pressure_pa.shape for pressure_pa in pressures_pa] == shapes
        assert all((one >= 0).all() and (one <= said.full_scale_pa).all() for one in pressures_pa)


class HandContract(KindContract):
    """A hand."""

    kind = "hand"

    def test_a_reading_has_each_axis(self, device: Any) -> None:
        reading = device.next(PATIENCE_S)
        assert len(reading.position_deg) == len(reading.velocity_deg_s) == len(reading.state)
        assert np.isfinite([reading.position_deg, reading.velocity_deg_s]).all()
        assert all(one.name for one in reading.state)


class ArmContract(KindContract):
    """An arm; whether and how it moves is for tests on a simulated clock."""

    kind = "arm"

    def test_a_state_says_where_its_end_is(self, device: Any) -> None:
        state = device.next(PATIENCE_S)
        assert state.T_base_end_effector.shape == (4, 4)
        if not device.by_hand:
            chain = device.chain
            assert len(state.joints_deg) == len(state.rates_deg_s) == chain.joint_count
            error = pose_error(chain.end_effector(state.joints_deg), state.T_base_end_effector)
            assert np.abs(error).max() < 1e-3

    def test_its_model_has_a_chain(self, driver: DeviceDriver, device: Any) -> None:
        assert device.by_hand or device.chain.name in driver.chains()

    def test_halt_refuses_until_it_is_acknowledged(self, device: Any) -> None:
        device.halt("enough")
        assert device.stopped_because == "enough"
        if not device.by_hand:
            with pytest.raises(MotionStopped, match="enough"):
                device.set_velocity(JointVelocity((0.0,) * device.chain.joint_count), 0.1)
        device.acknowledge_stop()
        assert not device.stopped_because


CONTRACTS: dict[Kind, type[KindContract]] = {
    contract.kind: contract
    for contract in (ForceContract, ColorContract, DepthContract, TactileContract, HandContract, ArmContract)
}
"""The contract of each kind."""
