"""Simulate a probe on a tissue that holds tumours: presses of a survey without hardware."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Load
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.reference_charges import compute_charge_units
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals, read_delivered
from probe_design.locating.prior import TumourPrior
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.tables import NoiseModel
from solver.inclusions.tumours import Tumours
from solver.reading_tables.effect_samplers import LinearEffects, LoadedEffects, choose_sampler

MAX_TRIES = 10_000  # of drawing tumours that fit the tissue


def draw_hidden_tumours(prior: TumourPrior, seed: int) -> Floats:
    """Return the tumours of one patient of a population, number included, shape (m, 5); the same seed gives the same ones."""
    rng = np.random.default_rng((seed, 39))
    number = int(rng.choice(len(prior.numbers), p=prior.numbers))
    for _ in range(MAX_TRIES):
        tumours = prior.transform(rng.random((1, number, len(prior.free))))
        if prior.find_allowed(tumours)[0]:
            return np.asarray(tumours[0])
    raise InputError("population", Words("hardly any tumour fits"), "ranges of which more fit the tissue")


def convert_inclusions(inclusions: tuple[Inclusion, ...]) -> Floats:
    """Return spheres as an array of tumours, shape (m, 5); raise ``InputError`` for other shapes."""
    if any(body.diameter is None for body in inclusions):
        raise InputError("hide", Words("a body that is no sphere"), "spheres, with a diameter each")
    rows = [(body.x, body.y, body.depth, body.diameter, body.youngs_modulus) for body in inclusions]
    return np.array(rows, dtype=float).reshape(-1, 5)


@dataclass(frozen=True)
class VirtualTissue:
    """A tissue with hidden tumours below a virtual probe; readings by the evaluator of the scene's load, with reflections.

    Attributes
    ----------
    samplers
        The probe on the tissue without tumours, by the force of a press, N; None is the scene's load.
    tumours
        Hidden ones, shape (m, 5).
    poisson_ratio
        Of the tumours.
    bench, noise, seed
        Of the measurement: noise of each press by the design file, and of the samples.
    """

    samplers: Mapping[float | None, LinearEffects | LoadedEffects]
    tumours: Floats
    poisson_ratio: float
    bench: Bench
    noise: NoiseModel
    seed: int

    @classmethod
    def from_scene(
        cls, scene: Scene, tumours: Floats, poisson_ratio: float, *, bench: Bench, noise: NoiseModel, seed: int,
        forces: Sequence[float | None] = (None,),
    ) -> VirtualTissue:  # fmt: skip
        """Solve the probe on the tissue without tumours under each of ``forces``, N; None is the scene's load."""
        free = read_delivered(scene.model_copy(update={"inclusion": ()}))
        loaded = {force: free if force is None else free.model_copy(update={"load": Load(force=force)}) for force in forces}
        samplers = {force: choose_sampler(part) for force, part in loaded.items()}
        return cls(samplers, tumours, poisson_ratio, bench, noise, seed)

    def build_press(
        self, number: int, place: tuple[float, float], *, blank: bool, force: float | None = None
    ) -> Callable[[Floats], Floats]:
        """Return the signals of one press as a function of time.

        Parameters
        ----------
        number
            Of the press, from 0: each has its own noise.
        place
            Of the probe's axis, m, to which it comes but for the pose error.
        blank
            Whether the press is over tissue without tumours.
        force
            Of the press, N, one of ``samplers``.
        """
        sampler = self.samplers[force]
        rng = np.random.default_rng((self.seed, 40, number))
        x, y = np.asarray(place) + self.noise.pose * rng.standard_normal(2)
        totals = (
            self._compute_totals(sampler, float(x), float(y))
            if len(self.tumours) and not blank
            else stack_totals(sampler.scene, sampler.films)
        )
        indentation = float(sampler.scene.load.find_indentation(totals[:2].sum()))
        # noise of pressing: the inner film against the outer one
        spread = np.hypot(self.noise.white, self.noise.tilt) * rng.standard_normal() * np.array([0.5, -0.5])
        forces = totals[:2] * indentation
        read = forces if len(totals) == 2 else totals[2:] * indentation / compute_charge_units(sampler.scene)
        return build_signals(
            BuiltProperties(), self.bench, sampler.scene, read * np.exp(spread), [self.seed, number], load=float(forces.sum())
        )

    def _compute_totals(self, sampler: LinearEffects | LoadedEffects, x: float, y: float) -> Floats:
        """Return forces on the films per indentation, and charges where they are read, at a place, shape (2 or 4,)."""
        tumour_x, tumour_y, depth, diameter, modulus = self.tumours.T[:, None]
        spheres = Tumours(tumour_x - x, tumour_y - y, depth, diameter, modulus, self.poisson_ratio)
        return np.asarray(stack_totals(sampler.scene, sampler.read_sets(spheres))[0])
