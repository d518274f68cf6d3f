"""The vendor's ABI: layouts typed from the headers, functions found late, codes with names."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from deformscope_drivers.errors import CommandRefused, DeviceError, LibraryMissing, LinkLost, NotConnected
from deformscope_drivers.jaco import errors, structures
from deformscope_drivers.jaco.config import EthernetAddresses
from deformscope_drivers.jaco.device import ethernet_structure
from deformscope_drivers.jaco.double import JacoDouble
from deformscope_drivers.jaco.library import SIGNATURES, Connection, Library, api_version, call
from deformscope_drivers.jaco.structures import AngularInfo, CartesianInfo, TrajectoryPoint
from tests.drivers.jaco.benches import CBench, build
from tests.patience import PATIENCE_S

# Sizes in bytes: protocol reference section 3 (checked against the vendor's library); the last two from the headers
SIZES = {
    "CartesianInfo": 24,
    "AngularInfo": 28,
    "FingersPosition": 12,
    "CartesianPosition": 36,
    "AngularPosition": 40,
    "UserPosition": 76,
    "TrajectoryPoint": 120,
    "TrajectoryFIFO": 12,
    "JoystickCommand": 56,
    "KinovaDevice": 60,
    "SensorsInfo": 60,
    "QuickStatus": 14,
    "ForcesInfo": 52,
    "EthernetCommConfig": 40,
    "GeneralInformations": 920,
    "Zone": 248,
    "ZoneList": 2488,
}

# Codes and names typed from the published headers (Kinova.API.*CommLayerUbuntu.h, *CommandLayerUbuntu.h, KinovaTypes.h)
CODES = {
    666: "UNKNOWN_ERROR",
    1001: "ERROR_LOAD_USB_LIBRARY",
    1002: "ERROR_OPEN_METHOD",
    1003: "ERROR_WRITE_METHOD",
    1004: "ERROR_READ_METHOD",
    1005: "ERROR_READ_INT_METHOD",
    1006: "ERROR_FREE_LIBRARY",
    1007: "ERROR_JACO_CONNECTION",
    1008: "ERROR_CLAIM_INTERFACE",
    1009: "ERROR_UNKNOWN_DEVICE",
    1010: "ERROR_NOT_INITIALIZED",
    1011: "ERROR_LIBUSB_NO_DEVICE",
    1012: "ERROR_LIBUSB_BUSY",
    1013: "ERROR_LIBUSB_NOT_SUPPORTED",
    1014: "ERROR_SENDPACKET_UNKNOWN",
    1015: "ERROR_NO_DEVICE_FOUND",
    1016: "ERROR_OPERATION_INCOMPLETED",
    1017: "ERROR_RS485_INVALID_HANDLE",
    1018: "ERROR_RS485_IO_PENDING",
    1019: "ERROR_RS485_NOT_ENOUGH_MEMORY",
    1020: "ERROR_RS485_TIMEOUT",
    1021: "ERROR_FUNCTION_NOT_ACCESSIBLE",
    1022: "ERROR_COMM_TIMEOUT",
    2001: "ERROR_INIT_API",
    2002: "ERROR_LOAD_COMM_DLL",
    2003: "JACO_NACK_FIRST",
    2004: "JACO_COMM_FAILED",
    2005: "JACO_NACK_NORMAL",
    2006: "ERROR_INIT_COMM_METHOD",
    2007: "ERROR_CLOSE_METHOD",
    2008: "ERROR_GET_DEVICE_COUNT_METHOD",
    2009: "ERROR_SEND_PACKET_METHOD",
    2010: "ERROR_SET_ACTIVE_DEVICE_METHOD",
    2011: "ERROR_GET_DEVICES_LIST_METHOD",
    2012: "ERROR_SEMAPHORE_FAILED",
    2013: "ERROR_SCAN_FOR_NEW_DEVICE",
    2014: "ERROR_GET_ACTIVE_DEVICE_METHOD",
    2015: "ERROR_OPEN_RS485_ACTIVATE",
    2100: "ERROR_INVALID_PARAM",
    2101: "ERROR_API_NOT_INITIALIZED",
    2102: "ERROR_INIT_DATA_STRUCTURES_METHOD",
    5001: "ERROR_UNKNOWFILE",
    5002: "ERROR_MEMORY",
    5003: "ERROR_FILEREADING",
    9999: "ERROR_NACK_RECEIVED",
}


@pytest.mark.parametrize("name", sorted(SIZES))
def test_structures_are_as_large_as_the_vendors(name: str) -> None:
    assert ctypes.sizeof(getattr(structures, name)) == SIZES[name]


@pytest.mark.parametrize("name", sorted(SIZES))
def test_a_c_compiler_lays_them_out_alike(name: str) -> None:
    assert CBench("j2n6s300").sizeof(name) == SIZES[name]


def test_fields_are_where_a_captured_point_has_them() -> None:
    """Offsets that the vendor's own library read its values from (protocol reference: capture of a basic point)."""
    point = TrajectoryPoint()
    point.Position.CartesianPosition = CartesianInfo(0.1, 0.2, 0.3, 1.0, 2.0, 3.0)
    point.Position.HandMode = 1
    point.Position.Type = 1
    point.Position.Fingers = structures.FingersPosition(1000.0, 2000.0, 3000.0)
    raw = bytes(point)
    assert raw[0:4] == bytes.fromhex("01000000")
    assert raw[8:32] == bytes.fromhex("cdcccc3d cdcc4c3e 9a99993e 0000803f 00000040 00004040")
    assert raw[60:64] == bytes.fromhex("01000000")
    assert raw[64:76] == bytes.fromhex("00007a44 0000fa44 00803b45")


def test_every_code_of_the_headers_has_its_own_exception() -> None:
    assert {code: error.symbol for code, error in errors.VENDOR_ERRORS.items()} == CODES
    assert len({error.__name__ for error in errors.VENDOR_ERRORS.values()}) == len(CODES)


@pytest.mark.parametrize("code", sorted(CODES))
def test_an_error_says_what_happened_and_what_to_do_with_the_path_last(code: int) -> None:
    error = errors.error_of(code, "GetAngularPosition", "/opt/kinova/USBCommandLayerUbuntu.so")
    assert isinstance(error, CommandRefused)
    assert isinstance(error, DeviceError)
    assert error.code == code
    text = str(error)
    assert "GetAngularPosition" in text
    assert str(code) in text
    assert CODES[code] in text
    assert "try: " in text
    assert text.endswith("/opt/kinova/USBCommandLayerUbuntu.so")
    assert error.meaning
    assert error.remedy


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (1015, NotConnected),
        (1022, LinkLost),
        (1007, LinkLost),
        (1011, LinkLost),
        (2002, LibraryMissing),
        (2101, NotConnected),
    ],
)
def test_codes_fit_into_the_common_tree(code: int, kind: type[DeviceError]) -> None:
    assert isinstance(errors.error_of(code, "InitAPI"), kind)


def test_a_missing_communication_layer_says_where_it_has_to_be_and_when() -> None:
    text = str(errors.error_of(2002, "InitAPI", "x.so"))
    assert "LD_LIBRARY_PATH before this program starts" in text
    assert "USBCommLayerUbuntu.so" in text


@pytest.mark.parametrize("code", [0, -1, 2, 667, 1023, 1999, 2016, 2103, 123456])
def test_a_code_that_no_header_names_is_an_error_all_the_same(code: int) -> None:
    error = errors.error_of(code, "InitAPI", "x.so")
    assert type(error) is errors.UnknownCode
    assert error.code == code
    assert str(code) in str(error)


def test_a_library_that_is_not_there_says_where_it_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(LibraryMissing, match="LD_LIBRARY_PATH") as caught:
        api_version(Library(tmp_path / "no.so"))
    assert str(caught.value).endswith("no.so")
    with pytest.raises(LibraryMissing, match=r"USBCommandLayerUbuntu\.so"):
        api_version(Library())
    with pytest.raises(LibraryMissing, match=r"EthCommandLayerUbuntu\.so"):
        api_version(Library(connection="ethernet"))


def test_a_folder_stands_for_the_library_in_it(tmp_path: Path) -> None:
    (tmp_path / "USBCommandLayerUbuntu.so").symlink_to(build("usb"))
    (tmp_path / "EthCommandLayerUbuntu.so").symlink_to(build("ethernet"))
    assert api_version(Library(tmp_path)) == (5, 2, 0)
    assert api_version(Library(tmp_path, "ethernet")) == (5, 2, 0)


def test_nothing_is_loaded_before_it_is_needed(tmp_path: Path) -> None:
    Library(tmp_path / "no.so")


@pytest.mark.parametrize(("built", "asked"), [("usb", "ethernet"), ("ethernet", "usb")])
def test_the_wrong_prefix_is_reported(built: Connection, asked: Connection) -> None:
    with pytest.raises(errors.SymbolMissing, match="usb or ethernet"):
        api_version(Library(build(built), asked))


def test_a_function_that_this_library_lacks_is_reported_when_it_is_called() -> None:
    library = Library(build("usb"))
    assert api_version(library) == (5, 2, 0)
    with pytest.raises(errors.SymbolMissing, match="InitEthernetAPI"):
        call(library, "InitEthernetAPI", structures.EthernetCommConfig())


def test_the_loader_finds_it_where_ld_library_path_says(tmp_path: Path) -> None:
    (tmp_path / "USBCommandLayerUbuntu.so").symlink_to(build("usb"))
    program = "from deformscope_drivers.jaco.library import *; print(api_version(Library()))"
    path = os.pathsep.join(entry for entry in sys.path if entry)
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path), "PYTHONPATH": path}
    run = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert run.stdout.strip() == "(5, 2, 0)", run.stderr


def test_wrong_kinds_of_arguments_are_refused_by_ctypes() -> None:
    bench = CBench("j2n6s300")
    with pytest.raises(ctypes.ArgumentError):
        call(bench.functions, "SendBasicTrajectory", AngularInfo())


def test_both_doubles_offer_every_function_that_the_driver_may_call() -> None:
    usb, ethernet, python = Library(build("usb")), Library(build("ethernet"), "ethernet"), JacoDouble()
    for name in SIGNATURES:
        assert callable(python.function(name))
        assert callable(ethernet.function(name))
        if name != "InitEthernetAPI":  # the vendor's USB library has none either
            assert callable(usb.function(name))


def test_ethernet_addresses_are_in_network_order_within_native_integers() -> None:
    """As inet_addr gives them: the first byte of the address lies first in memory."""
    filled = ethernet_structure(EthernetAddresses(local_ip="192.168.100.100"))
    assert bytes(filled)[:4] == bytes([192, 168, 100, 100])
    assert bytes(filled)[8:12] == bytes([255, 255, 255, 0])
    assert bytes(filled)[16:20] == bytes([192, 168, 100, 11])
    assert (filled.localCmdport, filled.localBcastPort, filled.robotPort) == (25000, 25025, 55000)
    assert filled.rxTimeOutInMs == 1000
    bench = CBench("j2n6s300", "ethernet")
    call(bench.functions, "InitEthernetAPI", filled)
    bench.own.double_robot_ip.restype = ctypes.c_ulong
    assert bench.own.double_robot_ip() == filled.robotIpAddress
