"""Measure for the bench page in a process of its own: the program of ``bench``."""

from __future__ import annotations

from collections.abc import Iterator

from geometry.common.json_types import JsonObject
from probe_design.explorer.bench_readings import Measuring
from probe_design.explorer.bench_settings import BenchSettings, DiscardRequest, PressRequest
from probe_design.explorer.messages import Message, Put, stream_messages

MEASURING: list[Measuring] = []  # the one of this process, after the first request


def run(request: BenchSettings | DiscardRequest | PressRequest) -> Iterator[Message]:
    """Yield the messages of a request: first the settings, then presses and what discards them."""

    def work(put: Put) -> JsonObject | None:
        """Carry out the request."""
        if isinstance(request, BenchSettings):
            put("progress", "preparing the map" if request.design is not None else "preparing")
            MEASURING[:] = [Measuring(request)]
            return MEASURING[0].describe()
        if isinstance(request, DiscardRequest):
            put("progress", "updating the map")
            return MEASURING[0].discard()
        return MEASURING[0].press(request, put)

    return stream_messages(work)
