"""The live waveform: what is drawn are the extremes of the samples, losses and clipping included."""

from __future__ import annotations

import json

import numpy as np

from hw.common.samples import Samples
from probe_design.explorer.waveform import COLUMNS, Waveform

RATE = 4800.0  # 40 samples a column of the last 2 s
CHANNELS = ("inner", "outer", "force")


def test_columns_hold_the_extremes_of_their_samples() -> None:
    rng = np.random.default_rng(41)
    index = np.arange(3 * 9600)
    index = index[(index < 24_000) | (index >= 24_200)]  # 200 samples are lost, five columns
    volts, saturated = rng.normal(size=(len(index), 3)), np.zeros((len(index), 3), dtype=bool)
    saturated[index == 20_000, 1] = True
    waveform = Waveform(5.0)
    for rows in np.split(np.arange(len(index)), np.sort(rng.choice(len(index), 150, replace=False))):
        waveform.add(Samples(RATE, CHANNELS, index[rows], volts[rows], saturated[rows], (), 0, {}))
    drawn = json.loads(waveform.to_json())
    assert (drawn["seconds"], [channel["name"] for channel in drawn["channels"]]) == (2.0, list(CHANNELS))
    first = 3 * 9600 // 40 - COLUMNS
    for channel, values in zip(drawn["channels"], 1e3 * volts.T, strict=True):
        for k in range(COLUMNS):
            inside = values[index // 40 == first + k]
            expected = [None, None] if not len(inside) else np.round([inside.min(), inside.max()], 4).tolist()
            assert [channel["low"][k], channel["high"][k]] == expected
    assert drawn["channels"][0]["low"].count(None) == 5
    assert drawn["clipped"] == [20_000 // 40 - first]
