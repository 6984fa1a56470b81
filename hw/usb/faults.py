"""Translate exceptions of pyusb, on every system.

errno numbers differ between Linux, macOS and Windows; libusb's own codes do not, nor do pyusb's exception classes.
"""

from __future__ import annotations

import errno

from usb.core import NoBackendError, USBError, USBTimeoutError

from hw.common.errors import (
    AccessDenied,
    Busy,
    Disconnected,
    HardwareError,
    NotFound,
    Stalled,
    Timeout,
    TransferError,
)

_BY_CODE: dict[int | None, type[HardwareError]] = {
    -1: TransferError, -3: AccessDenied, -4: Disconnected, -5: Disconnected, -6: Busy, -7: Timeout, -8: TransferError,
    -9: Stalled, -12: AccessDenied,
}  # fmt: skip
_BY_ERRNO: dict[int | None, type[HardwareError]] = {
    errno.EIO: TransferError, errno.EACCES: AccessDenied, errno.EPERM: AccessDenied, errno.ENODEV: Disconnected,
    errno.ENOENT: Disconnected, errno.EBUSY: Busy, errno.ETIMEDOUT: Timeout, errno.EPIPE: Stalled,
}  # fmt: skip
_REMEDIES = {
    Busy: "another program holds it: close that program",
    Disconnected: "it went away and did not come back: check plug and cable, then read again",
    NotFound: "plug it in, or name another with usb:SERIAL",
    Stalled: "it keeps refusing: unplug it and plug it in again",
    Timeout: "it is connected but does not respond: unplug it and plug it in again",
    TransferError: "the bus failed, again and again: try another cable or port, without a hub",
}


def classify_fault(fault: Exception) -> type[HardwareError]:
    """Return the class of ``HardwareError`` for an exception of pyusb."""
    if isinstance(fault, USBTimeoutError):
        return Timeout
    if isinstance(fault, NotImplementedError):  # LIBUSB_ERROR_NOT_SUPPORTED: Windows has no driver for it
        return AccessDenied
    if isinstance(fault, NoBackendError):
        return NotFound
    if isinstance(fault, USBError):
        return _BY_CODE.get(fault.backend_error_code) or _BY_ERRNO.get(fault.errno, TransferError)
    return TransferError


def translate_fault(fault: Exception, subject: str) -> HardwareError:
    """Translate an exception of pyusb into a ``HardwareError``, which the caller raises; ``subject`` names the device."""
    kind = classify_fault(fault)
    text = " ".join(str(fault).split()) or type(fault).__name__
    return AccessDenied(subject) if kind is AccessDenied else kind(f"{subject}: {_REMEDIES[kind]} ({text})")
