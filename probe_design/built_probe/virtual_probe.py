"""Simulate a probe: the signals of its channels under a sinusoidal load, from the solver's prediction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from hw.common.samples import Complexes
from hw.signal.amplifier import ChargeAmplifier
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import compute_inner_fractions, predict_log_ratios
from solver.results.result import Result

Matrix = tuple[tuple[float, float], tuple[float, float]]
SAMPLE_RATE_HZ = 1000.0  # Hz
VOLTS_PER_COUNT = 2e-6  # V per count of the converter


@dataclass(frozen=True)
class BuiltProperties:
    """The true properties of the virtual probe and its bench, which readings have to determine.

    Attributes
    ----------
    gains
        M of eq. BP.1 of ``probe_design.built_probe.gains`` by the films alone.
    resistance, capacitance
        Of each amplifier, relative to the nominal.
    force
        True over nominal sensitivity of the force channel.
    frequency
        True over nominal frequency of the load.
    noise
        Standard deviation of a sample, V.
    hum
        Amplitude of the mains, V, at ``mains`` Hz.
    drift
        Over the first minute, V.
    offsets
        Of the three channels, V.
    """

    gains: Matrix = ((1.04, 0.012), (0.008, 0.96))
    resistance: tuple[float, float] = (1.03, 0.98)
    capacitance: tuple[float, float] = (1.01, 0.985)
    force: float = 1.003
    frequency: float = 1.0004
    noise: float = 10e-6
    hum: float = 0.4e-3
    mains: float = 50.03
    drift: float = 1e-3
    offsets: tuple[float, float, float] = (0.3e-3, -0.2e-3, 0.1e-3)

    def build_amplifiers(self, nominal: tuple[ChargeAmplifier, ChargeAmplifier]) -> tuple[ChargeAmplifier, ChargeAmplifier]:
        """Return both amplifiers as built."""
        inner, outer = (
            replace(
                amplifier,
                resistance=amplifier.resistance * resistance_factor,
                capacitance=amplifier.capacitance * capacitance_factor,
            )
            for amplifier, resistance_factor, capacitance_factor in zip(nominal, self.resistance, self.capacitance, strict=True)
        )
        return inner, outer


def build_signals(
    built: BuiltProperties, bench: Bench, scene: Scene, forces: Floats | Complexes, seed: int | list[int]
) -> Callable[[Floats], Floats]:
    """Build the function from times (s, shape (n,)) to volts of inner, outer and force channel, shape (n, 3).

    The noise continues from call to call: read a stream in order and once.

    Parameters
    ----------
    built
        True properties.
    bench
        Nominal properties.
    scene
        For its film.
    forces
        Amplitudes of both films' forces, N, perhaps complex, shape (2,).
    seed
        Of the noise.
    """
    frequency = built.frequency * bench.load.frequency
    charges = compute_charge_per_force(scene) * np.array(built.gains) @ forces
    amplifiers = built.build_amplifiers(bench.amplifier.build_films())
    sensitivity = built.force * (0.0 if bench.force is None else bench.force.sensitivity)
    fundamental, second_harmonic = (
        np.append(charges * [amplifier.response(k * frequency) for amplifier in amplifiers], sensitivity * forces.sum())
        for k in (1, 2)
    )
    random = np.random.default_rng(seed)

    def compute_volts(times: Floats) -> Floats:
        """Return the volts of inner, outer and force channel at times, s, shape (n, 3)."""
        # 0.7 rad: an arbitrary phase; factors: the force channel has little hum and no drift, the outer film less than the inner
        wave = np.exp(2j * np.pi * frequency * times[:, None] + 0.7j)
        load = (fundamental * wave + 0.01 * second_harmonic * wave**2).real  # with a second harmonic of 1 %
        hum = built.hum * np.array([1.0, 0.7, 0.1]) * np.cos(2 * np.pi * built.mains * times)[:, None]
        drift = built.drift * np.array([1.0, 0.6, 0.0]) * (1 - np.exp(-times / 60.0))[:, None]
        noise = built.noise * random.standard_normal((len(times), 3))
        return np.asarray(load + hum + drift + noise + np.array(built.offsets))

    return compute_volts


def compute_charge_per_force(scene: Scene) -> float:
    """Return the nominal charge per force, C/N, of the scene's film, or of the default film if it has none."""
    return (scene.probe.film or Film()).charge_per_force


def draw_delivered(reference: Reference, random: np.random.Generator) -> Reference:
    """Draw a reference block's true modulus from its tolerance."""
    if reference.youngs_modulus is None:
        return reference
    factor = float(np.exp(reference.tolerance * random.standard_normal()))
    return reference.model_copy(update={"youngs_modulus": reference.youngs_modulus * factor})


@dataclass(frozen=True)
class VirtualBench:
    """A virtual probe on a virtual bench.

    Attributes
    ----------
    drawn
        The scene with the probe as drawn.
    scene
        The scene with the probe as built.
    bench
        Nominal properties.
    built
        True properties of channels and amplifiers.
    seed
        Of noise, and of the blocks' true moduli.
    """

    drawn: Scene
    scene: Scene
    bench: Bench
    built: BuiltProperties = BuiltProperties()
    seed: int = 0

    def build_scene_signals(self, result: Result) -> Callable[[Floats], Floats]:
        """Build the signals on the scene's tissue, as a function of time, from the scene's evaluated result."""
        if result.stress_inner is None or result.stress_outer is None:
            raise Refusal("scene", result.evaluator, "one whose film stresses are computed")
        probe = self.scene.probe
        inner = result.stress_inner * np.exp(1j * (result.ratio_phase or 0.0))
        forces = np.array([inner * probe.inner_area, result.stress_outer * probe.outer_area])
        x, y = self.scene.placement.x, self.scene.placement.y
        # the bits of the position seed the noise
        return self._build_signals(
            forces, 0, *np.array([x, y], dtype=np.float32).view(np.uint32).tolist()
        )  # other noise elsewhere

    def build_reference_signals(self, load: float, run: int = 0) -> tuple[Callable[[Floats], Floats], ...]:
        """Build the signals on each reference under a load, N, or the reference's known one; each run has other noise."""
        random = np.random.default_rng(self.seed)
        delivered = [draw_delivered(item, random) for item in self.bench.reference]
        fractions = compute_inner_fractions(predict_log_ratios(self.scene, delivered), delivered)
        loads = np.array([item.known_force or load for item in delivered])
        forces = loads[:, None] * np.stack([fractions, 1 - fractions], axis=1)
        return tuple(self._build_signals(item, 1 + run * len(forces) + k) for k, item in enumerate(forces))

    def _build_signals(self, forces: Floats | Complexes, *run: int) -> Callable[[Floats], Floats]:
        """Build the signals under both films' forces, N; each tuple of numbers ``run`` has its own noise."""
        return build_signals(self.built, self.bench, self.drawn, forces, [self.seed, *run])


def compute_load(scene: Scene, stiffness: float | None) -> float:
    """Return the amplitude of the scene's load, N.

    Raises
    ------
    Refusal
        The load is zero, or an indentation of unknown stiffness.
    """
    load = scene.load.force
    if load is None and stiffness is not None:
        load = stiffness * (scene.load.indentation or 0.0)
    if not load:
        raise Refusal("load", Words("zero or unknown"), "a load above 0, for a virtual probe")
    return load
