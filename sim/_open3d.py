"""The one door to Open3D, which asks for a USB library that a bare machine does not have."""

import ctypes
import sys
from types import ModuleType

import libusb_package

USB_LIBRARY = "libusb-1.0.so.0"


def load_open3d() -> ModuleType:
    """The module open3d, imported after a libusb is in the process.

    On Linux Open3D links against the system's libusb; where there is none, the copy from the package libusb-package
    is loaded first, with its symbols visible to every later library. No administrator rights are needed.
    Raises RuntimeError naming the shared library that is still missing.
    """
    if sys.platform == "linux" and "open3d" not in sys.modules:
        _preload_usb()
    try:
        import open3d
    except ImportError as error:
        raise RuntimeError(f"Open3D could not be loaded ({error}); `veo doctor` says what to install") from error
    return open3d


def _preload_usb() -> None:
    try:
        ctypes.CDLL(USB_LIBRARY, mode=ctypes.RTLD_GLOBAL)
    except OSError:
        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
