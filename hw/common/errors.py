"""Define the errors between a probe and its samples. Each message is one line that names the remedy.

Exceptions of libusb and VISA are always raised as one of these, with the original as ``__cause__``.
"""

from __future__ import annotations

from importlib.resources import files

UDEV_RULES_FILE = "60-probe-design.rules"


class HardwareError(Exception):
    """The base of every error of this package; its text is one line."""

    exit_code = 1


class InvalidSource(HardwareError, ValueError):  # noqa: N818 - says what is invalid
    """The name of a source is not valid, or a file is not a recording."""

    exit_code = 2


class NotFound(HardwareError):  # noqa: N818
    """No such device is connected."""


class Ambiguous(HardwareError):  # noqa: N818
    """Several devices match."""

    def __init__(self, serials: list[str]) -> None:
        """Build the message from the serial numbers of the devices that match."""
        self.serials = serials
        same_serial = f"have the serial number {serials[0]}: unplug all but one"
        choose = f"are connected: choose one by its serial number, usb:{serials[0]} for the first of {', '.join(serials)}"
        super().__init__(f"{len(serials)} probes {same_serial if len(set(serials)) == 1 else choose}")


class AccessDenied(HardwareError):  # noqa: N818
    """The operating system denies this user access to the device."""

    def __init__(self, subject: str) -> None:
        """Build the message, with the udev rule as the remedy; ``subject`` names the device."""
        super().__init__(
            f"{subject}: access denied: on Linux write this rule to /etc/udev/rules.d/{UDEV_RULES_FILE} and plug the "
            "probe in again: "
            f"{read_udev_rule()} ; on Windows install the WinUSB driver for it (Zadig)"
        )


class Busy(HardwareError):  # noqa: N818
    """Another program holds the device."""


class Timeout(HardwareError):  # noqa: N818
    """The device is connected but does not respond."""


class TransferError(HardwareError):
    """The bus failed repeatedly, or samples were lost where a complete reading is needed."""


class Stalled(TransferError):  # noqa: N818
    """The device refuses a request or keeps its endpoint halted."""


class Disconnected(TransferError):  # noqa: N818
    """The device went away and did not come back."""


class ProtocolError(HardwareError):
    """The device responds, but not as the protocol specifies."""


class Overrun(HardwareError):  # noqa: N818
    """The device's own buffer overflowed: samples were lost before they reached the bus."""


def read_udev_rule() -> str:
    """Return the udev rule that lets users at the machine open the probe, from the shipped rule file."""
    text = files("hw").joinpath(UDEV_RULES_FILE).read_text(encoding="utf-8")
    return next(line for line in text.splitlines() if line and not line.startswith("#"))
