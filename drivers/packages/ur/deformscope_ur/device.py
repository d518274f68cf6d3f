"""An arm of Universal Robots: states by RTDE, velocities by registers that our own script follows (`control.script`).

Opening uploads the script, which moves nothing until a heartbeat and a velocity of zero have come. Each report is
answered with the present joint rates and the next heartbeat. Without heartbeats the script stops the arm after
SILENCE_S, whatever became of this process. The arm is stopped, until `acknowledge_stop`, when its controller reports a
stop for safety, a program that does not run, a speed slider below 100 % (which slows every velocity), or joints that
turn faster than was asked."""

import itertools
import math
import random
import re
import urllib.parse
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.device import Arm, ArmState, by_joints
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import ROUND_S
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.framing import Skipped
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.transport import SerialTransport, Transport
from deformscope_ur import rtde
from deformscope_ur.config import DASHBOARD, PORTS, RTDE, SCRIPT, UrConfig
from deformscope_ur.dashboard import Dashboard
from deformscope_ur.rtde import Decoder, Kind, Package, Recipe, Runtime, Value

_NAMES = (
    "timestamp actual_q actual_qd actual_current actual_TCP_pose actual_TCP_force robot_mode safety_status_bits "
    "runtime_state target_speed_fraction output_int_register_42 output_int_register_43 output_int_register_44"
)
OUTPUTS = tuple(_NAMES.split())
HELD, SESSION, BEAT = OUTPUTS[-3:]
INPUTS = ("input_int_register_42", "input_int_register_43", *(f"input_double_register_{42 + one}" for one in range(6)))
SCRIPT_FILE = Path(__file__).parent / "control.script"
SILENCE_S = 0.1
SCRIPT_VALUES = {"acceleration_rad_s2": 40.0, "silence_s": SILENCE_S, "watchdog_hz": 1.0}
"""The script's acceleration to a velocity, as in the vendor's driver for ROS (20 deg/s in 9 ms); time without a
heartbeat after which it stops the arm; frequency below which the controller ends it."""
FOLLOWS, SILENT, TOO_FAST = 1, 2, 3
"""What it reports in output_int_register_42."""
LOST_S, STARTS_S, RESTS_S, ANSWER_S = 0.5, 3.0, 0.3, 2.0
"""Silence of the controller after which it is lost; time for the script to follow, a stop to be read, a reply."""
POSE_MM, POSE_DEG, SEEN_MM = 10.0, 2.0, 1.0
"""Greatest difference between the controller's and the model's flange: calibrated arms differ by some millimetres. From
SEEN_MM on it is a remark."""
FULL = 0.999
"""A speed slider at 100 %."""
RATE_TIMES, RATE_DEG_S, RATE_S = 1.5, 3.0, 0.3
"""Joints turn too fast beyond so many times the greatest rate of the last RATE_S, and RATE_DEG_S more. Chosen."""
Ways = Callable[[str], Transport]


def open_ur(config: UrConfig) -> Arm[Any]:
    """The device, not yet opened: in a separate process unless the configuration disables that."""
    return HostedArm(Ur, config) if config.own_process else Ur(config)


def control_script(config: UrConfig, session: int) -> str:
    """The text that is uploaded, for a configuration and a session."""
    limit_rad_s = math.radians(config.joint_limit_deg_s) * 1.001
    values = {"session": session, "limit_rad_s": f"{limit_rad_s:.6f}", **SCRIPT_VALUES}
    return re.sub(r"{{(\w+)}}", lambda name: str(values[name[1]]), SCRIPT_FILE.read_text("utf-8"))


def state_of(values: Mapping[str, Any], chain: kinematics.Chain, host_ns: int) -> ArmState:
    """The state in a report that came at a time [ns]. values: its variables"""
    joints_deg = _degrees_of(values["actual_q"])
    pose = chain.end_effector(joints_deg)
    x, y, z = pose[:3, 3].tolist()
    theta_x, theta_y, theta_z = kinematics.euler_xyz_from_rotation(pose[:3, :3]).tolist()
    return ArmState(
        stamp=Stamp(host_ns, round(1e6 * values["timestamp"])),
        joints_deg=joints_deg,
        rates_deg_s=_degrees_of(values["actual_qd"]),
        position_m=(x, y, z),
        theta_rad=(theta_x, theta_y, theta_z),
        wrench=values["actual_TCP_force"],
        currents=values["actual_current"],
    )


def _degrees_of(angles_rad: Iterable[float]) -> tuple[float, ...]:
    return tuple(map(math.degrees, angles_rad))


class Ur(Arm[ArmState]):
    """`with Ur(UrConfig(port="socket://192.168.1.7:30004")) as arm:`; it must be switched on and in remote control."""

    stop_by_hand = "the emergency stop, or the speed slider"

    def __init__(self, config: UrConfig | None = None, ways: Ways | None = None, clock: Clock = monotonic_ns) -> None:
        """ways: makes transports to a double in place of the network on a simulated clock; clock: the host's, or a
        simulated laboratory's"""
        self.config = config if config is not None else UrConfig()
        super().__init__(self.config.port, clock=clock)
        self._ways = ways if ways is not None else self._way
        self._transport: Transport | None = None
        self._chain: kinematics.Chain = self.config.chain
        self._decoder = Decoder()
        self._outputs: Recipe | None = None
        self._inputs: Recipe | None = None
        self._values: Mapping[str, Any] = {}
        self._identity = Identity(self.config.model)
        self._beat = self._session = self._heard_ns = self._expired = self._silences = 0
        self._resting = self._follows = False
        self._sent_deg_s: deque[tuple[int, float]] = deque()
        self._off_mm = 0.0

    @property
    def chain(self) -> kinematics.Chain:
        return self._chain

    def identity(self) -> Identity:
        return self._identity

    def remarks(self) -> tuple[str, ...]:
        words = "copy delta_theta, delta_a, delta_d and delta_alpha from its calibration.conf into the rig file"
        return (f"the controller has the flange {self._off_mm:.1f} mm off: {words}",) if self._off_mm > SEEN_MM else ()

    def stop(self) -> None:
        self._forget()
        self._do(self._rest, 2 * LOST_S)

    def halt(self, reason: str) -> None:
        self._forget(reason or "by command")
        self._do(self._rest, 2 * LOST_S)

    def acknowledge_stop(self) -> None:
        """See `Arm.acknowledge_stop`; unlocks a protective stop, and starts the script again where it has ended. Raises
        SettingsRefused as opening does, and CommandRefused where it is too early: it is stopped then."""
        if self._trouble():
            self._do(self._make_ready, STARTS_S + 4 * ANSWER_S)
        super().acknowledge_stop()

    def _forget(self, stopped_because: str = "") -> None:
        with self._commanded:
            self._streamed = None
            self._stopped = self._stopped or stopped_because

    def _refused(self, expected: str, came: str, try_this: str) -> SettingsRefused:
        return SettingsRefused(expected, came, try_this, self.name)

    # From here on run by the device's own thread

    def _connect(self) -> None:
        self._transport = self._ways(RTDE)
        try:
            self._transport.open()
        except errors.NotConnected as error:
            came = str(error).split(" | ")[0].partition("; got ")[2]
            advice = "`port` with the address of PolyScope's Settings, Network; is it switched on?"
            raise errors.NotConnected("a controller that can be reached", came, advice, self.name) from error
        self._decoder, self._values, self._follows = Decoder(), {}, False
        self._session, self._heard_ns = 0, self._clock()
        self._sent_deg_s.clear()
        version = Package(Kind.VERSION, rtde.PROTOCOL.to_bytes(2, "big"))
        self._outputs = self._inputs = None
        if not self._ask(version, lambda reply: reply.accepted):
            raise self._refused("RTDE of version 2", "none", "PolyScope 3.9 or 5.3 and later")
        self._outputs = self._recipe(rtde.output_request(self.config.state_hz, OUTPUTS), OUTPUTS)
        self._inputs = self._recipe(rtde.input_request(INPUTS), INPUTS)
        self._write(Package(Kind.START))
        if not self._until(lambda: bool(self._values), ANSWER_S):
            raise errors.NoReply(f"reports within {ANSWER_S:g} s", "none", "its log on the pendant", self.name)
        self._make_ready()
        self._not_stopped = None
        self._expect(self.config.state_hz)

    def _make_ready(self) -> None:
        """Have the controller run the script, after a look at its state. Raises SettingsRefused, CommandRefused."""
        with Dashboard(self._ways(DASHBOARD), self._clock) as dashboard:
            serial, firmware = dashboard.ask("get serial number"), dashboard.ask("PolyscopeVersion")
            self._identity = Identity(self.config.model, serial, firmware)
            if self._values["safety_status_bits"] & rtde.PROTECTIVE and self._link is Link.CONNECTED:
                answer, advice = dashboard.ask("unlock protective stop"), "look for its cause; again after 5 s"
                if not answer.startswith("Protective stop releasing"):
                    raise errors.CommandRefused(0, answer, "unlock protective stop", advice, self.name)
                self._until(lambda: not self._values["safety_status_bits"] & rtde.PROTECTIVE, STARTS_S)
            self._check()
            if dashboard.ask("is in remote control") == "false":
                advice = "choose remote control at the top right of PolyScope"
                raise self._refused("a controller in remote control", "local control", advice)
            if self._values["runtime_state"] == Runtime.PAUSED and self._follows:
                dashboard.ask("stop")
        self._session = random.SystemRandom().randrange(1, 1 << 31)  # a script of an earlier session ends by it
        rounds = itertools.count()  # in some of which the controller takes the session: the script would end without it
        if not self._until(lambda: self._values["runtime_state"] == Runtime.STOPPED and next(rounds) > 3, RESTS_S):
            came = f"one that is {self._runtime()}"
            raise self._refused("a controller without another program", came, "stop it on the pendant")
        script = self._ways(SCRIPT)
        script.open()
        try:
            script.write(control_script(self.config, self._session).encode())
            if not self._until(self._script_follows, STARTS_S):
                came, advice = f"a program that is {self._runtime()}", "the log of PolyScope; is it in remote control?"
                raise self._refused("a controller that runs our script", came, advice)
        finally:
            script.close()
        self._follows = True

    def _check(self) -> None:
        """That the controller is ready to move, and the arm of this model."""
        from scipy.spatial.transform import Rotation

        if words := self._unready():
            raise self._refused("an arm that is ready to move", *words)
        place_m, turn_rad = np.array(self._values["actual_TCP_pose"]).reshape(2, 3)
        theirs = kinematics.transform(Rotation.from_rotvec(turn_rad).as_matrix(), place_m)
        error = kinematics.pose_error(self._chain.end_effector(self._degrees("actual_q")), theirs)
        self._off_mm, off_deg = 1e3 * math.hypot(*error[:3]), math.degrees(math.hypot(*error[3:]))
        if self.config.check_pose and not (self._off_mm <= POSE_MM and off_deg <= POSE_DEG):
            raise self._refused(
                f"the flange within {POSE_MM:g} mm and {POSE_DEG:g} deg of the pose of a {self._chain.name}",
                f"one that the controller reports {self._off_mm:.1f} mm and {off_deg:.1f} deg away",
                "another `model`; a TCP of zero in PolyScope's installation: the tool belongs into the rig file",
            )

    def _unready(self) -> tuple[str, str] | None:
        """Why the controller would not move as it is asked to, and what to do; None where it would."""
        bits, mode = self._values["safety_status_bits"], self._values["robot_mode"]
        if stops := [words for bit, words in rtde.SAFETY.items() if bits >> bit & 1]:
            return stops[0], "look for its cause, then unlock it on the pendant"
        if mode != rtde.RUNNING:
            return f"mode {rtde.ROBOT_MODES.get(mode, mode)}", "switch it on and release its brakes on the pendant"
        if (slider := self._values["target_speed_fraction"]) < FULL:
            return f"a speed slider at {100 * slider:.0f} %, which scales velocities", "set it to 100 %"
        return None

    def _trouble(self) -> str:
        """Why the arm does not do what it is asked to, by its last report; empty where it does."""
        if words := self._unready():
            return ": ".join(words)
        runs = self._values["runtime_state"] == Runtime.PLAYING and self._values[SESSION] == self._session
        return "" if runs else f"its program is {self._runtime()}"

    def _runtime(self) -> str:
        return rtde.RUNTIMES.get(self._values["runtime_state"], "in another state")

    def _script_follows(self) -> bool:
        return self._values[HELD] == FOLLOWS and not self._trouble()

    def _disconnect(self) -> None:
        with self._commanded:
            moving, self._streamed = self._streamed is not None, None
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the link to the arm was lost while it moved"
        try:
            if self._follows:
                self._rest()
                self._session = 0
                self._send()  # the script ends
        except errors.DeviceError as error:
            self._not_stopped = error if moving else self._not_stopped
        finally:
            transport, self._transport, self._follows = self._transport, None, False
            if transport is not None:
                transport.close()

    def _wake(self) -> None:
        if self._transport is not None:
            self._transport.wake()

    def _receive(self, timeout_s: float) -> Iterable[ArmState]:
        states = [state_of(self._values, self._chain, host_ns) for host_ns in self._reports(timeout_s)]
        if self._clock() - self._heard_ns > LOST_S * 1e9:
            raise errors.LinkLost("reports of the controller", f"none for {LOST_S:g} s", "its network", self.name)
        return states

    def _reports(self, timeout_s: float) -> Iterable[int]:
        """The times [ns] of reports. The newest is answered: after a stall, older ones are no longer true."""
        newest_ns = None
        for package, host_ns in self._listen(timeout_s):
            values = self._outputs.unpack(package) if self._outputs is not None else None
            if values is None:
                if package.kind is not Kind.START:
                    self._count_refused(package.text[:60] or f"{package.kind.name.lower()} package")
                continue
            before, self._values, self._heard_ns = self._values, values, host_ns
            if before:
                periods = round((self._values["timestamp"] - before["timestamp"]) * self.config.state_hz)
                if 1 < periods < 10_000:
                    self._count_lost(periods - 1)
            newest_ns = host_ns
            yield host_ns
        if newest_ns is not None:
            self._watch(newest_ns)
            self._send()

    def _listen(self, timeout_s: float) -> list[tuple[Package, int]]:
        assert self._transport is not None
        found: list[tuple[Package, int]] = []
        while data := self._transport.read(0.0 if found else timeout_s):
            host_ns = self._clock()
            self._record_raw(data, host_ns)
            for event in self._decoder.feed(data):
                if isinstance(event, Skipped):
                    self._count_skipped(event)
                else:
                    self._tally.in_sync()
                    found.append((event, host_ns))
        return found

    def _ask(self, request: Package, accept: Callable[[Package], Any]) -> Any:
        """What `accept` makes of the reply to a request. Raises NoReply."""
        self._write(request)
        until_ns = self._clock() + round(ANSWER_S * 1e9)
        while (left_s := (until_ns - self._clock()) / 1e9) > 0 and not self._closing.is_set():
            for package, _ in self._listen(min(left_s, ROUND_S)):
                if package.kind is request.kind and (found := accept(package)) is not None:
                    return found
        advice = "is it the address of a controller? RTDE may be off (PolyScope: Settings, Security, Services)"
        raise errors.NoReply(f"a reply of RTDE within {ANSWER_S:g} s", "none", advice, self.name)

    def _recipe(self, request: Package, names: tuple[str, ...]) -> Recipe:
        recipe: Recipe = self._ask(request, lambda reply: Recipe.of_reply(reply, names))
        if recipe.refused or not recipe.number:
            came = ", ".join(f"{name} {why}" for name, why in recipe.refused.items()) or "a refusal"
            advice = "end the other client (a fieldbus, another program); PolyScope 3.9 or 5.3 and later"
            raise self._refused("registers 42 to 47 for this driver alone", came[:100], advice)
        return recipe

    def _until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Serve the controller until a condition holds; whether it did in time."""
        until_ns = self._clock() + round(seconds * 1e9)
        while not condition():
            if self._clock() >= until_ns:
                return False
            list(self._reports(ROUND_S))
        return True

    def _rest(self) -> None:
        """Send zeros until the script has read them, or the arm rests without it. Raises NotStopped, LinkLost."""

        def rests() -> bool:
            if self._script_follows():
                return bool(self._values[BEAT] >= beat)
            return not any(self._values["actual_qd"])

        self._resting = True
        try:
            self._send()
            beat = self._beat
            if not self._until(rests, RESTS_S):
                expected = f"a velocity of zero that is read within {RESTS_S:g} s"
                raise errors.NotStopped(expected, "none", self.stop_by_hand, self.name)
        finally:
            self._resting = False

    def _watch(self, now_ns: int) -> None:
        """Stop for what the last report says."""
        if not self._follows:
            return
        fastest_deg_s = max(map(abs, self._degrees("actual_qd")))
        while self._sent_deg_s and now_ns - self._sent_deg_s[0][0] > RATE_S * 1e9:
            self._sent_deg_s.popleft()
        asked_deg_s = max((rate for _, rate in self._sent_deg_s), default=0.0)
        if trouble := self._trouble():
            self._forget(trouble)
        elif self._values[HELD] == SILENT and asked_deg_s:
            self._silences += 1
            self._forget(f"its controller had no heartbeat for {SILENCE_S:g} s")
        elif self._values[HELD] == TOO_FAST:
            self._forget("its script refused a velocity beyond the limit")
        elif fastest_deg_s > RATE_TIMES * asked_deg_s + RATE_DEG_S:
            rates = f"a joint turned at {fastest_deg_s:.1f} deg/s, and at most {asked_deg_s:.1f} was asked"
            self._forget(f"{rates}: end other programs that move it; else its controller scales velocities: repair it")

    def _send(self) -> None:
        """The present velocity, and the next heartbeat."""
        rates_deg_s = self._present_deg_s()
        self._sent_deg_s.append((self._clock(), max(map(abs, rates_deg_s))))
        self._beat = self._beat % ((1 << 31) - 1) + 1
        if self._inputs is not None:
            values: tuple[Value, ...] = (self._beat, self._session, *np.radians(rates_deg_s).tolist())
            self._write(self._inputs.pack(dict(zip(INPUTS, values, strict=True))))

    def _present_deg_s(self) -> tuple[float, ...]:
        """(6,) joint rates to send [deg/s]: zero without a valid velocity, and until the script follows."""
        with self._commanded:
            streamed = self._streamed
            if streamed is not None and self._clock() > streamed.expires_ns:
                self._streamed = streamed = None
                self._expired += 1
        if streamed is None or self._resting or self._values[HELD] != FOLLOWS:
            return (0.0,) * self._chain.joint_count
        joints_deg = self._degrees("actual_q")
        rates = by_joints(streamed.velocity, self._chain, self.config, joints_deg)
        if not isinstance(rates, str):
            ahead_deg = np.asarray(joints_deg) + np.asarray(rates.rates_deg_s) * 2.0 / self.config.state_hz
            if self._chain.within_limits(ahead_deg):
                return rates.rates_deg_s
            rates = f"a joint reached the end of its range: {np.round(joints_deg, 1).tolist()} deg"
        self._forget(rates)
        return (0.0,) * self._chain.joint_count

    def _write(self, package: Package) -> None:
        assert self._transport is not None
        data = package.encode()
        self._transport.write(data)
        self._record_raw(data, self._clock(), sent=True)

    def _degrees(self, name: str) -> tuple[float, ...]:
        return _degrees_of(self._values[name])

    def _extra_health(self) -> dict[str, float]:
        return {"commands_expired": self._expired, "heartbeats_missed": self._silences}

    def _way(self, kind: str) -> Transport:
        address = urllib.parse.urlsplit(self.config.port)
        number = (address.port or PORTS[RTDE]) + PORTS[kind] - PORTS[RTDE]
        return SerialTransport(f"socket://{address.hostname}:{number}", 9600)
