"""Read the built probe: transports, decoders and a virtual probe. Imports nothing of the other packages.

What a user calls:

    Reader    reads a probe on USB or a serial port, an oscilloscope, a recording or the virtual probe
    Samples   the result: the volts of all channels, indexed by the device's clock

>>> from hw import Reader
>>> with Reader.open("usb") as reader:  # doctest: +SKIP
...     samples = reader.collect(10.0)
"""

# Imports inside functions: numpy and usb load when a public name is used.

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from hw.common.samples import Samples
    from hw.reader import Reader

__all__ = ["Reader", "Samples"]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name == "Reader":
        from hw.reader import Reader

        return Reader
    if name == "Samples":
        from hw.common.samples import Samples

        return Samples
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names; packages are imported by their own names."""
    return sorted([*__all__, "__all__", "__doc__", "__file__", "__name__", "__path__"])
