"""Simulate a probe: the signals of its channels under a sinusoidal load, from the solver's prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from hw.common.samples import Complexes
from hw.signal.amplifier import ChargeAmplifier
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import build_block_scene, express_by_outer_radius, solve_block
from probe_design.built_probe.loaded_blocks import PressedReference, find_departure, find_linear_limit, find_reference_load
from probe_design.built_probe.reference_charges import (
    compute_charge_units,
    compute_pin_charge,
    find_bond_log_sd,
    find_pin_load,
    scale_bonds,
)
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import build_load_rule
from solver.results.film_charges import reads_film_states
from solver.results.result import Result

Matrix = tuple[tuple[float, float], tuple[float, float]]
BOND_STREAM = 1_000_003  # of random numbers: that of the bonds' modulus, apart from those of noise and blocks
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
    built: BuiltProperties,
    bench: Bench,
    scene: Scene,
    forces: Floats | Complexes,
    seed: int | list[int],
    *,
    load: float | complex | None = None,
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
        For its film, as drawn.
    forces
        Amplitudes of both films' forces, N, perhaps complex, shape (2,); where readings are charges, these over
        ``reference_charges.compute_charge_units`` of the scene.
    seed
        Of the noise.
    load
        Amplitude of the load, N; None for the sum of ``forces``.
    """
    frequency = built.frequency * bench.load.frequency
    charges = compute_charge_units(scene) * (np.array(built.gains) @ forces)
    amplifiers = built.build_amplifiers(bench.amplifier.build_films())
    sensitivity = built.force * (0.0 if bench.force is None else bench.force.sensitivity)
    total = forces.sum() if load is None else load
    fundamental, second_harmonic = (
        np.append(charges * [amplifier.response(k * frequency) for amplifier in amplifiers], sensitivity * total) for k in (1, 2)
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


def read_delivered(scene: Scene) -> Scene:
    """Return a scene whose readings are what its films deliver: charges, even where stresses are to be read.

    Only films without a stack, or by eq. (12), deliver multiples of forces.
    """
    return scene.replace({"reading.observable": "charge"}) if scene.models_charges else scene


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
        The scene with the probe as built, but for the modulus of the films' bonds, see ``as_built``.
    bench
        Nominal properties.
    built
        True properties of channels and amplifiers.
    seed
        Of noise, of the blocks' true moduli and of that of the films' bonds.
    log_bonds
        ln of the factor on the moduli of the films' bonds; None: it is drawn from their spread.
    """

    drawn: Scene
    scene: Scene
    bench: Bench
    built: BuiltProperties = BuiltProperties()
    seed: int = 0
    log_bonds: float | None = None

    @cached_property
    def as_built(self) -> Scene:
        """The scene with the probe as built, the modulus of its films' bonds drawn from their spread; see ``read_delivered``."""
        scene = read_delivered(self.scene)
        if not scene.models_charges:
            return scene
        draw = float(np.random.default_rng([self.seed, BOND_STREAM]).standard_normal())
        return scale_bonds(scene, find_bond_log_sd(self.drawn) * draw if self.log_bonds is None else self.log_bonds)

    def build_scene_signals(self, result: Result) -> Callable[[Floats], Floats]:
        """Build the signals on the scene's tissue, as a function of time, from the evaluated result of ``as_built``."""
        if result.stress_inner is None or result.stress_outer is None:
            raise Refusal("scene", result.evaluator, "one whose film stresses are computed")
        probe, phase = self.scene.probe, np.exp(1j * (result.ratio_phase or 0.0))
        forces = np.array([result.stress_inner * probe.inner_area, result.stress_outer * probe.outer_area])
        load = complex(forces @ [phase, 1.0])
        if self.scene.models_charges:
            if result.charge_inner is None or result.charge_outer is None:
                raise Refusal("scene", result.evaluator, "one whose films' charges are computed")
            forces = np.array([result.charge_inner, result.charge_outer]) / compute_charge_units(self.drawn)
        x, y = self.scene.placement.x, self.scene.placement.y
        # the bits of the position seed the noise
        place = np.array([x, y], dtype=np.float32).view(np.uint32).tolist()  # other noise elsewhere
        return self._build_signals(forces * [phase, 1.0], load, 0, *place)

    def build_reference_signals(self, load: float, run: int = 0) -> tuple[Callable[[Floats], Floats], ...]:
        """Build the signals on each reference; each run has other noise.

        References are pressed by their known load, or by ``load``, N, and blocks by no more than
        ``loaded_blocks.find_reference_load`` of the drawing.
        """
        random = np.random.default_rng(self.seed)
        delivered = [draw_delivered(item, random) for item in self.bench.reference]
        loads = [item.known_force or find_pressing_load(self.drawn, item, load) for item in self.bench.reference]
        films = self.compute_film_readings(delivered, loads)
        return tuple(
            self._build_signals(force * reading, force, 1 + run * len(films) + k)
            for k, (force, reading) in enumerate(zip(loads, films, strict=True))
        )

    def compute_film_readings(self, delivered: Sequence[Reference], loads: Sequence[float]) -> Floats:
        """Compute the forces on both films per load, N, on references with their true moduli, shape (references, 2).

        Where films deliver charges, these are the charges over the drawing's unit of charge per force.
        """
        probe = express_by_outer_radius(self.as_built)
        unit = compute_charge_units(self.drawn) if self.scene.models_charges else 1.0
        return np.array([_read_films(probe, item, load) for item, load in zip(delivered, loads, strict=True)]) / unit

    def _build_signals(self, forces: Floats | Complexes, load: float | complex, *run: int) -> Callable[[Floats], Floats]:
        """Build the signals under both films' forces and their load, N; each tuple of numbers ``run`` has its own noise."""
        return build_signals(self.built, self.bench, self.drawn, forces, [self.seed, *run], load=load)


def _read_films(scene: Scene, reference: Reference, load: float) -> Floats:
    """Return both films' forces, or charges, C, where readings are charges, per load, N, on a reference, shape (2,)."""
    if reference.on != "tissue":
        per_load = compute_pin_charge(scene, reference) if reads_film_states(scene) else 1.0
        return per_load * np.array([float(reference.on == side) for side in ("inner", "outer")])
    block = build_block_scene(scene, reference)
    solved, read, _ = solve_block(block)
    films = solved.films[0]
    if find_departure(block, load) > find_linear_limit(CoarseModel(block, solved.sample, ()).build_rule(block)).force:
        pressed = PressedReference.from_force(block, load, reference.name)
        films, read = pressed.films, pressed.read
    return np.asarray(read.totals / films.totals.sum())


def find_pressing_load(scene: Scene, reference: Reference, load: float) -> float:
    """Return the load, N, by which a reference is to be pressed: ``load``, or less where the reference allows less."""
    if reference.on != "tissue":
        return min(load, find_pin_load(scene, reference))
    return min(load, find_reference_load(build_load_rule(build_block_scene(express_by_outer_radius(scene), reference))))


def compute_load(scene: Scene, stiffness: float | None) -> float:
    """Return the amplitude of the scene's load, N.

    Raises
    ------
    Refusal
        The load is zero, or an indentation of unknown stiffness.
    """
    load = scene.load.amplitude
    if load is None and stiffness is not None:
        load = stiffness * (scene.load.indentation or 0.0)
    if not load:
        raise Refusal("load", Words("zero or unknown"), "a load above 0, for a virtual probe")
    return load
