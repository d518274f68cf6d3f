"""The simulated hand, by the bytes that go in and come out."""

import pytest

from deformscope_drivers.sdh.double import Port, SdhDouble
from deformscope_drivers.sdh.protocol import Command, DebugLine, Decoder, ErrorReply, Event, Reading, encode

MS = 1_000_000
SECOND = 1_000_000_000


class Talk:
    """A conversation with a double, in time."""

    def __init__(self, double: SdhDouble) -> None:
        self.double = double
        self.now_ns = 0
        double.power_up(0)

    def run(self, seconds: float) -> bytes:
        """Everything the hand says in that time."""
        until_ns = self.now_ns + round(seconds * SECOND)
        said = b""
        while (next_ns := self.double.next_ns(self.now_ns)) is not None and next_ns <= until_ns:
            self.now_ns = max(next_ns, self.now_ns + 1)
            said += self.double.due(self.now_ns)
        self.now_ns = until_ns
        return said + self.double.due(until_ns)

    def __call__(self, line: str, seconds: float = 0.1) -> bytes:
        self.double.receive(line.encode() + b"\r\n", self.now_ns)
        return self.run(seconds)

    def ask(self, command: Command, checksum: bool = True) -> Event:
        self.double.receive(encode(command, binary_checksum=checksum), self.now_ns)
        (event,) = Decoder(checksummed=checksum).feed(self.run(0.1))
        assert not isinstance(event, DebugLine)
        return event


@pytest.fixture
def talk() -> Talk:
    return Talk(SdhDouble(state_lag_s=0.0))


def test_what_it_is(talk: Talk) -> None:
    assert talk("ver") == b"VER=0.0.3.2\r\n"
    assert talk("sn").startswith(b"SN=")
    assert talk("vlim") == b"VLIM=80.00,100.00,100.00,100.00,100.00,100.00,100.00\r\n"
    assert talk("alim(0)") == b"ALIM(0)=5000.00\r\n"
    assert talk("igrip") == b"IGRIP=1.00,0.50,0.50,0.50,0.50,0.50,0.50\r\n"
    assert talk("ihold(6)") == b"IHOLD(6)=0.20\r\n"
    assert talk("v") == b"V=40.00,40.00,40.00,40.00,40.00,40.00,40.00\r\n"
    assert talk("temp").count(b",") == 8
    assert talk("state") == b"STATE=6,6,6,6,6,6,6\r\n"
    assert talk(" ") == b""


def test_a_move_by_text(talk: Talk) -> None:
    assert talk("p=0,-10,20,-10,20,-10,20") == b"P=0.00,-10.00,20.00,-10.00,20.00,-10.00,20.00\r\n"
    assert talk("v(2)=      80.000") == b"V(2)=80.00\r\n"
    assert talk("get_duration") == b"GET_DURATION=1.0\r\n"  # 2 * 20 / 40 of axes 4 and 6
    assert talk("m", 0.2) == b"M=1.0\r\n"
    assert talk("state", 0.0) == b""  # on RS-232 a line takes its time
    assert talk.run(0.1) == b"STATE=1,1,1,1,1,1,1\r\n".replace(b"=1,", b"=0,", 1)
    talk.run(1.0)
    assert talk("pos") == b"POS=0.00,-10.00,20.00,-10.00,20.00,-10.00,20.00\r\n"
    assert talk("state") == b"STATE=0,0,0,0,0,0,0\r\n"
    assert talk("tpap(1)=5") == b"TPAP(1)=-10.00\r\n"
    assert talk("p(1)") == b"P(1)=5.00\r\n"


def test_a_move_in_binary(talk: Talk) -> None:
    talk.ask(Command("p", (0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0)))
    talk("m", 1.0)
    reading = talk.ask(Command("pos"))
    assert isinstance(reading, Reading)
    assert reading.values == (0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0)
    assert talk.ask(Command("p", (0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0))) == ErrorReply(24, "p")
    assert talk.ask(Command("vlim")) == ErrorReply(13, "vlim")  # Schunk's library sends it as text


def test_what_it_refuses(talk: Talk) -> None:
    for line, code in [
        ("hello", 13),
        ("p=1,2", 11),
        ("p=0,0,0,0,0,0,0,0", 14),
        ("p=0,0,0,0,0,0,x", 14),
        ("p(7)=1", 26),
        ("p(0)=-1", 24),
        ("v(1)=-5", 24),
        ("a(1)=0", 24),
        ("ilim(0)=1.1", 24),
        ("power(0)=2", 24),
        ("vp=2", 24),
        ("con=3", 24),
        ("selgrip=1", 13),
        ("grip=0.1,40", 13),
        ("ref(0)=1", 13),
        ("pos=1", 12),
        ("kv", 13),
    ]:
        assert talk(line) == f"E{code}\r\n".encode(), line
    talk.double.refuse_next(29)
    assert talk("m") == b"E29\r\n"
    assert talk("m") == b"M=0.0\r\n"


def test_old_firmware_talks_more_and_tells_less() -> None:
    talk = Talk(SdhDouble(firmware="0.0.2.10"))
    talk("p(1)=45.06")
    talk("v(1)=20")
    plan = b"@max distance=45.06, T=4.51s, num_points: 451\r\n"
    assert talk("get_duration") == plan + b"GET_DURATION=4.51\r\n"
    assert talk("m") == b"@Enabling all axis\r\n" + plan + b"m\r\n"
    talk.run(5.0)
    talk.double.receive(encode(Command("pos"), binary_checksum=True), talk.now_ns)
    assert talk.run(0.5) == b""


@pytest.mark.parametrize(
    ("firmware", "unknown"),
    [("0.0.2.0", ("vlim", "alim", "con", "rvel")), ("0.0.2.5", ("alim", "con", "rvel")), ("0.0.2.6", ("alim",))],
)
def test_what_older_firmware_does_not_know(firmware: str, unknown: tuple[str, ...]) -> None:
    talk = Talk(SdhDouble(firmware=firmware))
    assert [line for line in ("vlim", "alim", "con", "rvel", "vel") if talk(line) == b"E13\r\n"] == list(unknown)


def test_a_motion_takes_as_long_as_in_the_trace(talk: Talk) -> None:
    talk.double.place((0.0, -75.01, 75.11, -75, 75, -75, 75))
    talk("p=0,-66.8,66.8,-66.8,66.8,-66.8,66.8")
    assert talk("m") == b"M=0.42\r\n"  # 8.31 deg at 40 deg/s, as in Schunk's trace
    talk.run(0.5)
    assert talk("pos") == b"POS=0.00,-66.80,66.80,-66.80,66.80,-66.80,66.80\r\n"


def test_velocities_take_effect_at_once(talk: Talk) -> None:
    talk("power=1,1,1,1,1,1,1")
    assert talk("con=1") == b"CON=1\r\n"
    assert talk("v=0,0,0,0,0,0,-20") == b"V=0.00,0.00,0.00,0.00,0.00,0.00,-20.00\r\n"
    talk.run(0.9)
    assert talk("tvav(6)=0") == b"TVAV(6)=-20.00\r\n"
    assert -21 < talk.double.position_deg(talk.now_ns)[6] < -19
    assert talk("m") == b"E17\r\n"


def test_states_lag_behind_a_command() -> None:
    talk = Talk(SdhDouble(state_lag_s=0.3))
    talk("p(1)=40")
    talk("m", 0.2)
    assert talk("state(1)", 0.05) == b"STATE(1)=6\r\n"
    talk.run(0.3)
    assert talk("state(1)") == b"STATE(1)=1\r\n"


def test_serial_has_a_pace_and_can_none() -> None:
    serial, can = Talk(SdhDouble()), Talk(SdhDouble(Port.CAN))
    request = {True: encode(Command("pos"), binary_checksum=True), False: encode(Command("pos"), binary_checksum=False)}
    serial.double.receive(request[True], 0)
    can.double.receive(request[False], 0)
    assert len(can.double.due(0)) == 32
    early = serial.double.due(2 * MS)
    assert len(early) == 18  # 5 bytes there take 0.43 ms, and each of the 34 back 0.087 ms
    assert len(early + serial.run(0.0034)) == 34
    serial.double.receive(request[False], 10 * MS)  # without checksum: not for this line
    assert serial.run(0.1).count(b"\x83") <= 1


def test_power_up_forgets_settings_and_keeps_angles(talk: Talk) -> None:
    talk("p(1)=20")
    talk("vp=1")
    talk("m", 2.0)
    talk.double.power_up(talk.now_ns)
    assert talk("vp") == b"VP=0\r\n"
    assert talk("p(1)") == b"P(1)=0.00\r\n"
    assert talk("pos(1)") == b"POS(1)=20.00\r\n"
    assert talk("state(1)") == b"STATE(1)=6\r\n"
