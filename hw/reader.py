"""Read samples from any source: USB, serial port, oscilloscope, recording or virtual probe."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from hw.common.clock import Clock
from hw.common.closing import Closing
from hw.common.drain import Drain
from hw.common.errors import InvalidSource, Timeout
from hw.common.limits import ReadLimits
from hw.common.samples import Samples, join_samples
from hw.common.transport import Chunk, Decoder, Header, Transport
from hw.files.columns import ColumnMap, resolve_channel_numbers
from hw.files.open_file import is_from_other_program, open_file
from hw.files.volts import VoltsDecoder
from hw.oscilloscope.transport import ScopeTransport, WaveformDecoder
from hw.recordings.recording import Recorder, Replay
from hw.serial_port.device import SerialDevice
from hw.simulation.virtual import VirtualProbe
from hw.usb.device import UsbDevice
from hw.wire.decoder import FrameDecoder
from hw.wire.stream import StreamTransport

CLOCKED_TRANSPORTS = ("usb", "serial")  # transports that deliver samples in real time, so that arrival times check the rate
SOURCE_FORMS = "usb, usb:SERIAL, serial:PORT, visa:RESOURCE, replay:FILE"
DEFAULT_COLUMNS = ColumnMap()
DEFAULT_LIMITS = ReadLimits()


class Reader(Closing):
    """Read a probe; a context manager that releases the device at its end.

    Examples
    --------
    >>> with Reader.open("usb") as reader:  # doctest: +SKIP
    ...     samples = reader.collect(10.0, record="run.probe")
    """

    def __init__(self, transport: Transport) -> None:
        """Read from ``transport``, which this reader closes; ``open`` makes it from the name of a source."""
        self.transport = transport
        self._drain: Drain | None = None

    @classmethod
    def open(
        cls,
        source: str | VirtualProbe,
        rate: float | None = None,
        columns: ColumnMap = DEFAULT_COLUMNS,
        limits: ReadLimits = DEFAULT_LIMITS,
    ) -> Reader:
        """Open a source. A device starts to sample at the first read.

        Parameters
        ----------
        source
            ``usb`` (the only probe connected), ``usb:SERIAL``, ``serial:PORT``, ``visa:RESOURCE``, ``replay:FILE``, or a probe
            from ``hw.simulation.virtual.make_virtual_probe``.
        rate
            Requested rate per channel, Hz; by default the device's present rate.
        columns
            For a file of another program: its columns, their units and its rate.
        limits
            Memory and time that reading an HDF5 file may take.

        Raises
        ------
        HardwareError
            The source cannot be opened; the message states the remedy.
        OSError
            A recording cannot be read.
        """
        return cls(_open_transport(source, rate, columns, limits))

    @property
    def header(self) -> Header:
        """The source's header: rate, channels, scale and origin."""
        return self.transport.header

    def blocks(self, seconds: float | None = None, record: Path | str | None = None) -> Iterator[Samples]:
        """Yield blocks of samples as they arrive, for ``seconds`` or until the source ends.

        Parameters
        ----------
        seconds
            Duration by the device's own clock, gaps included; None: until the source ends.
        record
            A new file for the raw bytes, which are written before they are decoded. A full disk ends the recording, but not the
            reading; a note of the samples says so.

        Raises
        ------
        InvalidSource
            ``seconds`` is less than one sample.
        HardwareError
            The device went away, or another fault persists after recovery.
        FileExistsError
            The file ``record`` exists.
        """
        end = None if seconds is None else self._count_samples(seconds)
        if record is not None and Path(record).exists():
            raise FileExistsError(f"{record} exists")
        decoder, clock = build_decoder(self.header), Clock(self.header.rate)
        self._drain = Drain(self.transport)
        with ExitStack() as stack:
            stack.callback(self._drain.close)
            recorder: Recorder | None = None
            for chunk in self._drain:
                if record is not None and recorder is None:
                    recorder = stack.enter_context(Recorder(record, self.header))
                if recorder is not None:
                    self._record(recorder, chunk)
                block = decoder.feed(chunk.data, chunk.stream, chunk.note)
                if len(block):
                    self._note_rate_difference(clock, chunk, block)
                    yield block if end is None else block.select_before(end)
                    if end is not None and block.index[-1] >= end - 1:
                        return

    def _record(self, recorder: Recorder, chunk: Chunk) -> None:
        """Write a chunk to the recording, unless the disk has failed before."""
        if "unrecorded" in self.header.source:
            return
        try:
            recorder.write(chunk)
        except OSError as fault:
            reason = (fault.strerror or str(fault)).lower()
            self.header.source["unrecorded"] = f"the recording ends early, whole up to there: {reason}"

    def _note_rate_difference(self, clock: Clock, chunk: Chunk, block: Samples) -> None:
        """Record in the header's source, as ``clock``, that samples arrive at another rate than stated; else remove it."""
        if self.header.source.get("transport") in CLOCKED_TRANSPORTS and (difference := clock.describe_difference(chunk, block)):
            self.header.source["clock"] = difference
        else:
            self.header.source.pop("clock", None)

    @property
    def is_behind(self) -> bool:
        """Whether samples wait to be fetched, so that nothing that takes long should be done now."""
        return self._drain is not None and self._drain.is_behind

    def collect(self, seconds: float | None = None, record: Path | str | None = None) -> Samples:
        """Return all samples of ``seconds``; for the arguments see ``blocks``.

        Parameters
        ----------
        seconds
            How long; None: until the source ends.
        record
            A new file for the raw bytes.

        Raises
        ------
        Timeout
            The source ended before its first sample.
        """
        parts = list(self.blocks(seconds, record))
        if not parts:
            raise Timeout(f"no samples from {self.header.source.get('transport', 'the source')}: is the recording empty?")
        return join_samples(parts)

    def _count_samples(self, seconds: float) -> int:
        """Return the number of samples in a duration, s. Raises ``InvalidSource`` if it is less than one sample."""
        count = seconds * self.header.rate
        if not 0.5 < count < 2**62:
            raise InvalidSource(f"seconds = {seconds}: allowed: a sample, {1 / self.header.rate:g} s, or more")
        return round(count)

    def close(self) -> None:
        """Stop the stream and release the device."""
        if self._drain is not None:
            self._drain.close()
        self.transport.close()


def build_decoder(header: Header) -> Decoder:
    """Return the decoder for the kind of data that a header states.

    Raises
    ------
    InvalidSource
        The kind is unknown.
    """
    if header.kind == "frames":
        return FrameDecoder(header)
    if header.kind == "waveforms":
        return WaveformDecoder(header)
    if header.kind == "volts":
        return VoltsDecoder(header)
    raise InvalidSource(f"a recording of kind {header.kind!r}: allowed: frames, waveforms, volts")


def _open_replay(path: Path, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Open a recording, or a file of another program; only the latter may need ``columns``, the user's information."""
    if is_from_other_program(path):
        return open_file(path, columns, limits)
    if columns != DEFAULT_COLUMNS:
        raise InvalidSource(f"{path} states its columns and its rate itself: allowed: no --column and no --rate")
    return Replay(path)


def _open_transport(source: str | VirtualProbe, rate: float | None, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Open the transport that ``source`` names, in one of SOURCE_FORMS, or that reads a virtual probe."""
    if isinstance(source, VirtualProbe):
        return StreamTransport(UsbDevice(source.serial, source), rate)
    kind, _, name = source.partition(":")
    if kind == "usb":
        return StreamTransport(UsbDevice(name or None), rate)
    if kind == "serial" and name:
        return StreamTransport(SerialDevice(name), rate)
    if kind == "visa" and name:
        return ScopeTransport.open(name, resolve_channel_numbers(columns), rate)
    if kind == "replay" and name:
        return _open_replay(Path(name), columns if rate is None else replace(columns, rate=rate), limits)
    raise InvalidSource(f"source {source!r}: allowed: {SOURCE_FORMS}")
