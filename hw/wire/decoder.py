"""Decode bytes to samples, independently of the transport: bytes may come cut, repeated, damaged or not at all."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import ProtocolError
from hw.common.samples import Gap, Ints, Samples
from hw.common.transport import Header
from hw.wire import frames as wire

GIVE_UP_FRAMES = 2_000  # frames: after so many frames' bytes without a valid frame decoding is refused
OVERRUN_REASON = "the device's buffer ran over"
LOSS_REASON = "frames were lost or damaged on the way"


class FrameDecoder:
    """A decoder that turns chunks of the byte stream into samples; invalid bytes become a gap.

    A frame is valid if magic, version, channel count, stream number and CRC-32 are right and its index is the next one or a
    later one. Anything else is skipped, and the next frame is searched byte by byte.
    """

    def __init__(self, header: Header) -> None:
        """Start before the first byte; ``header`` states channels, scale and the size of frames."""
        self.header = header
        self.layout = wire.FrameLayout(header.size, len(header.scale))
        self.skipped = 0  # bytes outside valid frames
        self.repeated = 0  # frames that came twice, or belong to another stream
        self._dtype = self.layout.dtype
        self._scale = np.array(header.scale)
        self._buffered = b""
        # index of the stream's sample 0 in ``Samples``, and index within the stream of the sample expected next
        self._stream, self._offset, self._next = header.stream, 0, 0
        self._note = ""
        self._unknown: list[Gap] = []  # gaps of restarts, until samples follow them
        self._bytes_without_frame = 0

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples of the frames that the bytes complete, possibly none.

        Parameters
        ----------
        data
            The next bytes.
        stream
            The stream's number if the device was started again: its index then restarts at 0.
        note
            What happened before these bytes; the reason of the next gap.

        Raises
        ------
        ProtocolError
            No valid frame came for a long time.
        """
        self._note = note or self._note
        if stream is not None and stream != self._stream:
            self._restart(stream)
        buffer = self._buffered + data
        frames, used = self._find_valid(buffer)
        self._buffered = buffer[used:]
        self._bytes_without_frame = 0 if len(frames) else self._bytes_without_frame + len(data)
        if self._bytes_without_frame > GIVE_UP_FRAMES * self.layout.size:
            layout = f"{self.layout.channels} channels and frames of {self.layout.size} bytes"
            firmware = f"the firmware must speak version {wire.PROTOCOL_VERSION} of docs/reference/protocol.md, with {layout}"
            raise ProtocolError(f"no valid frame in {self._bytes_without_frame} bytes: {firmware}")
        return self._build_samples(frames)

    def _restart(self, stream: int) -> None:
        """Continue with another stream: the number of samples in between is unknown, and the gap takes one index."""
        if self._next:
            self._unknown.append(Gap(self._offset + self._next, -1, self._note or "the device restarted"))
            self._note = ""
        self._offset += self._next + bool(self._next)  # 1 more for the gap, unless the stream had no samples
        self._stream, self._next, self._buffered = stream, 0, b""

    def _find_valid(self, buffer: bytes) -> tuple[NDArray[np.void], int]:
        """Return the valid frames in the buffer, and the number of its bytes that were used."""
        size, position, valid_frames = self.layout.size, 0, []
        while position + size <= len(buffer):
            candidates = np.frombuffer(buffer, self._dtype, (len(buffer) - position) // size, position)
            valid_count = self._count_leading_valid(candidates, memoryview(buffer)[position:])
            valid_frames.append(candidates[:valid_count])
            position += valid_count * size
            if valid_count < len(candidates):
                next_magic = buffer.find(wire.FRAME_MAGIC, position + 1)
                if next_magic < 0:  # the last byte may be the first one of the next magic
                    next_magic = len(buffer) - buffer.endswith(wire.FRAME_MAGIC[:1])
                self.skipped += next_magic - position
                position = next_magic
        return np.concatenate(valid_frames) if valid_frames else np.empty(0, self._dtype), position

    def _count_leading_valid(self, candidates: NDArray[np.void], view: memoryview) -> int:
        """Return how many frames of the candidates are valid before the first that is not; ``view`` holds their bytes."""
        has_valid_header = (candidates["magic"] == wire.FRAME_MAGIC) & (candidates["version"] == wire.PROTOCOL_VERSION)
        has_valid_header &= candidates["channels"] == self.layout.channels
        has_valid_header &= (candidates["rows"] > 0) & (candidates["rows"] <= self.layout.rows)
        end = len(candidates) if has_valid_header.all() else int(np.argmin(has_valid_header))
        size, body = self.layout.size, self.layout.size - wire.CRC_FORMAT.size
        for k, stated in enumerate(candidates["crc"][:end].tolist()):
            if zlib.crc32(view[k * size : k * size + body]) != stated:
                return k
        return end

    def _build_samples(self, frames: NDArray[np.void]) -> Samples:
        """Return the samples of valid frames, in volts."""
        frames, begin, end = self._select_in_order(frames)
        rows = frames["rows"].astype(np.int64)
        gaps = self._list_gaps(frames, begin, end)
        if len(frames):
            self._next = int(end[-1])
        filled = np.arange(self.layout.rows) < rows[:, None]  # (frames, rows): a frame may be filled in part
        codes = frames["codes"][filled]
        flagged = (frames["flags"][:, None] & (wire.SATURATED_FLAG << np.arange(self.layout.channels))) != 0
        index: Ints = (begin[:, None] + np.arange(self.layout.rows))[filled] + self._offset
        return Samples(
            rate=self.header.rate,
            channels=self.header.channels,
            index=index,
            volts=codes * self._scale,
            saturated=(codes == wire.MIN_CODE) | (codes == wire.MAX_CODE) | np.repeat(flagged, rows, axis=0),
            gaps=gaps,
            overruns=int(np.count_nonzero(frames["flags"] & wire.OVERRUN_FLAG)),
            source=self.header.source,
        )

    def _select_in_order(self, frames: NDArray[np.void]) -> tuple[NDArray[np.void], Ints, Ints]:
        """Drop frames of other streams and those that overlap earlier ones.

        Returns
        -------
        tuple
            The other frames, the index of the first row of each, and that after its last row.
        """
        is_of_stream = (frames["stream"] == self._stream) & (frames["index"] < 2**62)  # larger ones overflow int64 in sums
        begin = frames["index"].astype(np.int64)
        end = begin + frames["rows"]
        earlier_ends = np.maximum.accumulate(np.concatenate([[self._next], np.where(is_of_stream, end, 0)]))[:-1]
        keep = is_of_stream & (begin >= earlier_ends)
        self.repeated += int(np.count_nonzero(~keep))
        return frames[keep], begin[keep], end[keep]

    def _list_gaps(self, frames: NDArray[np.void], begin: Ints, end: Ints) -> tuple[Gap, ...]:
        """Return the gaps before the frames, those of restarts first; a restart's gap is kept until samples follow it.

        ``begin`` and ``end`` are the indices of each frame's first row and of that after its last, within the stream.
        """
        if not len(begin):
            return ()
        gaps, self._unknown = self._unknown, []
        ends = np.concatenate([[self._next], end[:-1]])
        for k in np.flatnonzero(begin > ends):
            reason = OVERRUN_REASON if frames["flags"][k] & wire.OVERRUN_FLAG else self._note or LOSS_REASON
            gaps.append(Gap(int(ends[k]) + self._offset, int(begin[k] - ends[k]), reason))
        self._note = ""
        return tuple(gaps)
