"""RTDE of Universal Robots: bytes of the vendor's documents and clients, any bytes, URScript, ur-rtde as a client."""

import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from deformscope_ur import UrConfig, UrDouble, rtde
from deformscope_ur.config import DASHBOARD, PORTS, RTDE
from deformscope_ur.device import control_script
from deformscope_ur.rtde import Decoder, Kind, Package, Recipe
from deformscope_ur.script import Program, ScriptError
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.framing import Skipped
from tests.patience import PATIENCE_S


def decoded(text: str) -> Package:
    (package,) = Decoder().feed(bytes.fromhex(text))
    assert isinstance(package, Package)
    return package


# typed from the tests of Universal_Robots_Client_Library (test_rtde_parser.cpp)


def test_replies_are_read_as_the_vendors_client_reads_them() -> None:
    assert decoded("00 04 56 01").accepted is True
    assert decoded("00 04 50 01").accepted is True
    assert decoded("00 04 53 01").accepted is True
    assert decoded("00 04 53 00").accepted is False
    version = decoded("00 13 76 00 00 00 05 00 00 00 08 00 00 00 00 00 00 00 00")
    assert version.version == (5, 8, 0, 0)
    # there the size is 17, which their parser does not compare
    outputs = decoded("00 13 4f 01 44 4f 55 42 4c 45 2c 56 45 43 54 4f 52 36 44")
    recipe = Recipe.of_reply(outputs, ("timestamp", "actual_q"))
    assert recipe == Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    inputs = decoded("00 11 49 01 55 49 4e 54 33 32 2c 44 4f 55 42 4c 45")
    assert Recipe.of_reply(inputs, ("speed_slider_mask", "speed_slider_fraction")) == Recipe(
        1, ("speed_slider_mask", "speed_slider_fraction"), ("UINT32", "DOUBLE")
    )


def test_a_data_package_is_read_as_the_vendors_client_reads_it() -> None:
    package = decoded("00 14 55 01 40 d0 07 0d 2f 1a 9f be 3f f0 00 00 00 00 00 00")
    recipe = Recipe(1, ("timestamp", "target_speed_fraction"), ("DOUBLE", "DOUBLE"))
    assert recipe.unpack(package) == {"timestamp": 16412.206, "target_speed_fraction": 1.0}
    assert Recipe(2, recipe.names, recipe.types).unpack(package) is None
    assert Recipe(1, ("timestamp",), ("DOUBLE",)).unpack(package) is None


def test_requests_are_those_of_the_guide() -> None:
    assert Package(Kind.VERSION, b"\0\2").encode() == bytes.fromhex("00 05 56 00 02")
    assert Package(Kind.CONTROLLER).encode() == bytes.fromhex("00 03 76")
    assert Package(Kind.START).encode() == bytes.fromhex("00 03 53")
    assert rtde.output_request(125.0, ("timestamp",)).encode() == bytes.fromhex(
        "00 14 4f 40 5f 40 00 00 00 00 00 74 69 6d 65 73 74 61 6d 70"
    )
    # one BOOL, UINT8, UINT32, INT32, DOUBLE, behind the number of its recipe
    recipe = Recipe(3, tuple("abcde"), ("BOOL", "UINT8", "UINT32", "INT32", "DOUBLE"))
    packed = recipe.pack({"a": True, "b": 7, "c": 258, "d": -2, "e": 1.0})
    assert packed.encode() == bytes.fromhex("00 16 55 03 01 07 00 00 01 02 ff ff ff fe 3f f0 00 00 00 00 00 00")


def test_a_text_message_has_its_lengths_before_it() -> None:
    text = decoded("00 0f 4d 05 68 65 6c 6c 6f 04 52 54 44 45 01")
    assert text.text == "RTDE: hello"
    assert Package(Kind.TEXT, b"\x05hel").text == ""


KINDS = sorted(rtde.FORMATS)


@given(st.lists(st.sampled_from(KINDS), min_size=1, max_size=8), st.data())
def test_what_is_packed_is_unpacked(kinds: list[str], data: st.DataObject) -> None:
    recipe = Recipe(1, tuple(f"v{at}" for at in range(len(kinds))), tuple(kinds))
    values: dict[str, rtde.Value] = {}
    for name, kind in zip(recipe.names, kinds, strict=True):
        shape = rtde.FORMATS[kind]
        one = st.floats(allow_nan=False) if shape[-1] == "d" else st.integers(0, 1 if shape == "?" else 255)
        count = int(shape[:-1] or 1)
        values[name] = tuple(data.draw(one) for _ in range(count)) if count > 1 else data.draw(one)
    assert recipe.unpack(recipe.pack(values)) == values


@settings(max_examples=300)
@given(st.binary(max_size=400), st.lists(st.integers(1, 40), max_size=20), st.booleans())
def test_any_bytes_give_packages_that_were_in_them_or_nothing(data: bytes, cuts: list[int], headed: bool) -> None:
    """No exception, nothing invented: every package is a piece of the stream, and every byte is accounted for."""
    stream = b"\x00\x04S\x01" + data if headed else data
    decoder, events, at = Decoder(), [], 0
    for cut in [*cuts, len(stream)]:
        events += list(decoder.feed(stream[at : at + cut]))
        at += cut
    events += list(decoder.feed(stream[at:])) + list(decoder.finish())
    where = 0
    for event in events:
        if isinstance(event, Skipped):
            where += event.count
            continue
        assert stream[where : where + len(event.encode())] == event.encode()
        where += len(event.encode())
        assert event.accepted in (None, True, False)
        assert event.version is None or len(event.version) == 4
        assert (event.text == "") or event.kind is Kind.TEXT
        assert (recipe := Recipe.of_reply(event, ("a",))) is None or len(recipe.types) == 1
    assert where == len(stream)


@settings(max_examples=100)
@given(st.binary(max_size=300), st.sampled_from(sorted(PORTS)))
def test_a_controller_takes_any_bytes(data: bytes, name: str) -> None:
    double = UrDouble()
    connection = double.connection(name)
    connection.receive(data + b"\n", 0)
    connection.receive(Package(Kind.DATA, data[:60]).encode(), 1_000_000)
    connection.due(50_000_000)
    np.testing.assert_array_equal(double.joints_deg, double.chain.home_deg)


# URScript ---------------------------------------------------------------------------------------------------------


def steps(text: str) -> list[tuple[object, ...]]:
    return list(Program(text, {"get_steptime": lambda: 0.002}).run())


def test_a_program_is_read_as_urscript() -> None:
    found = steps(
        "def thrice():\n  # a comment\n  local at = 0\n  while at < 3:\n"
        "    if at == 1:\n      speedj([at, 0, 0], 1.5, 0.1)\n"
        "    elif at == 2 and not False:\n      stopj(2)\n    else:\n      speedj([-1, 0, 0], get_steptime(), 0.1)\n"
        "    end\n    at = at + 1\n  end\nend\n"
    )
    assert found == [("speedj", [-1, 0, 0], 0.002, 0.1), ("speedj", [1, 0, 0], 1.5, 0.1), ("stopj", 2)]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "speedj([0], 1)\n",
        "def p():\n  while True:\n    a = 1\n  end\nend\n",
        "def p():\n  a = open(1)\nend\n",
        "def p():\n  a = [].append\nend\n",
        "def p():\n  a = __import__\nend\n",
        "def p():\n  a = 9 ** 9 ** 9\nend\n",
        "def p():\n  if True:\n    stopj(1)\nend\n",
        "def p():\n  import os\nend\n",
        "def p(a):\nend\n",
    ],
)
def test_other_programs_are_refused(text: str) -> None:
    with pytest.raises(ScriptError):
        steps(text)


def test_a_line_that_fails_ends_the_program_with_a_popup() -> None:
    double = UrDouble()
    double.load("def p():\n  a = [1]\n  speedj(a[3], 1, 1)\nend\n", 0)
    double.live(0)
    double.live(100_000_000)
    assert double.popups == ["list index out of range"]
    assert double.runtime is rtde.Runtime.STOPPED


# ur-rtde: its receive and IO interfaces, and its dashboard client, with the double in a process of its own ----------

SERVE = """
import sys
from deformscope_ur import UrConfig, UrDouble
from deformscope_drivers.wires import PortsWire
with PortsWire(UrDouble(UrConfig(model=sys.argv[1]))) as wire:
    print(wire.port, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["ur5e", "ur5"])
def controller(request: pytest.FixtureRequest) -> Iterator[UrConfig]:
    """A simulated controller at the ports that ur-rtde asks; ur-rtde connects with the interpreter's lock held."""
    code = f"import sys; sys.path[:0] = {sys.path!r}\n{SERVE}"
    command = [sys.executable, "-c", code, request.param]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = process.stdout.readline().strip()
        try:
            if not port.endswith(f":{PORTS[RTDE]}"):
                pytest.skip(f"another program has port {PORTS[RTDE]}")
            yield UrConfig(model=request.param)
        finally:
            process.communicate()


class Client:
    """ur-rtde with the registers that our script reads: it reaches five of the six velocities."""

    SESSION = 77

    def __init__(self) -> None:
        receive = pytest.importorskip("rtde_receive", reason="pip install ur-rtde")
        self.received = receive.RTDEReceiveInterface("127.0.0.1", -1.0, [], False, True)
        self.io = pytest.importorskip("rtde_io").RTDEIOInterface("127.0.0.1", False, True)
        self.beat = 0
        self.io.setInputIntRegister(43, self.SESSION)

    def drive(self, rates_rad_s: tuple[float, ...], until: object, seconds: float = PATIENCE_S) -> None:
        """Send velocities and heartbeats until a condition holds, or for some time."""
        for number, rate in enumerate(rates_rad_s):
            self.io.setInputDoubleRegister(42 + number, rate)
        end = time.monotonic() + seconds
        while time.monotonic() < end and not (callable(until) and until()):
            self.beat += 1
            self.io.setInputIntRegister(42, self.beat)
            time.sleep(0.005)

    def close(self) -> None:
        self.received.disconnect()
        self.io.disconnect()


def test_ur_rtde_reads_the_double_and_sets_the_registers_that_our_script_obeys(controller: UrConfig) -> None:
    client = Client()
    try:
        received, start = client.received, np.radians(controller.chain.home_deg)
        np.testing.assert_allclose(received.getActualQ(), start, atol=1e-12)
        pose = controller.chain.end_effector(controller.chain.home_deg)
        np.testing.assert_allclose(received.getActualTCPPose()[:3], pose[:3, 3], atol=1e-9)
        assert (received.getRobotMode(), received.getSafetyMode()) == (rtde.RUNNING, 1)
        moving = (0.1, 0.0, 0.0, 0.0, -0.05)
        client.drive(moving, None, 0.2)
        np.testing.assert_allclose(received.getActualQ(), start, atol=1e-12)  # without our script nothing moves
        with socket.create_connection(("127.0.0.1", PORTS["script"])) as script:
            script.sendall(control_script(controller, Client.SESSION).encode())
        client.drive(moving, None, 0.3)
        np.testing.assert_allclose(received.getActualQ(), start, atol=1e-12)  # nor before it has seen zero
        client.drive((0.0,) * 5, lambda: received.getOutputIntRegister(42) == 1)
        client.drive(moving, lambda: received.getActualQ()[0] > 0.02)
        turned = np.array(received.getActualQ()) - start
        assert turned[0] > 0.02
        assert turned[4] == pytest.approx(-0.5 * turned[0], abs=2e-3)
        assert not np.any(turned[[1, 2, 3, 5]])
        deadline = time.monotonic() + PATIENCE_S
        while any(received.getActualQd()) and time.monotonic() < deadline:  # no heartbeat any more
            time.sleep(0.01)
        assert received.getActualQd() == [0.0] * 6
        assert received.getOutputIntRegister(42) == 2
        client.io.setSpeedSlider(0.2)
        client.drive((0.0,) * 5, lambda: received.getTargetSpeedFraction() == 0.2)
        assert received.getTargetSpeedFraction() == 0.2
    finally:
        client.close()


def test_ur_rtde_reads_the_dashboard(controller: UrConfig) -> None:
    client = pytest.importorskip("dashboard_client", reason="pip install ur-rtde").DashboardClient("127.0.0.1")
    client.connect()
    assert client.robotmode() == "Robotmode: RUNNING"
    assert client.safetystatus() == "Safetystatus: NORMAL"
    assert not client.running()
    assert client.polyscopeVersion().startswith("5.11.1" if controller.model == "ur5e" else "3.15.7")
    if controller.model == "ur5e":
        assert client.isInRemoteControl()
    client.disconnect()


def test_inputs_of_another_client_are_in_use() -> None:
    double = UrDouble()
    first, second = double.connection(RTDE), double.connection(RTDE)
    first.receive(rtde.input_request(("speed_slider_mask", "input_int_register_42")).encode(), 0)
    second.receive(rtde.input_request(("input_int_register_42", "input_int_register_43", "x")).encode(), 0)
    (reply,) = Decoder().feed(second.due(0))
    assert isinstance(reply, Package)
    assert reply.payload == b"\0IN_USE,INT32,NOT_FOUND"
    double.drop(first)
    second.receive(rtde.input_request(("input_int_register_42",)).encode(), 0)
    assert second.due(0) == rtde.Package(Kind.INPUTS, b"\1INT32").encode()


def test_a_dashboard_of_cb3_has_fewer_commands() -> None:
    answers = {}
    for model in ("ur5", "ur5e"):
        dashboard = UrDouble(UrConfig(model=model)).connection(DASHBOARD)
        dashboard.receive(b"is in remote control\nplay\nload a.urp\n", 0)
        answers[model] = dashboard.due(0).decode().splitlines()[1:]
    assert answers["ur5"] == [
        "could not understand: 'is in remote control'",
        "Failed to execute: play",
        "File not found: a.urp",
    ]
    assert answers["ur5e"][0] == "true"


def test_registers_take_effect_one_cycle_late_and_the_slider_scales() -> None:
    double = UrDouble()
    double.load("def p():\n  while True:\n    speedj([0.1, 0, 0, 0, 0, 0], 40, 0.002)\n  end\nend\n", 0)
    double.live(0)
    double.live(200_000_000)
    assert double.rates_deg_s[0] == pytest.approx(math.degrees(0.1))
    client = double.connection(RTDE)
    names = ("speed_slider_mask", "speed_slider_fraction")
    client.receive(rtde.input_request(names).encode(), 201_000_000)
    client.receive(Package(Kind.DATA, struct.pack(">BId", 1, 1, 0.2)).encode(), 201_000_000)
    double.live(202_000_000)
    assert double.slider == 1.0
    double.live(220_000_000)
    assert double.rates_deg_s[0] == pytest.approx(math.degrees(0.02))
