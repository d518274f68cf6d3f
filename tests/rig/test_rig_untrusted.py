"""Rig files from anywhere: reading one opens and runs nothing, ends, and gives a rig or an error of one line."""

import contextlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.rig.rig_file import FILE_BYTES, SYSTEM_FOLDERS, Rig, load_rig, parse_rig, system_library
from deformscope_drivers.depth_camera.discovery import list_by_openni
from deformscope_drivers.errors import NotConnected
from deformscope_drivers.interface import DRIVERS
from deformscope_drivers.transport import SerialTransport, open_bus
from tests.cases import Capture, Patch
from tests.patience import PATIENCE_S

TIP = '[devices.tip]\ndriver = "optoforce"\nport = "/dev/ttyACM0"\n'


def refused(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_rig(text, "rig.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith("rig.toml")
    return message


PORTS = [
    "spy:///dev/null?file=made",
    "SPY:///dev/null?file=made",
    "alt:///dev/ttyUSB0?class=PosixPollSerial",
    "hwgrep://.*",
    "loop://",
    "cp2110://0",
    "file:///etc/passwd",
    "socket://host",
    "socket://host:5?logging=debug",
    "socket://host:5/../x",
    "rfc2217://host:5?logging=debug",
    " spy:///dev/null?file=made",
]
BUSES = [
    "slcan:spy:///dev/null?file=made",
    "serial:/dev/ttyUSB0",
    "seeedstudio:spy:///dev/null?file=made",
    "socketcand:host",
    "nonsense:can0",
    "socketcan:../can0",
    "virtual:lab?config_context=other",
    "udp_multicast:host.example",
    "can0",
]


@pytest.mark.parametrize("driver", ["optoforce", "dsa", "sdh"])
@pytest.mark.parametrize("port", PORTS)
def test_a_port_of_an_unlisted_kind_is_refused_before_it_is_opened(
    driver: str, port: str, tmp_path: Path, monkeypatch: Patch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "expected a device's path, socket://HOST:PORT" in refused(
        f'[devices.a]\ndriver = "{driver}"\nport = "{port}"'
    )
    with pytest.raises(NotConnected, match="another kind of port"):
        SerialTransport(port, 115_200).open()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("driver", ["optoforce", "sdh"])
@pytest.mark.parametrize("bus", BUSES)
def test_a_bus_of_an_unlisted_kind_is_refused_before_it_is_opened(
    driver: str, bus: str, tmp_path: Path, monkeypatch: Patch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "[devices.a]" in refused(f'[devices.a]\ndriver = "{driver}"\nbus = "{bus}"')
    with pytest.raises(NotConnected, match=r"expected (a bus|a channel|options)"):
        open_bus(bus, 0x100, 1_000_000)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "way",
    [
        'port = "/dev/serial/by-id/usb-OptoForce_DAQ-if00"',
        'port = "COM3"',
        'port = "socket://192.168.1.1:13000"',
        'port = "socket://[fe80::1]:23"',
        'port = "rfc2217://sensors.local:2217"',
        'bus = "socketcan:can0"',
        'bus = "virtual:bench"',
        'bus = "udp_multicast:239.74.163.2?port=43113"',
        'bus = "udp_multicast:ff15::1?hop_limit=0"',
        'bus = "pcan:PCAN_USBBUS1"',
        'bus = "kvaser:0"',
        'bus = "slcan:/dev/serial/by-id/usb-can@115200"',
    ],
)
def test_documented_ports_and_buses_are_accepted(way: str) -> None:
    assert parse_rig(f'[devices.a]\ndriver = "optoforce"\n{way}', "r").devices[0].config.port in way


@pytest.mark.parametrize("port", ["rtsp://host/a", "file:/etc/passwd", "videotestsrc ! appsink", "video0", -1])
def test_a_webcam_is_a_number_or_a_path(port: str | int) -> None:
    told = f'"{port}"' if isinstance(port, str) else port
    assert "a camera's number or path" in refused(f'[devices.a]\ndriver = "webcam"\nport = {told}')


@pytest.mark.parametrize("port", ["/dev/zero", "../secret", "a b", "./walk"])
def test_a_depth_camera_is_a_name_or_a_recording(port: str) -> None:
    assert "a camera's name, or the path" in refused(f'[devices.a]\ndriver = "depth_camera"\nport = "{port}"')


def test_a_name_that_ffmpeg_takes_for_a_protocol_is_a_file(tmp_path: Path, monkeypatch: Patch) -> None:
    """`subfile,,start,...` and the like open what comes after them."""
    monkeypatch.chdir(tmp_path)
    opened: list[str] = []

    class Capture:
        def __init__(self, path: str, _: int) -> None:
            opened.append(path)

        def isOpened(self) -> bool:
            return False

        def release(self) -> None:
            pass

    monkeypatch.setattr("cv2.VideoCapture", Capture)
    Path("concat:a|b").write_bytes(b"")
    (device,) = parse_rig('[devices.a]\ndriver = "video_file"\npath = "concat:a|b"', "r").devices
    with pytest.raises(NotConnected, match="a video"):
        device.make().open()
    assert opened == [str(tmp_path / "concat:a|b")]


@pytest.mark.parametrize("value", ["inf", "-inf", "nan", "1" + "0" * 400])
@pytest.mark.parametrize(
    "text",
    [
        TIP + "[workspace]\nlow_m = [0, 0, VALUE]\nhigh_m = [1, 1, 1]",
        TIP + "[workspace]\nhigh_m = [1, 1, VALUE]\nlow_m = [0, 0, 0]",
        TIP + "[tool]\nlength_m = VALUE",
        TIP + "[camera]\nfocal_px = [VALUE, 500]",
        TIP + "[camera]\ndistortion = [0, VALUE]",
        TIP + "[camera]\nT_arm_camera = [[1, 0, 0, VALUE], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
        TIP + "[surface]\nsize_m = [VALUE, 1]",
        TIP + "[container]\nsize_m = [VALUE, 0.1, 0.2]",
        TIP + "[squeeze]\ncurrent_a = VALUE",
        TIP + "stuck_after_s = VALUE",
        TIP + "sensitivity = { counts_at_nominal = [VALUE, 1, 1], nominal = [1, 1, 1] }",
        '[devices.a]\ndriver = "webcam"\nfps = VALUE',
        '[devices.a]\ndriver = "dsa"\nsilence_s = VALUE',
        '[devices.a]\ndriver = "depth_camera"\nspeed = VALUE',
        '[devices.a]\ndriver = "jaco"\ncommand_deadline_s = VALUE',
    ],
)
def test_every_number_is_finite(text: str, value: str) -> None:
    assert "that is finite; got inf, nan" in refused(text.replace("VALUE", value))


def test_texts_have_no_control_characters() -> None:
    assert "port without control characters" in refused(TIP.replace("ACM0", "\\u0000"))
    assert "folder without control characters" in refused(TIP + '[record]\nfolder = "a\\u001b[2J"')
    assert "keys without control characters; got '\\x1b[2J'" in refused('"\\u001b[2J" = inf')


def test_a_device_has_a_name_that_a_file_can_have() -> None:
    assert "64 at most" in refused(f'[devices.{"a" * 300}]\ndriver = "dsa"')


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 3000,
        "a = " + "[" * 300 + "]" * 300,
        "a = " + "{a=" * 3000,
        ".".join("a" * 5_000) + " = 1",
        "[devices.x]\ndriver." + ".".join("a" * 5000) + " = 1",
        "[devices.x]\ndriver = " + "[" * 100 + "]" * 100,
        "[devices.x]\ndouble = " + "[" * 100 + "]" * 100,
        "a = 1" + "0" * 5000,
        "a = 2024-13-45T99:99:99",
        "a = 0000-00-00",
        '"\\uD800" = 1',
    ],
)
def test_toml_that_its_reader_stumbles_over_is_told_in_one_line(text: str) -> None:
    assert len(refused(text)) < 500


LEAVES = st.one_of(
    st.integers(), st.floats(), st.booleans(), st.text(max_size=8), st.sampled_from(["/dev/x", "virtual:a", "0", "usb"])
)


@st.composite
def rig_texts(draw: st.DrawFn) -> str:
    """Sections and keys that a rig file may have, with values that it may not."""
    import dataclasses

    from deformscope.rig.rig_file import SECTIONS

    def toml(value: object) -> str:
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, str):
            return '"' + "".join(f"\\U{ord(c):08x}" for c in value if not 0xD800 <= ord(c) < 0xE000) + '"'
        if isinstance(value, list):
            return "[" + ", ".join(map(toml, value)) + "]"
        return repr(value)

    values = st.one_of(LEAVES, st.lists(LEAVES, max_size=4), st.lists(st.lists(LEAVES, max_size=4), max_size=4))
    driver = draw(st.sampled_from(sorted(DRIVERS)))
    section = draw(st.sampled_from(sorted(SECTIONS)))
    lines = ["[devices.a]", f'driver = "{driver}"']
    for kind, keys in ((DRIVERS[driver].config, 3), (SECTIONS[section], 2)):
        names = [field.name for field in dataclasses.fields(kind)]
        chosen = draw(st.lists(st.sampled_from(names), max_size=keys, unique=True))
        lines += [f"{name} = {toml(draw(values))}" for name in chosen]
        if kind is not SECTIONS[section]:
            lines.append(f"[{section}]")
    return "\n".join(lines)


@given(
    st.one_of(
        rig_texts(),
        st.text(max_size=60),
        rig_texts().flatmap(lambda text: st.permutations(text.split()).map("\n".join)),
    )
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_text_is_a_rig_of_devices_or_an_input_error(text: str) -> None:
    with contextlib.suppress(InputError):
        rig = parse_rig(text, "rig.toml")
        assert isinstance(rig, Rig)
        for entry in rig.devices:
            entry.make()


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path, capsys: Capture) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/zero", "/dev/null", tmp_path / "pipe", tmp_path):
        assert main(["doctor", str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "no regular file" in line
        assert line.endswith(str(path))


def test_a_file_that_is_too_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(TIP + "#" * FILE_BYTES)
    with pytest.raises(InputError, match="up to 100 kB; got a larger one"):
        load_rig(path)
    path.write_text(TIP + "#" * (FILE_BYTES - len(TIP)))
    assert load_rig(path).devices


def test_the_home_of_nobody_is_refused() -> None:
    with pytest.raises(InputError, match="a rig file"):
        load_rig("~no-such-user-here/rig.toml")


@pytest.fixture(scope="module")
def greedy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library that makes a file `loaded` beside itself as soon as it is loaded."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler; apt-get install gcc")
    folder = tmp_path_factory.mktemp("vendor")
    source = folder / "greedy.c"
    source.write_text(
        "#include <stdio.h>\n__attribute__((constructor)) static void run(void)"
        f'{{ FILE *made = fopen("{folder / "loaded"}", "w"); if (made) fclose(made); }}\n'
    )
    target = folder / "greedy.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(target), str(source)], check=True, timeout=PATIENCE_S)
    return target


@pytest.fixture
def loaded(greedy: Path) -> Path:
    """The file that says that the library was loaded; not there yet."""
    greedy.with_name("loaded").unlink(missing_ok=True)
    return greedy.with_name("loaded")


EXPLORABLE = """
[devices.arm]
driver = "jaco"
library = "LIBRARY"
open_attempts = 1
[devices.tip]
driver = "optoforce"
port = "/dev/ttyNONE"
sensitivity = { counts_at_nominal = [1.0, 1.0, 1.0], nominal = [1.0, 1.0, 1.0] }
[devices.depth]
driver = "depth_camera"
port = "none.oni"
library = "LIBRARY"
[record]
folder = "FOLDER"
"""


@pytest.fixture
def rig(greedy: Path, tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(EXPLORABLE.replace("LIBRARY", str(greedy)).replace("FOLDER", str(tmp_path)))
    return path


@pytest.mark.parametrize(
    "command",
    [["doctor"], ["record"], ["live", "--viewer", "none"], ["explore", "--yes"], ["calibrate", "arm", "--yes"]],
)
def test_a_library_from_anywhere_is_not_loaded(command: list[str], rig: Path, loaded: Path, capsys: Capture) -> None:
    assert main([*command, str(rig)]) == 2
    said = capsys.readouterr()
    assert "--trust-rig" in said.out + said.err
    assert not loaded.exists()


@pytest.mark.parametrize("driver", ["jaco", "depth_camera"])
def test_a_library_is_loaded_from_anywhere_once_the_rig_is_trusted(
    driver: str, greedy: Path, loaded: Path, tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'[devices.a]\ndriver = "{driver}"\nlibrary = "{greedy}"\n')
    assert main(["doctor", str(path)]) == 2
    assert not loaded.exists()
    assert main(["doctor", str(path), "--trust-rig"]) == 2  # it is no vendor's library
    assert loaded.exists()
    assert "FAIL  a" in capsys.readouterr().out


def test_a_double_loads_no_library(greedy: Path, loaded: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'[devices.a]\ndriver = "jaco"\ndouble = true\nlibrary = "{greedy}"\n')
    assert main(["doctor", str(path), "--seconds", "0.1"]) == 0
    assert not loaded.exists()


@pytest.fixture
def system(tmp_path: Path, monkeypatch: Patch) -> Path:
    """A folder that stands for one of the system's; the user who runs the tests stands for the administrator."""
    folder = tmp_path / "usr" / "lib"
    (folder / "vendor").mkdir(parents=True)
    for each in (folder, folder / "vendor"):
        each.chmod(0o755)
    monkeypatch.setattr("deformscope.rig.rig_file.SYSTEM_FOLDERS", (folder,))
    monkeypatch.setattr("deformscope.rig.rig_file.ADMINISTRATOR", os.getuid())
    return folder


def library_in(folder: Path) -> Path:
    path = folder / "x.so"
    path.write_bytes(b"")
    path.chmod(0o644)
    return path


def test_a_library_of_the_systems_is_taken_from_where_it_really_is(system: Path, tmp_path: Path) -> None:
    path = library_in(system / "vendor")
    link = tmp_path / "link.so"
    link.symlink_to(path)
    assert system_library(path) == path
    assert system_library(link) == path
    assert system_library(system / "none.so") == system / "none.so"  # whoever loads it says that it is missing


@pytest.mark.parametrize("writable", ["x.so", ".", ".."])
def test_a_library_that_others_could_have_put_there_is_refused(writable: str, system: Path) -> None:
    path = library_in(system / "vendor")
    changed = path if writable == "x.so" else path.parent / writable
    changed.chmod(changed.stat().st_mode | 0o002)
    with pytest.raises(InputError, match="only the administrator can change"):
        system_library(path)


def test_a_library_of_another_users_is_refused(system: Path, monkeypatch: Patch) -> None:
    path = library_in(system)
    monkeypatch.setattr("deformscope.rig.rig_file.ADMINISTRATOR", os.getuid() + 1)
    with pytest.raises(InputError, match="only the administrator can change"):
        system_library(path)


@pytest.mark.parametrize("name", ["/usr/lib/../../tmp/x.so", "x.so", ".", "/tmp/x.so"])
def test_a_path_that_leads_elsewhere_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="a vendor's library in one of /lib"):
        system_library(Path(name))


def test_a_link_out_of_the_systems_folders_is_refused(system: Path, tmp_path: Path) -> None:
    link = system / "x.so"
    link.symlink_to(library_in(tmp_path))
    with pytest.raises(InputError, match="one elsewhere"):
        system_library(link)
    link.unlink()
    link.symlink_to(link)
    with pytest.raises(InputError, match="--trust-rig"):
        system_library(link)


def test_this_systems_own_libraries_are_trusted() -> None:
    found = next((path for path in Path("/usr/lib").glob("*/libc.so.6")), None)
    if found is None or found.stat().st_uid != 0:
        pytest.skip("the C library lies elsewhere")
    assert system_library(found) == found.resolve()
    assert Path("/opt") in SYSTEM_FOLDERS  # where the example has Kinova's


def test_modules_in_the_working_folder_are_not_run(tmp_path: Path, monkeypatch: Patch) -> None:
    """The process that reads a depth camera is another interpreter."""
    monkeypatch.chdir(tmp_path)
    Path("json.py").write_text("open('ran', 'w').close()")
    monkeypatch.setattr("sys.path", [entry for entry in __import__("sys").path if entry])
    list_by_openni()
    assert not Path("ran").exists()
