"""The simulated tactile controller answers byte for byte, with its firmware's quirks, at its line's pace."""

import numpy as np
import pytest

from deformscope_drivers.dsa import DsaDouble, messages
from deformscope_drivers.dsa.double import BOOT_S
from deformscope_drivers.dsa.pads import SCHUNK_PA_PER_COUNT, Pad, Part
from deformscope_drivers.dsa.protocol import SDH_CELLS, Decoder, encode, stop, stream
from deformscope_drivers.dsa.scene import GraspScene
from tests.drivers.dsa.packets import ACK, checked, hexed

S = 1_000_000_000
PROXIMAL, DISTAL = (14, 6), (13, 6)
SHAPES = [PROXIMAL, DISTAL] * 3


def pressed(pressure_pa: float = 0.0, matrix: int = 1, row: int = 2, column: int = 3):
    """A scene with one texel pressed."""

    def scene(time_s: float) -> list[np.ndarray]:
        pads = [np.zeros(shape) for shape in SHAPES]
        pads[matrix][row, column] = pressure_pa
        return pads

    return scene


def said(double: DsaDouble, command, now_ns: int = 0, wait_ns: int = S // 5) -> list:
    """What a command is answered with."""
    double.receive(command if isinstance(command, bytes) else encode(command), now_ns)
    return list(Decoder().feed(double.due(now_ns + wait_ns)))


def frames_of(double: DsaDouble, seconds: int) -> list[messages.Reading]:
    decoder = Decoder(SDH_CELLS)
    return [
        event
        for step in range(1, 1000 * seconds + 1)
        for event in decoder.feed(double.due(step * S // 1000))
        if isinstance(event, messages.Reading)
    ]


@pytest.mark.parametrize(
    ("heard", "answer"),
    [
        (hexed("aa aa aa 03 03 00 01 00 00 2f 6a"), ACK),
        (hexed("aa aa aa 02 00 00"), hexed("aa aa aa 02 0c 00 00 00 06 00 00 00 01 e1 10 00 00 00 b2 cb")),
        (hexed("aa aa aa 03 03 00 01 00 00 2f 6b"), hexed("aa aa aa 03 02 00 0b 00 37 64")),  # a wrong checksum
        (hexed("aa aa aa 0f 06 00 00 00 00 00 40 3f 30 2a"), checked("0f 02 00 00 00")),
        (hexed("aa aa aa 13 04 00 00 00 96 00 90 cf"), checked("13 02 00 00 00")),
        (hexed("aa aa aa 14 01 00 00 03 c1"), checked("14 04 00 00 00 14 00")),
        (checked("0b 01 00 06"), checked("0b 02 00 18 00")),  # there is no seventh matrix
        (checked("ab 01 00 00"), checked("ab 02 00 0d 00")),  # nothing public
    ],
)
@pytest.mark.parametrize("size", [1, 4, 100])
def test_answers(heard: bytes, answer: bytes, size: int) -> None:
    double = DsaDouble()
    for at in range(0, len(heard), size):
        double.receive(heard[at : at + size], 0)
    assert double.due(S) == answer
    assert double.next_ns(S) is None


def test_the_sdhs_matrices() -> None:
    double = DsaDouble()
    shapes = []
    for index in range(6):
        (matrix,) = said(double, messages.QueryMatrix(index), index * S)
        assert isinstance(matrix, messages.MatrixInfo)
        assert matrix.texel_width_mm == pytest.approx(3.4)
        shapes.append((matrix.cells_y, matrix.cells_x))
    assert shapes == SHAPES
    assert sum(rows * columns for rows, columns in shapes) == 486


def test_raw_frames_fill_the_line() -> None:
    """985 bytes at 11 520 a second: 11.7 frames a second, no more."""
    double = DsaDouble()
    double.receive(encode(stream(rle=False)), 0)
    frames = frames_of(double, 10)
    assert len(frames) == (10 * 11_520 - 10) // 985 == 116
    assert {frame.flags for frame in frames} == {0}
    assert set(np.diff([frame.timestamp_ms for frame in frames]).tolist()) == {85, 86}


def test_idle_frames_are_short_and_come_thirty_times_a_second() -> None:
    double = DsaDouble(scene=pressed())
    double.receive(encode(stream()), 0)
    data = double.due(S)
    assert len(data) == 10 + 79 * 30
    assert len(list(Decoder(SDH_CELLS).feed(data))) == 1 + 30


def test_a_grasp_run_length_encoded_is_quicker_than_raw() -> None:
    double = DsaDouble()
    double.receive(encode(stream()), 0)
    frames = frames_of(double, 8)
    assert 11.7 * 8 * 1.8 < len(frames) < 30 * 8
    assert {frame.flags for frame in frames} == {1}


def test_over_tcp_raw_frames_come_thirty_times_a_second() -> None:
    double = DsaDouble(bytes_per_s=None)
    double.receive(encode(stream(rle=False)), 0)
    assert len(frames_of(double, 2)) == 60


def test_an_answer_waits_for_the_frame_that_is_being_sent() -> None:
    double = DsaDouble()
    double.receive(encode(stream(rle=False)), 0)
    double.due(S // 100)
    double.receive(encode(stop()), S // 100)
    assert list(Decoder(SDH_CELLS).feed(double.due(S)))[-1:] == [messages.Ack(3)]
    assert double.due(2 * S) == b""


def test_due_gives_the_same_bytes_however_often_it_is_asked() -> None:
    seldom, often = DsaDouble(seed=3), DsaDouble(seed=3)
    for double in (seldom, often):
        double.receive(encode(stream()), 0)
    assert seldom.due(S) == b"".join(often.due(step * S // 2000) for step in range(2001))


def test_next_ns_tells_when_to_come_back() -> None:
    double = DsaDouble(scene=pressed())
    double.receive(encode(stream()), 0)
    now_ns, found = 0, b""
    visits = 0
    while now_ns < S // 5:
        now_ns = max(double.next_ns(now_ns), now_ns + 1)
        found += double.due(now_ns)
        visits += 1
    assert len(list(Decoder(SDH_CELLS).feed(found))) == 1 + 6
    assert visits <= 2 * len(found)  # most for one byte


@pytest.mark.parametrize(("version", "reported"), [(218, 0.5), (219, 0.75)])
def test_sensitivity_read_back(version: int, reported: float) -> None:
    double = DsaDouble(software_version=version)
    assert said(double, messages.SetSensitivity(0, 1, 0.75)) == [messages.Ack(0x0F)]
    assert said(double, messages.QuerySensitivity(1), S) == [messages.SensitivityInfo(0, 2, reported, 0.5)]


def test_thresholds_need_firmware_268() -> None:
    old = DsaDouble(software_version=267)
    assert said(old, messages.QueryThreshold(0)) == [messages.Ack(0x14, 13)]
    assert said(old, messages.SetThreshold(0, 0, 5), S) == [messages.Ack(0x13, 13)]
    assert said(DsaDouble(software_version=268), messages.QueryThreshold(0)) == [messages.ThresholdInfo(0, 20)]


def test_what_is_kept_is_not_answered_and_outlives_power() -> None:
    double = DsaDouble()
    assert said(double, messages.SetThreshold(0x80, 2, 99)) == []
    assert said(double, messages.SetThreshold(0, 2, 77), S) == [messages.Ack(0x13)]
    assert said(double, messages.QueryThreshold(2), 2 * S) == [messages.ThresholdInfo(0, 77)]
    double.power_up(3 * S)
    assert said(double, messages.QueryThreshold(2), 4 * S) == [messages.ThresholdInfo(0, 99)]


@pytest.mark.parametrize("command", [messages.SetSensitivity(0, 6, 0.5), messages.SetThreshold(0, 6, 5)])
def test_settings_of_no_matrix(command) -> None:
    (answer,) = said(DsaDouble(), command)
    assert answer.error == 24


@pytest.mark.parametrize(
    "command",
    [
        messages.SetSensitivity(0, 0, 1.5),
        messages.SetSensitivity(0, 0, float("nan")),
        messages.SetThreshold(0, 0, 4096),
    ],
)
def test_settings_out_of_range(command) -> None:
    (answer,) = said(DsaDouble(), command)
    assert answer.error == 23


def test_power_up() -> None:
    double = DsaDouble(boot_s=BOOT_S)
    double.power_up(100 * S)
    double.receive(encode(stop()), 105 * S)  # nobody listens yet
    assert double.due(106_900_000_000) == b""
    assert double.due(108 * S) == b"\x1b[5n" * 3
    assert said(double, stop(), 108 * S) == [messages.Ack(3)]


def test_power_up_ends_what_was_going_on() -> None:
    double = DsaDouble()
    double.receive(encode(stream(rle=False)), 0)
    double.receive(encode(messages.SetSensitivity(0, 0, 1.0)), 0)
    double.due(S)
    double.power_up(S)
    assert double.due(5 * S) == b""
    assert said(double, messages.QuerySensitivity(0), 6 * S) == [messages.SensitivityInfo(0, 2, 0.5, 0.5)]
    (controller,) = said(double, hexed("aa aa aa 01 00 00"), 7 * S)
    assert isinstance(controller, messages.ControllerInfo)
    assert controller.status == 0x80


def test_pressures_become_counts_where_they_are() -> None:
    texels = DsaDouble(scene=pressed(1000 * SCHUNK_PA_PER_COUNT), noise_counts=0).texels(0.0)
    at = 84 + 2 * 6 + 3
    assert texels[at] == 1000
    assert texels.sum() == 1000


@pytest.mark.parametrize(("sensitivity", "counts"), [(0.5, 1000), (1.0, 2000), (0.25, 500), (0.0, 0)])
def test_sensitivity_is_a_gain(sensitivity: float, counts: int) -> None:
    double = DsaDouble(scene=pressed(1000 * SCHUNK_PA_PER_COUNT), noise_counts=0)
    double.receive(encode(messages.SetSensitivity(0x02, 0, sensitivity)), 0)
    assert double.texels(0.0).max() == counts


def test_counts_end_at_twelve_bits() -> None:
    assert DsaDouble(scene=pressed(1e6), noise_counts=0).texels(0.0).max() == 4095


@pytest.mark.parametrize(("threshold", "counts"), [(0, 150), (150, 150), (151, 0)])
def test_texels_below_the_threshold_read_nothing(threshold: int, counts: int) -> None:
    double = DsaDouble(scene=pressed(150 * SCHUNK_PA_PER_COUNT), noise_counts=0)
    double.receive(encode(messages.SetThreshold(0, 1, threshold)), 0)
    assert double.texels(0.0).max() == counts


def test_noise_is_the_seeds_and_stays_below_the_factorys_threshold() -> None:
    idle = DsaDouble(scene=pressed(), seed=1)
    loud = [DsaDouble(scene=pressed(), seed=seed) for seed in (1, 1, 2)]
    for double in loud:
        double.receive(encode(messages.SetThreshold(0x02, 0, 0)), 0)
    first, same, other = (double.texels(0.0).tolist() for double in loud)
    assert idle.texels(0.0).sum() == 0
    assert first == same != other
    assert 2 < np.std(first) < 6


def test_a_scene_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(14, 6\)"):
        DsaDouble(scene=lambda time_s: [np.zeros((13, 6))] * 6).texels(0.0)


def test_the_grasp_closes_and_opens() -> None:
    grasp = GraspScene(SHAPES, seed=5)
    open_pa, held_pa = (np.concatenate([pad.ravel() for pad in grasp(time_s)]) for time_s in (0.0, 4.0))
    tip = grasp(4.0)[Pad(0, Part.DISTAL).matrix]
    assert open_pa.max() == 0.0
    assert 1500 < held_pa.max() < 2500
    assert 5 < (tip > 0).sum() < tip.size
