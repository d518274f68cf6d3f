"""A controller of CB3 or e-Series with its arm, simulated: RTDE, dashboard and scripts, in its own cycles.

It moves as the uploaded program says, as `script.Program` reads it, and not otherwise. Registers take effect in a later
cycle; the speed slider scales every velocity; a protective stop or a pause brakes the arm whatever the program says. It
has neither port nor thread: each connection is a `doubles.Double`. Currents and forces are assumed, of the order
of such arms."""

import math
import struct
from collections import deque
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm.kinematics import Chain, FloatArray, jacobian_of, least_singular, rotation_vector
from deformscope_drivers.doubles import Double
from deformscope_drivers.kuka.double import motor_currents
from deformscope_ur import rtde
from deformscope_ur.config import DASHBOARD, PORTS, RTDE, UrConfig
from deformscope_ur.dashboard import GREETING, UNKNOWN
from deformscope_ur.rtde import Decoder, Kind, Package, Recipe, Runtime, Value
from deformscope_ur.script import Program, ScriptError, Step

REGISTERS = range(48)
REGISTER_LAG_S, STARTS_S, UNLOCK_S = 0.002, 0.02, 5.0
"""From the arrival of a package until its registers are read; from a script's arrival until it runs; from a protective
stop until it can be unlocked."""
STOP_RAD_S2 = 40.0
"""Deceleration of a protective stop, a pause, and the end of a program."""
NOISE, BIAS_N, FRICTION_N = np.array([0.4] * 3 + [0.02] * 3), 1.0, 0.5
BRISTLE_RAD, RIPPLE_N, RIPPLES, DRIFT_N, STEP = 5e-4, 0.1, 36.0, 0.03, np.array([0.05] * 3 + [0.002] * 3)
CB3_TIMES, SINGULAR = 4.0, 0.03
"""Errors of the estimated force: deviation [N, Nm], by pose, by the direction of the motion, which stays at rest until
a joint has turned the other way (Dahl 1968); a ripple with so many waves a turn, a drift in a second's root, steps. A
CB3 has no sensor, but currents: errors so many times greater, and no force below a singular value."""


def _variables(way: str) -> dict[str, str]:
    found = {f"{way}_int_register_{number}": "INT32" for number in REGISTERS}
    found |= {f"{way}_double_register_{number}": "DOUBLE" for number in REGISTERS}
    for line in (Path(__file__).parent / "variables.txt").read_text("utf-8").splitlines():
        first, kind, *names = line.split()
        found |= dict.fromkeys(names, kind) if first == way else {}
    return found


INPUTS, OUTPUTS = _variables("input"), _variables("output")
"""Its variables, with their types. Outputs that nothing here changes are zero."""


class UrDouble:
    """Attributes that a simulation reads and sets. slider: speed slider of the pendant, 0 to 1; remote: remote control;
    robot_mode, safety_bits: as RTDE reports; lag_s: lag of the registers; gain: factor on the program's rates;
    silent: it reports nothing more; programs: scripts that came; popups: errors of programs; clients: those of RTDE"""

    ports: Mapping[str, int] = PORTS

    def __init__(self, config: UrConfig | None = None, *, start_deg: npt.ArrayLike | None = None) -> None:
        self.config = config if config is not None else UrConfig()
        self.chain: Chain = self.config.chain
        self.e_series = self.config.cycle_hz > 125.0
        self.version = (5, 11, 1, 108318) if self.e_series else (3, 15, 7, 106331)
        self._q: FloatArray = np.radians(self.chain.home_deg if start_deg is None else start_deg)
        self._qd, self._target, self._wrench = np.zeros(6), np.zeros(6), np.zeros(6)
        self._bristle, self._drift_n = np.zeros(6), np.zeros(3)
        self.slider, self.remote, self.robot_mode, self.safety_bits = 1.0, True, rtde.RUNNING, rtde.NORMAL
        self.lag_s, self.gain, self.silent = REGISTER_LAG_S, 1.0, False
        self.programs: list[str] = []
        self.popups: list[str] = []
        self._period_ns = round(1e9 / self.config.cycle_hz)
        self._next_ns: int | None = None
        self._began_ns = self._stopped_ns = 0
        self.clients: list[RtdeConnection] = []
        self._random = random = np.random.default_rng(0x05)
        self.inputs: dict[str, Any] = {}
        self._input_ns: dict[str, int] = {}
        self._steps: Generator[Step, None, None] | None = None
        self._starts_ns: int | None = None
        self._step: Step = ("",)
        self.runtime = Runtime.STOPPED
        self.end_program()
        self._outputs: dict[str, Callable[[], Any]] = {
            "timestamp": lambda: (self.next_ns(0) - self._began_ns) / 1e9,
            **dict.fromkeys(("actual_q", "target_q"), lambda: self._q),
            **dict.fromkeys(("speed_scaling", "target_speed_fraction"), lambda: self.slider),
            **dict.fromkeys(("actual_TCP_pose", "target_TCP_pose"), self._pose),
            "actual_qd": lambda: self._qd,
            "target_qd": lambda: self._target,
            "actual_current": lambda: motor_currents(
                self.chain, self.joints_deg, self.rates_deg_s, self._wrench, random
            ),
            "actual_TCP_force": self._force,
            "robot_mode": lambda: self.robot_mode,
            "runtime_state": lambda: int(self.runtime),
            "safety_mode": lambda: (
                1 if self.safety_bits == rtde.NORMAL else 3 if self.safety_bits & rtde.PROTECTIVE else 7
            ),
            "safety_status_bits": lambda: self.safety_bits,
            "robot_status_bits": lambda: 1 | (self.runtime is Runtime.PLAYING) << 1,
        }

    @property
    def joints_deg(self) -> FloatArray:
        """(6,) angles of the joints [deg]."""
        return np.degrees(self._q)

    @property
    def rates_deg_s(self) -> FloatArray:
        """(6,) rates of the joints [deg/s]."""
        return np.degrees(self._qd)

    @property
    def commanded_deg_s(self) -> FloatArray:
        """(6,) rates that the program asks for now [deg/s]."""
        return np.degrees(self._target)

    @property
    def T_base_links(self) -> FloatArray:
        """(7, 4, 4) of the joints and the flange [m]."""
        return self.chain.forward(self.joints_deg)

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) where the flange is [m]."""
        return np.asarray(self.T_base_links[-1])

    def push(self, wrench: npt.ArrayLike) -> None:
        """A push changes currents and the estimated force. wrench: (6,) on the flange, in the base frame [N, Nm]"""
        self._wrench = np.array(wrench, dtype=float)

    def report(self, joints_deg: npt.ArrayLike) -> None:
        """From now on report these angles (6,) [deg], whatever the joints do."""
        held_rad = np.radians(joints_deg)
        self._outputs["actual_q"] = lambda: held_rad

    def protective_stop(self) -> None:
        """Stop it as after a collision."""
        self.safety_bits, self._stopped_ns = rtde.PROTECTIVE | 1 << 10, self.next_ns(0)
        self.pause()

    def emergency_stop(self) -> None:
        """Press the red button: the program ends."""
        self.safety_bits, self.robot_mode = 1 << 6 | 1 << 7 | 1 << 10, rtde.IDLE
        self.end_program()

    def pause(self) -> bool:
        """Pause the program, as on the pendant."""
        if paused := self.runtime is Runtime.PLAYING:
            self.runtime = Runtime.PAUSED
        return paused

    def end_program(self) -> bool:
        """Stop the program, as on the pendant."""
        self._steps, self._starts_ns, self._step = None, None, ("",)
        self._watched: dict[str, tuple[int, int]] = {}
        self.registers = [0] * len(REGISTERS)
        self.runtime = Runtime.STOPPED
        return True

    def switch(self, mode: int) -> bool:
        """Switch the arm on (mode IDLE), then open its brakes (RUNNING)."""
        if done := mode == rtde.IDLE or self.robot_mode >= rtde.IDLE:
            self.robot_mode = max(self.robot_mode, mode)
        return done

    def connection(self, name: str) -> "Connection":
        """What speaks with a new client of a port."""
        if name == RTDE:
            self.clients.append(RtdeConnection(self))
            return self.clients[-1]
        return DashboardConnection(self) if name == DASHBOARD else ScriptConnection(self)

    def drop(self, connection: Double) -> None:
        """A connection has ended: what its client had set stays."""
        self.clients = [client for client in self.clients if client is not connection]

    def power_up(self, now_ns: int) -> None:
        """A cable that is put in changes nothing."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Its connections receive."""

    def due(self, now_ns: int) -> bytes:
        self.live(now_ns)
        return b""

    @property
    def stands(self) -> bool:
        """Whether its safety or its mode keeps it from moving."""
        return bool(self.safety_bits & ~3) or self.robot_mode != rtde.RUNNING

    def next_ns(self, now_ns: int) -> int:
        """The end of its present cycle."""
        return now_ns if self._next_ns is None else self._next_ns

    def live(self, now_ns: int) -> None:
        """Compute the controller's cycles up to now_ns [ns]."""
        if self._next_ns is None:
            self._next_ns = self._began_ns = now_ns
        while self._next_ns <= now_ns:
            self._cycle(self._next_ns)
            self._next_ns += self._period_ns

    def _cycle(self, now_ns: int) -> None:
        for client in self.clients:
            client.take_inputs(now_ns)
        if self.inputs.get("speed_slider_mask"):
            self.slider = float(np.clip(self.inputs["speed_slider_fraction"], 0.0, 1.0))
        if self.stands:
            self.pause()
        if self._starts_ns is not None and now_ns >= self._starts_ns:
            self._starts_ns, self.runtime = None, Runtime.PLAYING
        plays = self.runtime is Runtime.PLAYING
        wanted, acceleration = self._program_step(now_ns) if plays else (np.zeros(6), STOP_RAD_S2)
        self._target = wanted * self.slider * self.gain
        most, gap = acceleration * self._period_ns / 1e9, self._target - self._qd
        self._qd = np.where(np.abs(gap) <= most, self._target, self._qd + np.sign(gap) * most)
        turned = self._qd * self._period_ns / 1e9
        self._q, self._bristle = self._q + turned, np.clip(self._bristle + turned / BRISTLE_RAD, -1.0, 1.0)
        if np.any(np.abs(self.joints_deg) > self.chain.upper_deg):
            self.protective_stop()
        for client in self.clients:
            client.report()

    def _program_step(self, now_ns: int) -> tuple[FloatArray, float]:
        """(6,) rates [rad/s] and acceleration [rad/s^2] in this cycle."""
        rest = np.zeros(6)
        for name, (period_ns, seen_ns) in self._watched.items():
            if now_ns - max(self._input_ns.get(name, 0), seen_ns) > period_ns:
                self._popup(f"RTDE watchdog: {name}")
                return rest, STOP_RAD_S2
        if self._step[0] == "stopj" and np.any(self._qd):
            return rest, self._step[1]
        try:
            assert self._steps is not None
            self._step = next(self._steps, ("ended",))
            match self._step:
                case ("speedj", [*rates], acceleration, *_) if len(rates) == 6:
                    return np.array(rates, dtype=float), float(acceleration)
                case ("stopj", acceleration):
                    return rest, float(acceleration)
                case ("ended",):
                    self.end_program()
                case _:
                    raise ScriptError(f"{self._step[0]} with other arguments")
        except (ScriptError, TypeError, ValueError) as error:
            self._popup(str(error))
        return rest, STOP_RAD_S2

    def load(self, text: str, now_ns: int) -> None:
        """A script has come: it replaces the program that runs, where it can be run."""
        self.programs.append(text)
        if self.stands or (self.e_series and not self.remote):
            return
        self.end_program()
        functions: dict[str, Callable[..., Any]] = {
            "get_steptime": lambda: self._period_ns / 1e9,
            "read_input_integer_register": lambda number: self.inputs.get(f"input_int_register_{number}", 0),
            "read_input_float_register": lambda number: self.inputs.get(f"input_double_register_{number}", 0.0),
            "write_output_integer_register": self.registers.__setitem__,
            "rtde_set_watchdog": lambda name, hz, action: self._watched.update({name: (round(1e9 / hz), now_ns)}),
        }
        try:
            self._steps = Program(text, functions).run()
            self._starts_ns = now_ns + round(STARTS_S * 1e9)
        except ScriptError as error:
            self._popup(str(error))

    def play(self) -> bool:
        """Go on with a program that was paused, where it can."""
        if plays := self.runtime is Runtime.PAUSED and not self.stands:
            self.runtime = Runtime.PLAYING
        return plays

    def unlock(self) -> bool:
        """Unlock a protective stop, if it is not too early; its program has ended."""
        if late := self.safety_bits & rtde.PROTECTIVE > 0 and self.next_ns(0) - self._stopped_ns >= UNLOCK_S * 1e9:
            self.safety_bits, _ = rtde.NORMAL, self.end_program()
        return late

    def _popup(self, words: str) -> None:
        self.popups.append(words)
        self.end_program()

    def take(self, values: dict[str, Value], now_ns: int) -> None:
        """Set inputs."""
        self.inputs.update(values)
        self._input_ns.update(dict.fromkeys(values, now_ns))

    def output(self, name: str) -> Value:
        """The present value of an output."""
        if name in self._outputs:
            value = self._outputs[name]()
            return tuple(value.tolist()) if isinstance(value, np.ndarray) else value
        kind, _, number = name.rpartition("_register_")
        if kind == "output_int":
            return self.registers[int(number)]
        return (0,) * int(rtde.FORMATS[OUTPUTS[name]][:-1]) if OUTPUTS[name].startswith("VECTOR") else 0

    def _pose(self) -> FloatArray:
        """(6,) place [m] and rotation vector [rad] of the flange."""
        pose = self.T_base_end_effector
        return np.concatenate([pose[:3, 3], rotation_vector(pose[:3, :3])])

    def _force(self) -> FloatArray:
        """(6,) the estimated force and torque on the flange, in the base frame [N, Nm]."""
        if not self.e_series and least_singular(jacobian_of(self.T_base_links)) < SINGULAR:
            return np.zeros(6)
        self._drift_n = self._drift_n + self._random.normal(0.0, DRIFT_N / math.sqrt(self.config.state_hz), 3)
        bias_n = BIAS_N * np.sin(self._q[:3] + self._q[3:]) + RIPPLE_N * np.sin(RIPPLES * self._q[:3])
        bias_n = bias_n + FRICTION_N * self._bristle[:3] + self._drift_n
        off = np.concatenate([bias_n, 0.05 * bias_n]) + self._random.normal(0.0, NOISE)
        times = 1.0 if self.e_series else CB3_TIMES
        return np.asarray(np.round((self._wrench + off * times) / (STEP * times)) * (STEP * times))


class Connection:
    """One client of the controller, as a double of its own."""

    def __init__(self, controller: UrDouble) -> None:
        self.controller = controller
        self._sent = self._text = b""

    def power_up(self, now_ns: int) -> None:
        """A client is there from the beginning."""

    def receive(self, data: bytes, now_ns: int) -> None:
        self.controller.live(now_ns)

    def due(self, now_ns: int) -> bytes:
        self.controller.live(now_ns)
        sent, self._sent = self._sent, b""
        return sent

    def next_ns(self, now_ns: int) -> int | None:
        return self.controller.next_ns(now_ns)


class RtdeConnection(Connection):
    """A client of RTDE; claimed: the inputs that it sets"""

    def __init__(self, controller: UrDouble) -> None:
        super().__init__(controller)
        self._decoder, self._every, self._count, self._started = Decoder(), 1, 0, False
        self._outputs: Recipe | None = None
        self._recipes: dict[int, Recipe] = {}
        self._pending: deque[tuple[int, dict[str, Value]]] = deque()
        self.claimed: set[str] = set()

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        for package in self._decoder.feed(data):
            if isinstance(package, Package) and (reply := self._answer(package, now_ns)) is not None:
                self._sent += reply.encode()

    def _answer(self, package: Package, now_ns: int) -> Package | None:
        payload = package.payload
        match package.kind:
            case Kind.VERSION:
                return Package(Kind.VERSION, bytes([payload == struct.pack(">H", rtde.PROTOCOL)]))
            case Kind.CONTROLLER:
                return Package(Kind.CONTROLLER, struct.pack(">4I", *self.controller.version))
            case Kind.OUTPUTS if len(payload) > 8:
                (hz,), names = struct.unpack_from(">d", payload), _names(payload[8:])
                types = tuple(OUTPUTS.get(name, rtde.NOT_FOUND) for name in names)
                cycle_hz = self.controller.config.cycle_hz
                good = rtde.NOT_FOUND not in types and 1.0 <= hz <= cycle_hz
                self._every = round(cycle_hz / hz) if good else 1
                recipe = Recipe(int(good), names, types)
                self._outputs = recipe if good else None
                return recipe.reply(Kind.OUTPUTS)
            case Kind.INPUTS:
                names, clients = _names(payload), self.controller.clients
                others = {name for client in clients if client is not self for name in client.claimed}
                types = tuple(rtde.IN_USE if name in others else INPUTS.get(name, rtde.NOT_FOUND) for name in names)
                recipe = Recipe(len(self._recipes) + 1, names, types)
                if recipe.refused:
                    return Recipe(0, names, types).reply(Kind.INPUTS)
                self._recipes[recipe.number] = recipe
                self.claimed.update(names)
                return recipe.reply(Kind.INPUTS)
            case Kind.START | Kind.PAUSE as kind:
                self._started = kind is Kind.START and self._outputs is not None
                return Package(kind, bytes([self._started or kind is Kind.PAUSE]))
            case Kind.DATA if payload and payload[0] in self._recipes:
                if (values := self._recipes[payload[0]].unpack(package)) is not None:
                    self._pending.append((now_ns + round(self.controller.lag_s * 1e9), values))
        return None

    def take_inputs(self, now_ns: int) -> None:
        """Apply the registers that are due."""
        while self._pending and self._pending[0][0] <= now_ns:
            self.controller.take(self._pending.popleft()[1], now_ns)

    def report(self) -> None:
        """Send what is due at the end of a cycle."""
        self._count += 1
        if self._started and self._outputs and self._count % self._every == 0 and not self.controller.silent:
            values = {name: self.controller.output(name) for name in self._outputs.names}
            self._sent += self._outputs.pack(values).encode()


def _names(payload: bytes) -> tuple[str, ...]:
    """The names of a request; ur-rtde ends them with a comma."""
    return tuple(payload.decode("latin-1").removesuffix(",").split(","))


class ScriptConnection(Connection):
    """A client of port 30002 that sends a script; a program begins with `def` and ends with `end`, unindented."""

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        self._text += data
        while (at := self._text.find(b"\nend\n")) >= 0:
            program, self._text = self._text[: at + 5], self._text[at + 5 :]
            self.controller.load(program.decode("utf-8", "replace"), now_ns)
        self._text = self._text[-(1 << 16) :]


class DashboardConnection(Connection):
    """A client of the dashboard."""

    def __init__(self, controller: UrDouble) -> None:
        super().__init__(controller)
        self._sent += GREETING.encode() + b"\n"

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        *lines, self._text = (self._text[-1024:] + data).split(b"\n")
        for line in lines:
            self._sent += self._answer(line.decode("utf-8", "replace").strip()).encode() + b"\n"

    def _answer(self, command: str) -> str:
        arm = self.controller
        stopped = "PROTECTIVE_STOP" if arm.safety_bits & rtde.PROTECTIVE else "ROBOT_EMERGENCY_STOP"
        safety = "NORMAL" if arm.safety_bits == rtde.NORMAL else stopped
        said = {
            "robotmode": f"Robotmode: {rtde.ROBOT_MODES[arm.robot_mode]}",
            "safetymode": f"Safetymode: {safety}",
            "safetystatus": f"Safetystatus: {safety}",
            "PolyscopeVersion": f"URSoftware {'.'.join(map(str, arm.version))} (simulated)",
            "running": f"Program running: {str(arm.runtime is Runtime.PLAYING).lower()}",
            "programState": f"{arm.runtime.name} <unnamed>",
        }
        if arm.e_series:
            said |= {"is in remote control": str(arm.remote).lower(), "get serial number": "20215500000"}
        done: dict[str, tuple[Callable[[], bool], str]] = {
            "power on": (lambda: arm.switch(rtde.IDLE), "Powering on"),
            "brake release": (lambda: arm.switch(rtde.RUNNING), "Brake releasing"),
            "unlock protective stop": (arm.unlock, "Protective stop releasing"),
            "play": (arm.play, "Starting program"),
            "pause": (arm.pause, "Pausing program"),
            "stop": (arm.end_program, "Stopped"),
        }
        if command in done:
            action, words = done[command]
            if (arm.remote or not arm.e_series) and action():
                return words
            return "Cannot unlock protective stop until 5s" if "unlock" in command else f"Failed to execute: {command}"
        absent = f"File not found: {command[5:]}" if command.startswith("load ") else f"{UNKNOWN}: '{command}'"
        return said.get(command, absent)
