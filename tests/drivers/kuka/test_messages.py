"""RSI's messages byte for byte, typed from public sources, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.errors import ProtocolViolation
from deformscope_drivers.kuka import Kuka, KukaConfig
from deformscope_drivers.kuka.config import CHAINS
from deformscope_drivers.kuka.messages import RobMessage, SenMessage, decode_rob, decode_sen, encode_rob, encode_sen
from tools.arm_shapes import urdf_of

ROB = (
    b'<Rob TYPE="KUKA">  <RIst X="1.0" Y="2.0" Z="3.0" A="0.5" B="1.0" C="1.5" />'
    b'  <RSol X="2.0" Y="4.0" Z="8.0" A="1.5" B="1.0" C="0.5" />'
    b'  <AIPos A1="0.1" A2="0.2" A3="0.3" A4="0.4" A5="0.5" A6="0.6" />'
    b'  <ASPos A1="1.0" A2="0.9" A3="0.8" A4="0.7" A5="0.6" A6="0.5" />'
    b'  <Delay D="42" />  <IPOC>123645634563</IPOC></Rob>'
)
"""Typed from the test of a ROS 2 driver's parser (kuka_rsi)."""
SHORT = (
    b'<Rob Type="KUKA">\r\n<AIPos A1="-76.5500" A2="-94.7500" A3="66.6000" A4="8.5300" A5="19.3000" A6="5.1900"/>\r\n'
    b"<IPOC>7</IPOC>\r\n</Rob>"
)
SEN = (
    b'<Sen Type="ImFree"><AK A1="0.120000" A2="-0.000001" A3="0.000000" A4="0.000000" A5="-1.500000" A6="0.240000" />'
    b"<IPOC>4208163634</IPOC></Sen>"
)
"""As kuka_experimental's rsi_command.h prints it: std::to_string, TinyXML without line breaks."""


def test_a_controllers_message_is_read() -> None:
    message = decode_rob(ROB)
    assert message == RobMessage(
        joints_deg=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        ipoc=123645634563,
        pose=(1.0, 2.0, 3.0, 0.5, 1.0, 1.5),
        setpoint_deg=(1.0, 0.9, 0.8, 0.7, 0.6, 0.5),
        late=42,
    )
    assert decode_rob(SHORT) == RobMessage((-76.55, -94.75, 66.6, 8.53, 19.3, 5.19), 7)


def test_the_answer_is_that_of_the_public_driver_to_the_last_byte() -> None:
    message = SenMessage((0.12, -0.000001, 0.0, 0.0, -1.5, 0.24), 4208163634)
    assert encode_sen(message) == SEN
    assert decode_sen(SEN) == message


def test_what_the_double_sends_is_read_back() -> None:
    message = RobMessage((0.0, -90.0, 90.0, 0.0, 90.0, 0.0), 12, (445.0, 0.0, 810.0, 180.0, 0.0, 180.0), (0.0,) * 6, 3)
    sent = encode_rob(message)
    assert sent == (
        b'<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
        b'<RSol X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
        b'<AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/>'
        b'<ASPos A1="0.0000" A2="0.0000" A3="0.0000" A4="0.0000" A5="0.0000" A6="0.0000"/>'
        b'<Delay D="3"/><IPOC>12</IPOC></Rob>'
    )
    assert decode_rob(sent) == message


CURRENTS = b'<MACur A1="0.5" A2="-12.25" A3="3.0" A4="0.0" A5="0.1" A6="-0.2"/>'


def test_motor_currents_are_read_where_they_are_sent() -> None:
    message = decode_rob(SHORT.replace(b"<IPOC>", CURRENTS + b"<IPOC>"))
    assert message.currents == (0.5, -12.25, 3.0, 0.0, 0.1, -0.2)
    assert decode_rob(SHORT).currents == ()
    assert decode_rob(encode_rob(message)).currents == message.currents


@pytest.mark.parametrize(
    "data",
    [
        SHORT.replace(b"<IPOC>", CURRENTS.replace(b"3.0", b"nan") + b"<IPOC>"),
        SHORT.replace(b"<IPOC>", CURRENTS.replace(b"A6", b"A7") + b"<IPOC>"),
        b"",
        b"\xff\x00",
        b"<Rob>",
        b"<Sen><IPOC>1</IPOC></Sen>",
        SHORT.replace(b"7</IPOC>", b"</IPOC>"),
        SHORT.replace(b"7</IPOC>", b"0x7</IPOC>"),
        SHORT.replace(b"AIPos", b"AXPos"),
        SHORT.replace(b'A6="5.1900"', b""),
        SHORT.replace(b"5.1900", b"nan"),
        SHORT.replace(b"5.1900", b"5,19"),
        SHORT.replace(b"<Rob ", b"<!DOCTYPE x><Rob "),
        SHORT + b" " * 5000,
    ],
)
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolViolation):
        decode_rob(data)


def test_every_cut_and_flip_is_read_or_refused() -> None:
    for size in range(len(ROB)):
        with pytest.raises(ProtocolViolation):
            decode_rob(ROB[:size])
    random = np.random.default_rng(3)
    for _ in range(2000):
        data = bytearray(ROB)
        data[random.integers(len(data))] = random.integers(256)
        try:
            decode_rob(bytes(data))
        except ProtocolViolation:
            continue


@pytest.fixture(params=sorted(CHAINS))
def chain(request: pytest.FixtureRequest) -> Chain:
    return CHAINS[request.param]


PUBLISHED = {"kr6r900sixx": (0.455, 0.42), "kr6r700sixx": (0.315, 0.365)}
"""Upper arm and forearm [m], kuka_kr6_support."""


def published_flange(name: str, joints_deg: FloatArray) -> FloatArray:
    """T_base_tool0 by walking the joints of the published URDF: origins and axes as typed there."""
    upper, forearm = PUBLISHED[name]
    joints = (
        ((0, 0, 0.4), (0, 0, -1)),
        ((0.025, 0, 0), (0, 1, 0)),
        ((upper, 0, 0), (0, 1, 0)),
        ((0, 0, 0.035), (-1, 0, 0)),
        ((forearm, 0, 0), (0, 1, 0)),
        ((0.08, 0, 0), (-1, 0, 0)),
    )
    rotation, place_m = Rotation.identity(), np.zeros(3)
    for (origin_m, axis), angle_deg in zip(joints, joints_deg, strict=True):
        place_m = place_m + rotation.apply(np.array(origin_m, float))
        rotation = rotation * Rotation.from_rotvec(np.radians(angle_deg) * np.array(axis, float))
    pose = np.eye(4)
    pose[:3, :3] = (rotation * Rotation.from_euler("y", 90, degrees=True)).as_matrix()
    pose[:3, 3] = place_m
    return pose


def test_the_chain_is_that_of_the_published_description(chain: Chain) -> None:
    random = np.random.default_rng(4)
    for joints_deg in random.uniform(chain.lower_deg, chain.upper_deg, (50, 6)):
        np.testing.assert_allclose(chain.end_effector(joints_deg), published_flange(chain.name, joints_deg), atol=1e-9)


def test_a_kr6r700_stands_where_a_controller_has_reported_it() -> None:
    """X 390, Y 0, Z 670, A -180, B 0, C 180 at its home, as recorded in a public driver's test."""
    pose = CHAINS["kr6r700sixx"].end_effector((0.0, -90.0, 90.0, 0.0, 90.0, 0.0))
    np.testing.assert_allclose(1e3 * pose[:3, 3], [390.0, 0.0, 670.0], atol=1e-9)
    reported = Rotation.from_euler("ZYX", (-180.0, 0.0, 180.0), degrees=True).as_matrix()
    np.testing.assert_allclose(pose[:3, :3], reported, atol=1e-9)


def test_its_urdf_is_made_of_the_chain(chain: Chain) -> None:
    assert Kuka(KukaConfig(model=chain.name)).urdf.read_text(encoding="utf-8") == urdf_of(chain)


def test_rerun_shows_it(chain: Chain) -> None:
    tree = pytest.importorskip("rerun").urdf.UrdfTree.from_file_path(Kuka(KukaConfig(model=chain.name)).urdf)
    names = [joint.name for joint in tree.joints() if joint.joint_type == "revolute"]
    assert names == [f"{chain.name}_joint_{index}" for index in range(1, 7)]
