"""Every code that Kinova's library returns, as a named exception that states a remedy.

Codes and their vendor names are from Kinova's published headers (BSD-3, library 5.2.0); 1 is success. Remedies are from
the vendor's headers, from users' reports (kinova-ros) and from running the library without an arm.

VendorError                 any of them, with `code`, `symbol`, `meaning`, `remedy`
 +- UnknownCode             a code that no header names
 +- one class for each code; some are also a NotConnected, LinkLost, NoReply or LibraryMissing of the common tree"""

from typing import ClassVar

from deformscope_drivers.errors import (
    Busy,
    CommandRefused,
    DeviceError,
    LibraryMissing,
    LinkLost,
    NoReply,
    NotConnected,
)

OK = 1

_REPLUG = "unplug the arm's USB cable, wait, plug it in again; then power the arm off and on"
_REINSTALL = "install the vendor's libraries again: the parts found do not fit each other"
_COMM_LAYER = (
    "put the folder that holds the vendor's communication layer (USBCommLayerUbuntu.so or "
    "EthCommLayerUbuntu.so) into LD_LIBRARY_PATH before this program starts, or into /usr/lib: the vendor's "
    "library opens it by its bare name, so a path in the program does not help"
)


class VendorError(CommandRefused):
    """The vendor's library answered with a code that is not success.

    code: the number; symbol: its name in the vendor's header; meaning: explanation of the code; remedy: what to try"""

    code: int
    symbol: ClassVar[str] = ""
    meaning: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    vendor_code: ClassVar[int] = 0

    def __init__(self, call: str, where: object = "", code: int | None = None) -> None:
        number = self.vendor_code if code is None else code
        super().__init__(number, f"{self.symbol}: {self.meaning}", call, self.remedy, where)
        self.call = call


class UnknownCode(VendorError):
    symbol = "UNKNOWN"
    meaning = "a code that the vendor's headers do not name"
    remedy = "look the code up in the headers of the library's own version; power the arm off and on"


_CODES = """
 666 UnspecifiedFailure UNKNOWN_ERROR - something failed, the library cannot say what
1001 UsbLibraryMissing ERROR_LOAD_USB_LIBRARY missing libusb could not be loaded
1002 UsbOpenMissing ERROR_OPEN_METHOD missing the USB library has no open function
1003 UsbWriteMissing ERROR_WRITE_METHOD missing the USB library has no write function
1004 UsbReadMissing ERROR_READ_METHOD missing the USB library has no read function
1005 UsbReadIntMissing ERROR_READ_INT_METHOD missing the USB library has no interrupt read function
1006 UsbFreeMissing ERROR_FREE_LIBRARY missing the USB library has no function to free it
1007 UsbConnectionBroken ERROR_JACO_CONNECTION lost the USB connection between computer and arm is faulty
1008 UsbInterfaceClaimed ERROR_CLAIM_INTERFACE busy the USB interface could not be claimed
1009 UnknownDevice ERROR_UNKNOWN_DEVICE absent the device is of a type that the library does not know
1010 NotInitialized ERROR_NOT_INITIALIZED absent what is asked for was not initialised
1011 UsbDeviceGone ERROR_LIBUSB_NO_DEVICE lost libusb no longer finds the device
1012 UsbBusy ERROR_LIBUSB_BUSY busy libusb is busy
1013 UsbNotSupported ERROR_LIBUSB_NOT_SUPPORTED - the libusb installed cannot do this
1014 PacketNotSent ERROR_SENDPACKET_UNKNOWN lost a packet could not be sent, the reason is not known
1015 NoDeviceFound ERROR_NO_DEVICE_FOUND absent no arm was found
1016 OperationIncomplete ERROR_OPERATION_INCOMPLETED - the operation was not entirely done
1017 Rs485InvalidHandle ERROR_RS485_INVALID_HANDLE - the handle of the RS-485 passthrough is not valid
1018 Rs485Pending ERROR_RS485_IO_PENDING - an RS-485 transfer has not ended yet
1019 Rs485OutOfMemory ERROR_RS485_NOT_ENOUGH_MEMORY - not enough memory for an RS-485 transfer
1020 Rs485Timeout ERROR_RS485_TIMEOUT silent an RS-485 transfer got no answer in time
1021 FunctionNotAccessible ERROR_FUNCTION_NOT_ACCESSIBLE - the function is not available in the present mode
1022 CommunicationTimeout ERROR_COMM_TIMEOUT lost the arm did not answer in time
2001 ApiInitFailed ERROR_INIT_API absent the library could not be initialised
2002 CommLayerMissing ERROR_LOAD_COMM_DLL missing the communication layer was not found
2003 NackFirst JACO_NACK_FIRST - the arm refused the first packet of a command
2004 CommunicationFailed JACO_COMM_FAILED lost communication with the arm failed
2005 NackNormal JACO_NACK_NORMAL - the arm refused a packet
2006 CommInitMissing ERROR_INIT_COMM_METHOD missing the communication layer could not be initialised
2007 CommCloseMissing ERROR_CLOSE_METHOD missing the communication layer cannot be closed
2008 CommDeviceCountMissing ERROR_GET_DEVICE_COUNT_METHOD missing the communication layer cannot count devices
2009 CommSendPacketMissing ERROR_SEND_PACKET_METHOD missing the communication layer cannot send packets
2010 CommSetActiveDeviceMissing ERROR_SET_ACTIVE_DEVICE_METHOD missing the communication layer cannot select a device
2011 CommDeviceListMissing ERROR_GET_DEVICES_LIST_METHOD missing the communication layer cannot list devices
2012 SemaphoreFailed ERROR_SEMAPHORE_FAILED - the system semaphore could not be set up
2013 CommScanMissing ERROR_SCAN_FOR_NEW_DEVICE missing the communication layer cannot scan for devices
2014 CommGetActiveDeviceMissing ERROR_GET_ACTIVE_DEVICE_METHOD missing the communication layer lacks GetActiveDevice
2015 CommRs485Missing ERROR_OPEN_RS485_ACTIVATE missing the communication layer has no RS-485 passthrough
2100 InvalidParameter ERROR_INVALID_PARAM - a parameter is not valid
2101 ApiNotInitialized ERROR_API_NOT_INITIALIZED absent the library was not initialised, or its initialisation failed
2102 CommStructuresMissing ERROR_INIT_DATA_STRUCTURES_METHOD missing the communication layer cannot set up data
5001 UnknownFile ERROR_UNKNOWFILE - a file does not exist or is corrupt
5002 OutOfMemory ERROR_MEMORY - this computer has not enough memory
5003 FileUnreadable ERROR_FILEREADING - a file could not be read
9999 NackReceived ERROR_NACK_RECEIVED - the arm refused the command
"""
"""A line a code: number, exception, the vendor's name, the kind of the common tree that it is too, its meaning."""
_REMEDIES = {
    666: _REPLUG,
    1001: "install libusb-1.0 (Debian: apt install libusb-1.0-0)",
    1007: _REPLUG + "; another cable, a port of the computer itself, no hub, no virtual machine",
    1008: "close other programs that use the arm (ROS driver, Development Center); check the udev rule for 22cd",
    1009: "use a library of the arm's generation: this interface is for Jaco2, Mico2 and the spherical arms",
    1010: "open the arm first; check that the connection (usb or ethernet) is the one the cable has",
    1011: _REPLUG,
    1012: "close other programs that use the arm, then try again",
    1013: "install a newer libusb-1.0",
    1014: _REPLUG,
    1015: "power the arm and wait until its joystick light is steady; plug the cable into a port of the computer "
    "itself (not a virtual machine); check the udev rule for vendor 22cd; after a crash unplug and replug",
    1016: "try again; if it stays, " + _REPLUG,
    1017: "power the arm off and on: the passthrough stays active until then",
    1018: "wait and try again",
    1019: "free memory of this computer",
    1020: "power the arm off and on",
    1021: "after the RS-485 passthrough was activated the arm has to be powered off and on",
    1022: "check power and cable; with Ethernet check addresses and subnet",
    2001: "check that the arm is powered and plugged in, then try again",
    2002: _COMM_LAYER,
    2003: "try again; if it stays, power the arm off and on",
    2004: _REPLUG,
    2005: "try again; if it stays, power the arm off and on",
    2012: "another user's run may have left it: remove /dev/shm/sem.KinovaMutex once no program uses the arm",
    2100: "check the values: this is a fault of the caller, not of the arm",
    2101: "open the arm first; if opening failed, correct its first error",
    5001: "check the file's path",
    5002: "free memory of this computer",
    5003: "check the file's permissions",
    9999: "check that the arm is in a state that allows it (control started, no fault, FIFO not full)",
}
"""Remedies; a code outside the list means that the parts of the vendor's software do not fit each other."""
_KINDS = {"missing": LibraryMissing, "lost": LinkLost, "busy": Busy, "absent": NotConnected, "silent": NoReply}


def _vendor_error(line: str) -> type[VendorError]:
    """The exception class of a line of the table."""
    code, name, symbol, kind, meaning = line.split(maxsplit=4)
    bases = (VendorError,) if kind == "-" else (VendorError, _KINDS[kind])
    remedy = _REMEDIES.get(int(code), _REINSTALL)
    described = {"vendor_code": int(code), "symbol": symbol, "meaning": meaning, "remedy": remedy}
    return type(name, bases, {"__module__": __name__, "__doc__": f"{meaning.capitalize()}.", **described})


VENDOR_ERRORS = {error.vendor_code: error for error in map(_vendor_error, _CODES.strip().splitlines())}
"""The exception of each code."""
globals().update({error.__name__: error for error in VENDOR_ERRORS.values()})  # each crosses processes by its name
NoDeviceFound = VENDOR_ERRORS[1015]
CommunicationTimeout = VENDOR_ERRORS[1022]
CommLayerMissing = VENDOR_ERRORS[2002]
InvalidParameter = VENDOR_ERRORS[2100]
ApiNotInitialized = VENDOR_ERRORS[2101]
NackReceived = VENDOR_ERRORS[9999]


def error_of(code: int, call: str, where: object = "") -> VendorError:
    """The named exception of a return code that is not success; `UnknownCode` for one that no header names."""
    kind = VENDOR_ERRORS.get(code)
    return UnknownCode(call, where, code) if kind is None else kind(call, where)


class SymbolMissing(LibraryMissing):
    """The vendor's library was loaded, and lacks a function."""


class NotHomed(DeviceError):
    """The arm was not homed since it was switched on: it may ignore commands without a word (kinova-ros 62, 148)."""


class NotReached(DeviceError):
    """The arm did not get where it was sent in the time given; it was stopped."""
