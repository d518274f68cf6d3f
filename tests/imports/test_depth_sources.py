"""Distances of others: packed, raw, in several units, in files of points; what is none of them is refused by name."""

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from deformscope.cli import main
from tests.imports.test_files_and_folders import imported, refused
from tests.imports.test_import_mistakes import MS, Bag
from tests.imports.test_importing import frames_of, inspected

HIGH, WIDE = 12, 16
ROW, COLUMN = np.mgrid[0:HIGH, 0:WIDE]
TRUE_M = (0.3 + 0.6 * COLUMN / (WIDE - 1) + 0.01 * ROW).astype(np.float32)
"""A slope of 0.3 to 1.01 m."""
HEAD = struct.pack("<iff", 0, 0.0, 0.0)
A, B = 101.0 * 100.0, 1.0 - 101.0 * 100.0 / 10.0
"""Of compressed_depth_image_transport's defaults: a quantisation of 100, 10 m at most."""
CAMERA = {"focal_px": [20.0, 20.0], "center_px": [7.5, 5.5], "size_px": [WIDE, HIGH]}


def png(image: Any) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def rvl(image: Any) -> bytes:
    """As `CompressRVL` of the paper, number by number."""
    nibbles, pixels, at, previous = list[int](), image.ravel().tolist(), 0, 0

    def put(value: int) -> None:
        while True:
            nibble, value = value & 7, value >> 3
            nibbles.append(nibble | (8 if value else 0))
            if not value:
                return

    while at < len(pixels):
        zeros = at
        while at < len(pixels) and not pixels[at]:
            at += 1
        put(at - zeros)
        end = at
        while end < len(pixels) and pixels[end]:
            end += 1
        put(end - at)
        for value in pixels[at:end]:
            delta, previous = value - previous, value
            put((delta << 1) ^ (delta >> 31))
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        sum(one << 4 * (7 - place) for place, one in enumerate(nibbles[k : k + 8])) for k in range(0, len(nibbles), 8)
    ]
    return struct.pack("<II", image.shape[1], image.shape[0]) + struct.pack(f"<{len(words)}I", *words)


def millimetres() -> Any:
    counts = np.rint(TRUE_M * 1000).astype(np.uint16)
    counts[0, :3], counts[5, 7] = 0, 0
    counts[1, 0], counts[1, 1] = 65535, 1
    return counts


def inverse() -> Any:
    stored = (A / TRUE_M + B).astype(np.uint16)
    stored[0, :3] = 0
    return stored


def packed(form: str, data: bytes, topic: str = "/cam/depth") -> Bag:
    bag = Bag()
    for at in range(1, 4):
        bag.add(topic, "sensor_msgs/CompressedImage", at * MS, form, np.frombuffer(data, np.uint8))
    return bag


def raw(encoding: str, image: Any, topic: str = "/cam/depth") -> Bag:
    bag, rows = Bag(), image.reshape(len(image), -1).view(np.uint8)
    for at in range(1, 4):
        size = len(image), image.shape[1]
        bag.add(topic, "sensor_msgs/Image", at * MS, *size, encoding, 0, rows.shape[1], rows.ravel())
    return bag


def depth_map(topic: str = "/cam/depth", **keys: Any) -> str:
    more = "".join(f"{name} = {json.dumps(value).replace(':', ' =')}\n" for name, value in keys.items())
    return f'[[streams]]\ndevice = "cam"\nkind = "depth"\ntopics = ["{topic}"]\n{more}'


def first(path: Path) -> Any:
    """Distances of the first frame [m]."""
    (frames,) = frames_of(path).values()
    frame: Any = frames[0]
    return frame.depth * frame.unit_m


GOOD: dict[str, tuple[str, bytes]] = {
    "png": ("16UC1; compressedDepth png", HEAD + png(millimetres())),
    "no codec": ("16UC1; compressedDepth", HEAD + png(millimetres())),
    "no head": ("16UC1; compressedDepth png", png(millimetres())),
    "rvl": ("16UC1; compressedDepth rvl", HEAD + rvl(millimetres())),
    "compressed": ("16UC1; png compressed ", png(millimetres())),
    "spaces": (" 16UC1 ;compressedDepth  rvl ", HEAD + rvl(millimetres())),
}


@pytest.mark.parametrize("name", GOOD)
def test_counts_that_are_packed_are_millimetres(name: str, tmp_path: Path) -> None:
    source = packed(*GOOD[name]).write(tmp_path / "bag")
    text = inspected(source)
    assert 'kind = "depth"' in text
    np.testing.assert_allclose(first(imported(source, text, tmp_path / "r.rrd")), millimetres() / 1000, rtol=1e-12)


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_real_numbers_that_are_packed_are_of_the_two_numbers_of_their_head(codec: str, tmp_path: Path) -> None:
    head = struct.pack("<iff", 0, A, B)
    body = png(inverse()) if codec == "png" else rvl(inverse())
    source = packed(f"32FC1; compressedDepth {codec}", head + body).write(tmp_path / "bag")
    found = first(imported(source, inspected(source), tmp_path / "r.rrd"))
    assert not found[0, :3].any()
    expected = np.where(inverse() > 0, TRUE_M, 0.0)  # one step of the format is depth squared over A
    assert np.abs(found - expected).max() < 1.02**2 / A + 5.1e-5


def test_rvl_is_read_from_the_bytes_of_its_definition(tmp_path: Path) -> None:
    """2 zeros, 3 others: +5, +1, 0, which are 10, 2, 0; 1 zero, none. In groups: 2, 3, 2 and more, 1, 2, 0, 1, 0."""
    data = HEAD + struct.pack("<II", 3, 2) + bytes([0x10, 0x20, 0xA1, 0x23])
    source = packed("16UC1; compressedDepth rvl", data).write(tmp_path / "bag")
    found = first(imported(source, inspected(source), tmp_path / "r.rrd"))
    np.testing.assert_allclose(found, [[0, 0, 0.005], [0.006, 0.006, 0]], rtol=1e-12)


REAL_HEAD = struct.pack("<iff", 0, A, B)
BAD: dict[str, tuple[str, bytes, str]] = {
    "jpeg": (
        "16UC1; jpeg compressed ",
        cv2.imencode(".jpg", np.full((4, 4), 99, np.uint8))[1].tobytes(),
        "'16UC1; jpeg",
    ),
    "8 bits": ("16UC1; png compressed ", png(np.full((4, 4), 99, np.uint8)), "8 bits: they are lost"),
    "colour": ("rgb8; png compressed rgb8", png(np.full((4, 4, 3), 99, np.uint8)), "'rgb8; png compressed rgb8'"),
    "another codec": ("16UC1; compressedDepth zstd", HEAD, "'16UC1; compressedDepth zstd'"),
    "another encoding": ("64FC1; compressedDepth png", HEAD, "'64FC1; compressedDepth png'"),
    "no encoding": ("compressedDepth", HEAD + png(millimetres()), "'compressedDepth'"),
    "mentioned": ("jpeg of 16UC1", png(millimetres()), "'jpeg of 16UC1'"),
    "real without numbers": ("32FC1; png compressed ", png(inverse()), "'32FC1; png compressed '"),
    "an empty head": ("32FC1; compressedDepth png", HEAD + png(inverse()), "A above 0, and 16 bits; got A 0, B 0"),
    "no head": ("32FC1; compressedDepth png", png(inverse()), "a PNG after a head of 12 bytes"),
    "no image": ("16UC1; compressedDepth png", HEAD + b"\0" * 9, "a PNG after a head of 12 bytes"),
    "rvl cut": ("16UC1; compressedDepth rvl", HEAD + rvl(millimetres())[:-8], "RVL"),
    "rvl empty": ("16UC1; compressedDepth rvl", HEAD, "RVL without a width and a height"),
    "rvl of zeros": ("16UC1; compressedDepth rvl", HEAD + struct.pack("<III", 4, 4, 0), "RVL that ends"),
    "rvl too long": (
        "16UC1; compressedDepth rvl",
        HEAD + struct.pack("<III", 1, 1, 0x23A12010),
        "RVL with 5 of 1 pixels",
    ),
    "rvl of large": ("16UC1; compressedDepth rvl", HEAD + struct.pack("<II", 10**6, 10**6) + b"\0" * 8, "--largest-mb"),
    "rvl of bits": ("16UC1; compressedDepth rvl", HEAD + struct.pack("<4I", 4, 4, *([2**32 - 1] * 2)), "cam"),
    "no unit": ("mono16; compressedDepth png", HEAD + png(millimetres()), "unit_m of cam in the map: the step"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_has_lost_its_distances_is_refused_by_its_format(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    form, data, words = BAD[name]
    assert words in refused(packed(form, data).write(tmp_path / "bag"), depth_map(), tmp_path / "r.rrd", capfd)


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "8UC1"])
def test_pictures_of_8_bits_are_no_distances(encoding: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    shape = (4, 5, 3) if encoding == "rgb8" else (4, 5)
    source = raw(encoding, np.full(shape, 200, np.uint8)).write(tmp_path / "bag")
    error = refused(source, depth_map(), tmp_path / "r.rrd", capfd)
    assert "of cam" in error
    color = depth_map().replace('"depth"', '"color"')
    source = raw("16UC1", millimetres()).write(tmp_path / "counts")
    error = refused(source, color, tmp_path / "r.rrd", capfd)
    assert "expected kind of cam in the map: \"depth\", as '16UC1' has distances; got 'color'" in error


def test_a_jpeg_has_no_distances_whatever_its_unit(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "take"
    source.mkdir()
    cv2.imwrite(str(source / "1.jpg"), np.full((4, 4), 99, np.uint8))
    text = depth_map("*.jpg", unit_m=0.001, rate_hz=1.0)
    assert "8 bits: they are lost" in refused(source, text, tmp_path / "r.rrd", capfd)


def stated(bag: Bag, topic: str, unit_m: float) -> Bag:
    kind = "std_msgs/msg/Float32"
    bag.messages.append((topic, kind, 1, bag.make(kind, unit_m)))
    about = "std_msgs/msg/String"
    bag.messages.append((f"{topic}/about", about, 1, bag.make(about, "a step")))
    return bag


DEVICE = "/device_0/sensor_0/Depth_0/image/data"
UNITS = "/device_0/sensor_0/option/Depth_Units/value"


@pytest.mark.parametrize(
    ("image", "unit"),
    [
        (DEVICE, UNITS),
        ("/cam/aligned_depth_to_color/image_raw", "/cam/depth_units"),
        ("/cam/depth/image", "/cam/depth/units"),
        ("/cam/depth/image", "/depth_scale"),
    ],
)
@pytest.mark.parametrize("unit_m", [1e-4, 1e-3, 2.5e-4])
def test_counts_are_of_the_unit_that_their_camera_states(image: str, unit: str, unit_m: float, tmp_path: Path) -> None:
    counts = np.rint(TRUE_M / unit_m).astype(np.uint16)
    source = stated(raw("mono16", counts, image), unit, unit_m).write(tmp_path / "bag")
    text = "".join(f"[[streams]]{one}" for one in inspected(source).split("[[streams]]")[1:])
    np.testing.assert_allclose(first(imported(source, text, tmp_path / "r.rrd")), TRUE_M, atol=unit_m)


def test_units_that_are_unknown_or_contradict_are_asked_for(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    counts, out = np.rint(TRUE_M * 1e4).astype(np.uint16), tmp_path / "r.rrd"
    alone = raw("mono16", counts).write(tmp_path / "alone")
    text = inspected(alone)
    assert 'unit_m = "?"' in text
    words = "expected unit_m of cam_depth in the map: the step of its distances [m], which 'mono16' does not say"
    assert words in refused(alone, text, out, capfd)
    np.testing.assert_allclose(
        first(imported(alone, text.replace('"?"', "0.0001"), tmp_path / "s.rrd")), TRUE_M, atol=1e-4
    )
    other = stated(raw("mono16", counts), "/device_1/sensor_0/option/Depth_Units/value", 1e-4).write(tmp_path / "other")
    assert "0.0001 by /device_1" in refused(other, depth_map(), out, capfd)  # of another camera
    both = stated(raw("16UC1", counts, DEVICE), UNITS, 1e-4).write(tmp_path / "both")
    error = refused(both, depth_map(DEVICE), out, capfd)
    assert f"unit_m of cam in the map: the step of its distances [m]: 0.0001 by {UNITS}, 0.001 by 16UC1" in error
    np.testing.assert_allclose(
        first(imported(both, depth_map(DEVICE, unit_m=1e-4), tmp_path / "t.rrd")), TRUE_M, atol=1e-4
    )
    known = stated(raw("mono16", counts, DEVICE), UNITS, 1e-4).write(tmp_path / "known")
    assert f"0.0001 by {UNITS}; got 0.001" in refused(known, depth_map(DEVICE, unit_m=1e-3), out, capfd)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 1e2)])
def test_real_numbers_that_are_no_metres_are_asked_for(
    unit: str, factor: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    image = (TRUE_M * np.float32(factor)).astype(np.float32)
    image[0, 0], image[0, 1] = np.nan, np.inf
    source = raw("32FC1", image).write(tmp_path / "bag")
    error = refused(source, depth_map(), tmp_path / "r.rrd", capfd)
    assert (
        "expected units.data of cam in the map: one of m, cm, mm, um, nm; got 'none, and most of its distances" in error
    )
    found = first(imported(source, depth_map(units={"data": unit}), tmp_path / "s.rrd"))
    assert not found[0, :2].any()
    np.testing.assert_allclose(found[1:], TRUE_M[1:], atol=5.1e-5)


@pytest.mark.parametrize(("unit", "unit_m"), [("mm", 1e-3), ("cm", 1e-2)])
def test_a_unit_of_counts_is_their_step(
    unit: str, unit_m: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    counts = np.rint(TRUE_M / unit_m).astype(np.uint16)
    for encoding in ("16UC1", "mono16"):
        source = raw(encoding, counts).write(tmp_path / encoding)
        found = first(imported(source, depth_map(units={"data": unit}), tmp_path / f"{encoding}.rrd"))
        np.testing.assert_allclose(found, TRUE_M, atol=unit_m)
    error = refused(source, depth_map(units={"data": "N"}), tmp_path / "r.rrd", capfd)
    assert "units.data of cam in the map: one of m, cm, mm, um, nm; got 'N' | try: units" in error


def test_counts_that_would_be_far_away_are_asked_for(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """As of a camera whose step is a micrometre, or which writes 65535 where it sees nothing."""
    for name, counts in (
        ("step", np.rint(TRUE_M * 6e4).astype(np.uint16)),
        ("none", np.full((4, 4), 65535, np.uint16)),
    ):
        source = raw("16UC1", counts).write(tmp_path / name)
        error = refused(source, depth_map(), tmp_path / "r.rrd", capfd)
        assert "unit_m of cam in the map: the step of its distances; got '0.001 m, by which most of them" in error
        found = first(imported(source, depth_map(unit_m=0.001), tmp_path / f"{name}.rrd"))
        np.testing.assert_allclose(found, counts / 1000)


def unseen(source: Path, text: str, out: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """What is printed of an import in which nothing is valid."""
    capfd.readouterr()
    imported(source, text, out, status=3)
    printed = capfd.readouterr()
    assert "frames, none of which has a valid value" in printed.err
    assert "nothing valid, probably" in printed.out
    return printed.out


def test_a_stream_in_which_nothing_is_seen_is_a_loss_with_its_likely_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    dark = raw("16UC1", np.zeros((4, 4), np.uint16)).write(tmp_path / "dark")
    assert "all its values are 0" in unseen(dark, depth_map(), tmp_path / "r.rrd", capfd)
    far = raw("32FC1", np.full((4, 4), 9.0, np.float32)).write(tmp_path / "far")
    assert "beyond 65535 steps: a larger unit_m" in unseen(far, depth_map(), tmp_path / "s.rrd", capfd)
    np.testing.assert_allclose(first(imported(far, depth_map(unit_m=0.001), tmp_path / "t.rrd")), 9.0)
    write_ply(tmp_path / "away" / "1.ply", cloud() + np.array([5.0, 0.0, 0.0]))
    text = depth_map("*.ply", units={"points": "m"}, rate_hz=1.0, **CAMERA)
    assert "points outside the image: axes, focal_px" in unseen(tmp_path / "away", text, tmp_path / "u.rrd", capfd)


def test_what_is_seen_is_counted(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    image = np.full((4, 5), 500, np.uint16)
    image[:2] = 0
    source = raw("16UC1", image).write(tmp_path / "bag")
    (tmp_path / "m.toml").write_text(depth_map())
    command = ["import", str(source), "--map", str(tmp_path / "m.toml"), "--record", str(tmp_path / "r.rrd"), "--json"]
    assert main([*command, str(tmp_path / "r.json")]) == 0
    assert "3 frames (depth), 50 % of its values valid, 0.5 to 0.5 m" in capfd.readouterr().out
    seen = json.loads((tmp_path / "r.json").read_text())["seen"]["cam"]
    assert seen["valid_share"] == 0.5
    assert seen["frames_without"] == 0
    assert seen["range_m"] == [0.5, 0.5]


def test_forces_and_texels_that_are_never_numbers_are_a_loss(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "t.csv"
    source.write_text("t,a,b,c\n0,,,\n1,,,\n")
    columns = (
        'columns = {"force_x_n" = "a", "force_y_n" = "b", "force_z_n" = "c"}\nunits = {a = "N", b = "N", c = "N"}\n'
    )
    text = f'[[streams]]\ndevice = "tip"\nkind = "wrench"\ntopics = ["t.csv"]\n{columns}time = "t"\ntime_unit = "s"\n'
    unseen(source, f'{text}nan = "keep"\n', tmp_path / "r.rrd", capfd)
    pads = 'pads = [{name = "p", rows = 1, columns = 3, texel_m = [0.003, 0.003], index = 0, finger = 0, part = 0}]\n'
    columns = 'columns = {"pressure_0_pa" = "a", "pressure_1_pa" = "b", "pressure_2_pa" = "c"}\n'
    units = 'units = {a = "Pa", b = "Pa", c = "Pa"}\ntime = "t"\ntime_unit = "s"\n'
    text = f'[[streams]]\ndevice = "hand"\nkind = "tactile"\ntopics = ["t.csv"]\n{columns}{units}{pads}'
    error = refused(source, text, tmp_path / "s.rrd", capfd)
    assert 'pressures of hand that are numbers; got nothing, or NaN, in frame 0 | try: nan = "keep"' in error
    unseen(source, f'{text}nan = "keep"\n', tmp_path / "s.rrd", capfd)


def cloud() -> Any:
    """Points (N, 3) of the slope, in the frame of a camera with z along its view and y down [m]."""
    z = TRUE_M.astype(np.float64)
    return np.stack([(COLUMN - 7.5) / 20 * z, (ROW - 5.5) / 20 * z, z], axis=-1).reshape(-1, 3)


def write_ply(path: Path, points: Any) -> None:
    path.parent.mkdir()
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}end_header\n"
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())


def write_pcd(path: Path, points: Any, size: int, data: str, end: str = "\n", high: int = HIGH) -> None:
    path.parent.mkdir()
    lines = ["VERSION 0.7", "FIELDS x y z", f"SIZE {size} {size} {size}", "TYPE F F F", "COUNT 1 1 1"]
    lines += [f"WIDTH {len(points) // high}", f"HEIGHT {high}", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}"]
    body = points.astype(f"<f{size}").tobytes()
    if data == "ascii":
        body = "".join(f"{x:.9f} {y:.9f} {z:.9f}{end}" for x, y, z in points).encode()
    if data == "binary_compressed":
        columns = points.T.astype(f"<f{size}").tobytes()
        parts = [columns[at : at + 32] for at in range(0, len(columns), 32)]
        packed = b"".join(bytes([len(one) - 1]) + one for one in parts)
        body = struct.pack("<II", len(packed), len(columns)) + packed
    path.write_bytes("".join(f"{line}{end}" for line in [*lines, f"DATA {data}"]).encode() + body)


@pytest.mark.parametrize("size", [4, 8])
@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["unix", "windows"])
def test_a_pcd_is_read_in_all_its_forms(size: int, data: str, end: str, tmp_path: Path) -> None:
    write_pcd(tmp_path / "pcd" / "1.pcd", cloud(), size, data, end)
    text = depth_map("*.pcd", units={"points": "m"}, rate_hz=1.0)
    np.testing.assert_allclose(first(imported(tmp_path / "pcd", text, tmp_path / "r.rrd")), TRUE_M, atol=5.1e-5)


AXES = {"x, -y, -z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "-y, -z, x": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]}
"""Of a viewer with y up, of a robot with x ahead and z up: the camera's axes (columns) in those of the file (rows)."""


@pytest.mark.parametrize("high", [1, HIGH], ids=["unordered", "ordered"])
@pytest.mark.parametrize("axes", AXES)
def test_points_of_other_axes_are_asked_for_and_read(
    axes: str, high: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_pcd(tmp_path / "pcd" / "1.pcd", cloud() @ np.array(AXES[axes]).T, 4, "binary", high=high)
    text = depth_map("*.pcd", units={"points": "m"}, rate_hz=1.0, **CAMERA)
    if axes == "x, -y, -z" or high > 1:
        error = refused(tmp_path / "pcd", text, tmp_path / "r.rrd", capfd)
        assert "expected axes of cam in the map: points" in error
        assert 'try: axes = "x, -y, -z" in the map' in error
    found = first(imported(tmp_path / "pcd", f'{text}axes = "{axes}"\n', tmp_path / "s.rrd"))
    np.testing.assert_allclose(found, TRUE_M, atol=5.1e-5)
    wrong = f'{text}axes = "x, y"\n'
    assert "expected axes of cam in the map: x, y and z, each once" in refused(
        tmp_path / "pcd", wrong, tmp_path / "t.rrd", capfd
    )


def test_inspect_proposes_the_axes_of_a_viewer(tmp_path: Path) -> None:
    write_ply(tmp_path / "ply" / "1.ply", cloud() * [1, -1, -1])
    text = inspected(tmp_path / "ply")
    assert 'axes = "x, -y, -z"' in text
    text = text.replace('time = "?"\ntime_unit = "?"', "rate_hz = 1").replace('"?"', '"m"')
    more = "".join(f"{name} = {json.dumps(value)}\n" for name, value in CAMERA.items())
    np.testing.assert_allclose(first(imported(tmp_path / "ply", text + more, tmp_path / "r.rrd")), TRUE_M, atol=5.1e-5)
