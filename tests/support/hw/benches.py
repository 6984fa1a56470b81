"""A virtual probe on the built-in bench: samples without a reader between, predictions computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from hw.common.samples import Samples
from probe_design.built_probe import calibration
from probe_design.built_probe.bench import Bench, Workshop, read_builtin_bench
from probe_design.built_probe.block_predictions import BlockPredictions, express_by_outer_radius, predict_blocks
from probe_design.built_probe.film_forces import measure_strict_reading
from probe_design.built_probe.gains import Gains
from probe_design.probe_check import check as probe_check
from tests.support.paths import SCENE

BENCH = read_builtin_bench().model_copy(update={"workshop": Workshop(length=20e-6)})  # moulds that were measured
LOAD = 0.1  # N, whose finite strain these simulated films do not have
ROWS, RATE = 2500, 500.0  # 25 cycles of 5 Hz


@lru_cache
def scene() -> Scene:
    return express_by_outer_radius(read_scene(SCENE))


@lru_cache
def shares() -> BlockPredictions:
    shares = predict_blocks(scene(), BENCH.reference)
    return replace(shares, blocks=tuple(replace(block, rule=None) for block in shares.blocks))


def films(log_ratios: Floats, bench: Bench = BENCH) -> list[Floats]:
    """Film forces on each reference under LOAD, N, from ln(F_inner / F_outer) on the blocks."""
    logs = iter(log_ratios)
    inner = [{"inner": 1.0, "outer": 0.0}.get(reference.on) for reference in bench.reference]
    parts = [1 / (1 + np.exp(-next(logs))) if share is None else share for share in inner]
    return [LOAD * np.array([part, 1 - part]) for part in parts]


def sampled(signals: Callable[[Floats], Floats], rows: int = ROWS, rate: float = RATE, channels: int = 3) -> Samples:
    index = np.arange(rows)
    volts = signals(index / rate)[:, :channels]
    names = ("inner", "outer", "force")[:channels]
    return Samples(
        rate,
        names,
        index=index,
        volts=volts,
        saturated=np.zeros(volts.shape, bool),
        gaps=(),
        overruns=0,
        source={"transport": "simulated"},
    )


def calibrate(drawn: Scene, bench: Bench, samples: Sequence[Samples], *shares: BlockPredictions) -> calibration.Calibration:
    """Calibrate from samples on each reference."""
    return calibration.calibrate(drawn, bench, [measure_strict_reading(item, bench, drawn) for item in samples], *shares)


def check(drawn: Scene, bench: Bench, samples: Sequence[Samples], *gains: Gains, **settings: Any) -> probe_check.Check:
    """Check a probe by samples on each block of tissue."""
    measurements = [measure_strict_reading(item, bench, drawn) for item in samples]
    return probe_check.check(drawn, bench, measurements, *gains, **settings)
