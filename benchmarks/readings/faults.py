"""Make readings of a known load and put faults into them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hw.common.samples import Floats, Gap, Samples
from hw.signal.amplifier import ChargeAmplifier

RATE, FREQUENCY, SECONDS = 1000.0, 5.003, 10.0
SENSITIVITY = 0.1  # V/N
AMPLITUDES = np.array([0.9e-3, 1.6e-3, 1e-2]) * np.exp(0.4j)  # V: inner, outer, force
NOISE = 10e-6  # V
AMPLIFIER = ChargeAmplifier()
TRUTH = float((AMPLITUDES[0] / AMPLITUDES[1]).real)

Fault = Callable[[Samples, np.random.Generator], Samples]


def good(
    random: np.random.Generator, seconds: float = SECONDS, rate: float = RATE, hum: float = 0.4e-3, noise: float = NOISE,
    phase: Floats | None = None, load: Floats | None = None,
) -> Samples:  # fmt: skip
    """Return a reading with mains, drift and noise.

    Parameters
    ----------
    random
        Of noise and phases.
    seconds
        How long.
    rate
        Hz.
    hum
        Amplitude of the mains, V.
    noise
        Standard deviation of a sample, V.
    phase
        (n,) of the load beside 2 pi f t, rad.
    load
        (n,) by which its amplitude is multiplied.
    """
    index = np.arange(round(seconds * rate))
    t = index / rate
    turns = 2 * np.pi * FREQUENCY * t + random.uniform(0, 2 * np.pi) + (0 if phase is None else phase)
    wave = (np.exp(1j * turns) + 0.01 * np.exp(2j * turns)) * (1 if load is None else load)
    volts = (AMPLITUDES * wave[:, None]).real
    volts += hum * np.array([1.0, 0.7, 0.1]) * np.cos(2 * np.pi * 50.03 * t + random.uniform(0, 6))[:, None]
    volts += 1e-3 * np.array([1.0, 0.6, 0.0]) * (1 - np.exp(-t / 60))[:, None]
    volts += noise * random.standard_normal(volts.shape)
    return samples(volts, rate)


def samples(volts: Floats, rate: float = RATE) -> Samples:
    """Return volts (n, 3) as samples without a gap."""
    index = np.arange(len(volts))
    unsaturated = np.zeros(volts.shape, bool)
    return Samples(
        rate, ("inner", "outer", "force"), index=index, volts=volts, saturated=unsaturated, gaps=(), overruns=0, source={}
    )


def change_channel(channel: int, change: Callable[[Floats, Floats], Floats]) -> Fault:
    """Return a fault of one channel: ``change`` of its volts at times from 0 to 1."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        volts = whole.volts.copy()
        volts[:, channel] = change(volts[:, channel], np.linspace(0, 1, len(volts)))
        return replace(whole, volts=volts)

    return fault


def clip(share: float, *, below: bool = True) -> Callable[[Floats, Floats], Floats]:
    """Return what cuts off what exceeds a share of the largest swing, above and, if so requested, below."""

    def change(v: Floats, t: Floats) -> Floats:
        middle, swing = (v.max() + v.min()) / 2, np.ptp(v) / 2
        return np.clip(v, middle - share * swing if below else None, middle + share * swing)

    return change


def replug(seconds: float) -> Fault:
    """Return a fault: unplugged half-way, an unknown time that really is ``seconds``."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        half, lost = len(whole) // 2, round(seconds * whole.rate)
        kept = np.r_[0:half, half + lost : len(whole)]
        index = np.arange(len(kept)) + (np.arange(len(kept)) >= half)
        return replace(samples(whole.volts[kept], whole.rate), index=index, gaps=(Gap(half, -1, "unplugged"),))

    return fault


def swap_films(rows: int) -> Fault:
    """Return a fault: both films exchanged in so many consecutive rows."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        volts, start = whole.volts.copy(), int(random.integers(0, len(whole) - rows))
        volts[start : start + rows, :2] = volts[start : start + rows, 1::-1]
        return replace(whole, volts=volts)

    return fault


def drop_rows(rows: int) -> Fault:
    """Return a fault: rows that are missing half-way, and nobody says so."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        half = len(whole) // 2
        return samples(np.delete(whole.volts, np.s_[half : half + rows], axis=0), whole.rate)

    return fault


def modulate(load: Callable[[Floats], Floats] | None = None, phase: Callable[[Floats], Floats] | None = None) -> Fault:
    """Return a fault of the load itself, by its amplitude and phase at times from 0 to 1."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        t = np.linspace(0, 1, len(whole))
        seconds = len(whole) / whole.rate
        return good(random, seconds, whole.rate, phase=phase and phase(t), load=load and load(t))

    return fault


def wander_mains(reach: float) -> Fault:
    """Return a fault: mains whose phase walks by ``reach`` rad in a second, five times as strong as usual."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        walk = np.cumsum(random.standard_normal(len(whole))) * reach / np.sqrt(whole.rate)
        hum = 2e-3 * np.cos(2 * np.pi * 50.03 * whole.times + walk)
        return replace(whole, volts=whole.volts + hum[:, None] * [1.0, 0.7, 0.1])

    return fault


def add_spikes(count: int) -> Fault:
    """Return a fault: so many rows that hold anything within a volt."""

    def fault(whole: Samples, random: np.random.Generator) -> Samples:
        volts = whole.volts.copy()
        volts[random.integers(0, len(whole), count)] = random.uniform(-1, 1, (count, 3))
        return replace(whole, volts=volts)

    return fault


def scale_after(share: float, low: float, high: float) -> Callable[[Floats, Floats], Floats]:
    """Return what multiplies a signal by ``low`` before a share of the time, by ``high`` after it."""
    return lambda v, t: v * np.where(t < share, low, high)


def hold(begin: float, end: float) -> Callable[[Floats, Floats], Floats]:
    """Return what keeps a signal at its last value between two times."""
    return lambda v, t: np.where((t > begin) & (t < end), v[int(begin * len(v))], v)


FAULTS: dict[str, Fault] = {
    "good": lambda whole, random: whole,
    "replugged after 3.33 s": replug(3.33),
    "inner clips at 90 %": change_channel(0, clip(0.9)),
    "inner clips at 60 %": change_channel(0, clip(0.6)),
    "outer clips at 70 % above alone": change_channel(1, clip(0.7, below=False)),
    "inner compressed by a cube": change_channel(0, lambda v, t: v - 0.02 * v**3 / np.abs(v).max() ** 2),
    "dead zone of 5 %": change_channel(0, lambda v, t: np.sign(v) * np.maximum(np.abs(v) - 0.05 * np.abs(v).max(), 0)),
    "inner clips at 90 % of mains": lambda whole, random: change_channel(0, clip(0.9))(good(random, hum=4e-3), random),
    "outer clips at 70 % of mains": lambda whole, random: change_channel(1, clip(0.7))(good(random, hum=4e-3), random),
    "strong mains alone": lambda whole, random: good(random, hum=4e-3),
    "load stops half-way": modulate(lambda t: np.where(t < 0.5, 1.0, 0.0)),
    "load ramps to half": modulate(lambda t: 1 - 0.5 * t),
    "frequency sweeps by 2 %": modulate(phase=lambda t: 2 * np.pi * 50 * 0.02 * (t - 0.5) ** 2 / 2),
    "frequency hops by 1 %": modulate(phase=lambda t: 2 * np.pi * 50 * 0.01 * np.maximum(t - 0.5, 0)),
    "inner dead": change_channel(0, lambda v, t: 1e-5 * np.random.default_rng(1).standard_normal(len(v))),
    "inner gain ramps by 1 %": change_channel(0, lambda v, t: v * (1 + 0.01 * t)),
    "outer gain steps by 2 %": change_channel(1, scale_after(0.6, 1.0, 1.02)),
    "outer gain steps by 20 %": change_channel(1, scale_after(0.3, 1.0, 1.2)),
    "offset steps": change_channel(0, lambda v, t: v + 2e-3 * (t > 0.37)),
    "inner drops out for 0.3 s": change_channel(0, lambda v, t: np.where((t > 0.4) & (t < 0.43), 0.0, v)),
    "inner stuck for 0.1 s": change_channel(0, hold(0.6, 0.61)),
    "force stuck for 1 s": change_channel(2, hold(0.2, 0.3)),
    "films swapped in 122 rows": swap_films(122),
    "films swapped in 10 rows": swap_films(10),
    "37 rows missing unsaid": drop_rows(37),
    "a second load at 7.3 Hz": change_channel(0, lambda v, t: v + 1e-3 * np.cos(2 * np.pi * 73 * t)),
    "a second load at 5.2 Hz": change_channel(0, lambda v, t: v + 3e-4 * np.cos(2 * np.pi * 52 * t)),
    "wandering mains": wander_mains(2.0),
    "spikes in 20 rows": add_spikes(20),
    "drift of 50 mV": change_channel(0, lambda v, t: v + 0.05 * t**3),
}  # fmt: skip
