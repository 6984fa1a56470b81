"""The reader: one way to samples, whatever they come from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from hw.common.errors import InvalidSource, Timeout
from hw.common.samples import Samples, joined
from hw.common.transport import Decoder, Header, Transport
from hw.foreign.columns import ColumnMap, channel_numbers
from hw.foreign.files import HDF5, is_foreign, replayed
from hw.foreign.hdf5_recording import Hdf5Recorder
from hw.foreign.volts import VoltsDecoder
from hw.oscilloscope.transport import ScopeTransport, WaveformDecoder
from hw.recordings.recording import Recorder
from hw.recordings.replay import Replay
from hw.serial_port.transport import SerialTransport
from hw.simulation.virtual import Virtual
from hw.usb.transport import UsbTransport
from hw.wire.decoder import Format, FrameDecoder

SOURCES = "usb, usb:SERIAL, serial:PORT, visa:RESOURCE, replay:FILE"
AS_IT_IS = ColumnMap()


class Reader:
    """Reads a probe; a context manager that lets go of the device at its end.

    Example:
        >>> with Reader.open("usb") as reader:  # doctest: +SKIP
        ...     samples = reader.collect(10.0, record="run.probe")
    """

    def __init__(self, transport: Transport) -> None:
        self.transport = transport

    @classmethod
    def open(cls, source: str | Virtual, rate: float | None = None, columns: ColumnMap = AS_IT_IS) -> Reader:
        """Open a source and start it.

        Args:
            source: ``usb`` (the only probe connected), ``usb:SERIAL``, ``serial:PORT``, ``visa:RESOURCE``, ``replay:FILE``, or a
                ``hw.simulation.virtual.virtual`` probe.
            rate: Hz per channel that a device is asked for; by default the rate it has.
            columns: which columns of a file of another program are meant, what they are worth and at which rate.

        Raises:
            HardwareError: one of its family, saying what to do.
            OSError: a recording that cannot be read.
        """
        return cls(_transport(source, rate, columns))

    @property
    def header(self) -> Header:
        """Return rate, channels, scale and source."""
        return self.transport.header

    def blocks(self, seconds: float | None = None, record: Path | str | None = None) -> Iterator[Samples]:
        """Yield samples as they come, until the index has gone on by ``seconds`` or the source ends.

        Args:
            seconds: how long, by the device's own clock, gaps included; None: until the source ends.
            record: a new file for the raw bytes, which get there before they are decoded; one that ends in .h5 or .hdf5 takes
                the samples instead, and gets its name when it is whole.

        Raises:
            InvalidSource: less than one sample.
            HardwareError: the device went away, or another trouble that recovery did not end.
            FileExistsError: there is a file where the recording would go.
        """
        end = None if seconds is None else self._samples_in(seconds)
        decoder = decoder_of(self.header)
        with ExitStack() as stack:
            recorder = None if record is None else stack.enter_context(_recorder(record, self.header))
            while (chunk := self.transport.read()) is not None:
                if isinstance(recorder, Recorder):
                    recorder.write(chunk)
                block = decoder.feed(chunk.data, chunk.stream, chunk.note)
                if len(block):
                    asked = block if end is None else block.before(end)
                    if isinstance(recorder, Hdf5Recorder):
                        recorder.write_samples(asked)
                    yield asked
                    if end is not None and block.index[-1] >= end - 1:
                        return

    def collect(self, seconds: float | None = None, record: Path | str | None = None) -> Samples:
        """Return all samples of ``seconds``; for the arguments see ``blocks``.

        Args:
            seconds: how long; None: until the source ends.
            record: a new file for the raw bytes.

        Raises:
            Timeout: the source ended before its first sample.
        """
        parts = list(self.blocks(seconds, record))
        if not parts:
            raise Timeout(f"no samples from {self.header.source.get('transport', 'the source')}: is the recording empty?")
        return joined(parts)

    def _samples_in(self, seconds: float) -> int:
        count = seconds * self.header.rate
        if not 0.5 < count < 2**62:
            raise InvalidSource(f"seconds = {seconds}: allowed: a sample, {1 / self.header.rate:g} s, or more")
        return round(count)

    def close(self) -> None:
        """Stop the stream and let go of the device."""
        self.transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def decoder_of(header: Header) -> Decoder:
    """Return the decoder that a header asks for.

    Raises:
        InvalidSource: none does.
    """
    if header.kind == "frames":
        return FrameDecoder(Format(header.rate, header.scale, header.size, header.stream), header.source)
    if header.kind == "waveforms":
        return WaveformDecoder(header)
    if header.kind == "volts":
        return VoltsDecoder(header)
    raise InvalidSource(f"a recording of kind {header.kind!r}: allowed: frames, waveforms, volts")


def _recorder(record: Path | str, header: Header) -> Recorder | Hdf5Recorder:
    return Hdf5Recorder(record, header) if Path(record).suffix.lower() in HDF5 else Recorder(record, header)


def _replay(path: Path, columns: ColumnMap) -> Transport:
    if is_foreign(path):
        return replayed(path, columns)
    if columns != AS_IT_IS:
        raise InvalidSource(f"{path} tells its columns and its rate itself: allowed: no --column and no --rate")
    return Replay(path)


def _transport(source: str | Virtual, rate: float | None, columns: ColumnMap) -> Transport:
    if isinstance(source, Virtual):
        return UsbTransport(source.serial, rate, backend=source)
    kind, _, name = source.partition(":")
    if kind == "usb":
        return UsbTransport(name or None, rate)
    if kind == "serial" and name:
        return SerialTransport(name, rate)
    if kind == "visa" and name:
        return ScopeTransport.open(name, channel_numbers(columns), rate)
    if kind == "replay" and name:
        return _replay(Path(name), columns if rate is None else replace(columns, rate=rate))
    raise InvalidSource(f"source {source!r}: allowed: {SOURCES}")
