"""Every code that Kinova's library returns, as a named exception that says what to do.

Codes and their vendor names are from Kinova's published headers (BSD-3, library 5.2.0); 1 is success. What to try is
from the vendor's headers, from users' reports (kinova-ros) and from running the library without an arm.

VendorError                 any of them, with `code`, `symbol`, `meaning`, `remedy`
 +- UnknownCode             a code that no header names
 +- one class for each code; some are also a NotConnected, LinkLost, NoReply or LibraryMissing of the common tree
"""

from __future__ import annotations

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
    "put the folder that holds the vendor's communication layer (USBCommLayerUbuntu.so or EthCommLayerUbuntu.so) into "
    "LD_LIBRARY_PATH before this program starts, or into /usr/lib: the vendor's library opens it by its bare name, "
    "so giving its path from inside the program does not help"
)


class VendorError(CommandRefused):
    """The vendor's library answered with a code that is not success.

    code: the number; symbol: its name in the vendor's header; meaning: what it says; remedy: what to try
    """

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


class UnspecifiedFailure(VendorError):
    vendor_code, symbol = 666, "UNKNOWN_ERROR"
    meaning = "something failed, the library cannot say what"
    remedy = _REPLUG


class UsbLibraryMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1001, "ERROR_LOAD_USB_LIBRARY"
    meaning = "libusb could not be loaded"
    remedy = "install libusb-1.0 (Debian: apt install libusb-1.0-0)"


class UsbOpenMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1002, "ERROR_OPEN_METHOD"
    meaning = "the USB library has no open function"
    remedy = _REINSTALL


class UsbWriteMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1003, "ERROR_WRITE_METHOD"
    meaning = "the USB library has no write function"
    remedy = _REINSTALL


class UsbReadMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1004, "ERROR_READ_METHOD"
    meaning = "the USB library has no read function"
    remedy = _REINSTALL


class UsbReadIntMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1005, "ERROR_READ_INT_METHOD"
    meaning = "the USB library has no interrupt read function"
    remedy = _REINSTALL


class UsbFreeMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 1006, "ERROR_FREE_LIBRARY"
    meaning = "the USB library has no function to free it"
    remedy = _REINSTALL


class UsbConnectionBroken(VendorError, LinkLost):
    vendor_code, symbol = 1007, "ERROR_JACO_CONNECTION"
    meaning = "the USB connection between computer and arm is faulty"
    remedy = _REPLUG + "; another cable, a port of the computer itself, no hub, no virtual machine"


class UsbInterfaceClaimed(VendorError, Busy):
    vendor_code, symbol = 1008, "ERROR_CLAIM_INTERFACE"
    meaning = "the USB interface could not be claimed"
    remedy = "close other programs that use the arm (ROS driver, Development Center); check the udev rule for 22cd"


class UnknownDevice(VendorError, NotConnected):
    vendor_code, symbol = 1009, "ERROR_UNKNOWN_DEVICE"
    meaning = "the device is of a type that the library does not know"
    remedy = "use a library of the arm's generation: this interface is for Jaco2, Mico2 and the spherical arms"


class NotInitialized(VendorError, NotConnected):
    vendor_code, symbol = 1010, "ERROR_NOT_INITIALIZED"
    meaning = "what is asked for was not initialised"
    remedy = "open the arm first; check that the connection (usb or ethernet) is the one the cable has"


class UsbDeviceGone(VendorError, LinkLost):
    vendor_code, symbol = 1011, "ERROR_LIBUSB_NO_DEVICE"
    meaning = "libusb no longer finds the device"
    remedy = _REPLUG


class UsbBusy(VendorError, Busy):
    vendor_code, symbol = 1012, "ERROR_LIBUSB_BUSY"
    meaning = "libusb is busy"
    remedy = "close other programs that use the arm, then try again"


class UsbNotSupported(VendorError):
    vendor_code, symbol = 1013, "ERROR_LIBUSB_NOT_SUPPORTED"
    meaning = "the libusb installed cannot do this"
    remedy = "install a newer libusb-1.0"


class PacketNotSent(VendorError, LinkLost):
    vendor_code, symbol = 1014, "ERROR_SENDPACKET_UNKNOWN"
    meaning = "a packet could not be sent, the reason is not known"
    remedy = _REPLUG


class NoDeviceFound(VendorError, NotConnected):
    vendor_code, symbol = 1015, "ERROR_NO_DEVICE_FOUND"
    meaning = "no arm was found"
    remedy = (
        "power the arm and wait until its joystick light is steady; plug the cable into a port of the computer itself "
        "(not a virtual machine); check the udev rule for vendor 22cd; after a crash unplug and replug"
    )


class OperationIncomplete(VendorError):
    vendor_code, symbol = 1016, "ERROR_OPERATION_INCOMPLETED"
    meaning = "the operation was not entirely done"
    remedy = "try again; if it stays, " + _REPLUG


class Rs485InvalidHandle(VendorError):
    vendor_code, symbol = 1017, "ERROR_RS485_INVALID_HANDLE"
    meaning = "the handle of the RS-485 passthrough is not valid"
    remedy = "power the arm off and on: the passthrough stays active until then"


class Rs485Pending(VendorError):
    vendor_code, symbol = 1018, "ERROR_RS485_IO_PENDING"
    meaning = "an RS-485 transfer has not ended yet"
    remedy = "wait and try again"


class Rs485OutOfMemory(VendorError):
    vendor_code, symbol = 1019, "ERROR_RS485_NOT_ENOUGH_MEMORY"
    meaning = "not enough memory for an RS-485 transfer"
    remedy = "free memory of this computer"


class Rs485Timeout(VendorError, NoReply):
    vendor_code, symbol = 1020, "ERROR_RS485_TIMEOUT"
    meaning = "an RS-485 transfer got no answer in time"
    remedy = "power the arm off and on"


class FunctionNotAccessible(VendorError):
    vendor_code, symbol = 1021, "ERROR_FUNCTION_NOT_ACCESSIBLE"
    meaning = "the function is not available in the present mode"
    remedy = "after the RS-485 passthrough was activated the arm has to be powered off and on"


class CommunicationTimeout(VendorError, LinkLost):
    vendor_code, symbol = 1022, "ERROR_COMM_TIMEOUT"
    meaning = "the arm did not answer in time"
    remedy = "check power and cable; with Ethernet check addresses and subnet"


class ApiInitFailed(VendorError, NotConnected):
    vendor_code, symbol = 2001, "ERROR_INIT_API"
    meaning = "the library could not be initialised"
    remedy = "check that the arm is powered and plugged in, then try again"


class CommLayerMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2002, "ERROR_LOAD_COMM_DLL"
    meaning = "the communication layer was not found"
    remedy = _COMM_LAYER


class NackFirst(VendorError):
    vendor_code, symbol = 2003, "JACO_NACK_FIRST"
    meaning = "the arm refused the first packet of a command"
    remedy = "try again; if it stays, power the arm off and on"


class CommunicationFailed(VendorError, LinkLost):
    vendor_code, symbol = 2004, "JACO_COMM_FAILED"
    meaning = "communication with the arm failed"
    remedy = _REPLUG


class NackNormal(VendorError):
    vendor_code, symbol = 2005, "JACO_NACK_NORMAL"
    meaning = "the arm refused a packet"
    remedy = "try again; if it stays, power the arm off and on"


class CommInitMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2006, "ERROR_INIT_COMM_METHOD"
    meaning = "the communication layer could not be initialised"
    remedy = _REINSTALL


class CommCloseMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2007, "ERROR_CLOSE_METHOD"
    meaning = "the communication layer has no close function"
    remedy = _REINSTALL


class CommDeviceCountMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2008, "ERROR_GET_DEVICE_COUNT_METHOD"
    meaning = "the communication layer has no function that counts devices"
    remedy = _REINSTALL


class CommSendPacketMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2009, "ERROR_SEND_PACKET_METHOD"
    meaning = "the communication layer has no function that sends packets"
    remedy = _REINSTALL


class CommSetActiveDeviceMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2010, "ERROR_SET_ACTIVE_DEVICE_METHOD"
    meaning = "the communication layer has no function that selects a device"
    remedy = _REINSTALL


class CommDeviceListMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2011, "ERROR_GET_DEVICES_LIST_METHOD"
    meaning = "the communication layer has no function that lists devices"
    remedy = _REINSTALL


class SemaphoreFailed(VendorError):
    vendor_code, symbol = 2012, "ERROR_SEMAPHORE_FAILED"
    meaning = "the system semaphore could not be set up"
    remedy = "another user's run may have left it: remove /dev/shm/sem.KinovaMutex once no program uses the arm"


class CommScanMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2013, "ERROR_SCAN_FOR_NEW_DEVICE"
    meaning = "the communication layer has no function that scans for devices"
    remedy = _REINSTALL


class CommGetActiveDeviceMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2014, "ERROR_GET_ACTIVE_DEVICE_METHOD"
    meaning = "the communication layer has no function that tells the selected device"
    remedy = _REINSTALL


class CommRs485Missing(VendorError, LibraryMissing):
    vendor_code, symbol = 2015, "ERROR_OPEN_RS485_ACTIVATE"
    meaning = "the communication layer has no RS-485 passthrough"
    remedy = _REINSTALL


class InvalidParameter(VendorError):
    vendor_code, symbol = 2100, "ERROR_INVALID_PARAM"
    meaning = "a parameter is not valid"
    remedy = "check the values: this is a fault of the caller, not of the arm"


class ApiNotInitialized(VendorError, NotConnected):
    vendor_code, symbol = 2101, "ERROR_API_NOT_INITIALIZED"
    meaning = "the library was not initialised, or its initialisation failed"
    remedy = "open the arm first; if opening failed, its first error is the one to mend"


class CommStructuresMissing(VendorError, LibraryMissing):
    vendor_code, symbol = 2102, "ERROR_INIT_DATA_STRUCTURES_METHOD"
    meaning = "the communication layer cannot set up its data"
    remedy = _REINSTALL


class UnknownFile(VendorError):
    vendor_code, symbol = 5001, "ERROR_UNKNOWFILE"
    meaning = "a file does not exist or is corrupt"
    remedy = "check the file's path"


class OutOfMemory(VendorError):
    vendor_code, symbol = 5002, "ERROR_MEMORY"
    meaning = "this computer has not enough memory"
    remedy = "free memory of this computer"


class FileUnreadable(VendorError):
    vendor_code, symbol = 5003, "ERROR_FILEREADING"
    meaning = "a file could not be read"
    remedy = "check the file's permissions"


class NackReceived(VendorError):
    vendor_code, symbol = 9999, "ERROR_NACK_RECEIVED"
    meaning = "the arm refused the command"
    remedy = "check that the arm is in a state that allows it (control started, no fault, FIFO not full)"


VENDOR_ERRORS: dict[int, type[VendorError]] = {
    error.vendor_code: error for error in VendorError.__subclasses__() if error.vendor_code
}


def error_of(code: int, call: str, where: object = "") -> VendorError:
    """The named exception of a return code that is not success; `UnknownCode` for one that no header names."""
    kind = VENDOR_ERRORS.get(code)
    return UnknownCode(call, where, code) if kind is None else kind(call, where)


class SymbolMissing(LibraryMissing):
    """The vendor's library was loaded, and lacks a function."""


class MotionStopped(DeviceError):
    """The arm was stopped, and refuses commands until someone has taken note of why."""


class NotReached(DeviceError):
    """The arm did not get where it was sent in the time given; it was stopped."""


class NotStopped(DeviceError):
    """The arm was moving and could not be told to stop."""
