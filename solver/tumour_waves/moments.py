"""Draws of a population as arrays, and strain moments about their spheres under waves of traction, for any probe.

The strain's moments about a sphere (``closed_form.sphere_moments``) are, under loads whose Hankel transforms at the wave numbers
k are p and q, sums over k of numbers that depend only on tissue, sphere and its distance from the probe's axis. They are
computed once for all designs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.closed_form.contact import INTEGRAL_REACH, NODES_PER_WAVE
from solver.closed_form.inclusions import build_moment_form
from solver.closed_form.layered_spheres import build_sphere_in_layer
from solver.closed_form.off_axis import shift_waves
from solver.closed_form.sphere_moments import ALL_MOMENTS, SphereArray
from solver.closed_form.tractions import build_wave_rule
from solver.inclusions.eshelby import compute_strengths
from solver.layers.stack import TissueLayer

MAX_WAVE_NUMBERS = 160  # maximum number of wave numbers
MIN_PATH_RADII = 0.2  # of a sphere's radius: minimum distance to a face for the choice of wave numbers
ON_AXIS = 1e-6  # m: smaller offsets count as this one; off-axis moments tend to those on the axis


@dataclass(frozen=True)
class TumourDraws:
    """m spheres, each in its own tissue; SI.

    Attributes
    ----------
    radius, depth, x, y
        Radii and positions of the spheres, m, shape (m,).
    youngs_modulus, poisson_ratio
        Elastic constants of the spheres, shape (m,).
    tissue
        Layers from the surface downwards and the tissue's own material, each thickness (of the last the bottom's depth; None on
        half-spaces), modulus and Poisson's ratio, shape (layers + 1, 3, m).
    bounded
        Whether the tissue has a bottom; if not, the last thickness is ignored.
    """

    radius: Floats
    depth: Floats
    x: Floats
    y: Floats
    youngs_modulus: Floats
    poisson_ratio: Floats
    tissue: Floats
    bounded: bool

    @property
    def layers(self) -> Ints:
        """The layer that holds each centre, 0 the first, shape (m,)."""
        faces = np.cumsum(self.tissue[:-1, 0], axis=0)
        return np.asarray((faces <= self.depth).sum(axis=0))

    def select(self, which: Ints) -> TumourDraws:
        """Return the draws with indices ``which``."""
        arrays = {key: values[..., which] for key, values in vars(self).items() if isinstance(values, np.ndarray)}
        return TumourDraws(**arrays, bounded=self.bounded)

    @property
    def hosts(self) -> tuple[Floats, Floats]:
        """Modulus and Poisson's ratio of the tissue around each sphere, shapes (m,)."""
        column = np.arange(len(self.radius))
        return self.tissue[self.layers, 1, column], self.tissue[self.layers, 2, column]

    @cached_property
    def tissues(self) -> tuple[Floats, Ints]:
        """The distinct tissues, shape (layers + 1, 3, u), and the number of each draw's tissue, shape (m,)."""
        flat = self.tissue.reshape(-1, len(self.radius))
        distinct, which = np.unique(flat, axis=1, return_inverse=True)
        return distinct.reshape(*self.tissue.shape[:2], -1), np.asarray(which).reshape(-1)


def build_layers(tissue: Floats, bounded: bool) -> list[TissueLayer]:
    """Build the layers of n tissues given as an array (layers + 1, 3, n), see ``TumourDraws.tissue``."""
    *upper, (depth, modulus, poisson) = tissue
    upper_thickness = sum((layer[0] for layer in upper), start=0 * depth)
    lowest_thickness = depth - upper_thickness if bounded else None
    return [*(TissueLayer(*layer) for layer in upper), TissueLayer(lowest_thickness, modulus, poisson)]


@dataclass(frozen=True)
class Moments:
    """Moments of the strain about m spheres, per amplitude of each wave, for P positions of the probe.

    Attributes
    ----------
    k
        Wave numbers, shape (q,).
    pressed, sheared
        Moments under waves of pressure and of shear, k dk / 2 mu in them, shapes (m, P x moments, q).
    form, form_by_log
        V K, the form of eq. CF.13 on moments, m^3 Pa, and its derivative by ln E of the sphere, shapes (m, moments, moments).
    """

    k: Floats
    pressed: Floats
    sheared: Floats
    form: Floats
    form_by_log: Floats


def compute_moments(draws: TumourDraws, positions: Floats, widest: float) -> Moments:
    """Compute the moments about spheres under the waves of a probe.

    Parameters
    ----------
    draws
        m spheres in their tissues.
    positions
        x and y of the probe's axis at P positions, m, shape (P, 2).
    widest
        Outer radius of the widest probe, m.
    """
    axis_distance = np.hypot(draws.x[:, None] - positions[:, 0], draws.y[:, None] - positions[:, 1])
    k, weight = _choose_wave_numbers(draws, widest + float(axis_distance.max(initial=0.0)))
    # of tractions that press and that shear: for each sphere, position, moment and wave number
    kinds = np.empty((2, len(draws.radius), len(positions), ALL_MOMENTS, len(k)))
    for layer in np.unique(draws.layers):
        which = np.flatnonzero(draws.layers == layer)
        layer_moments = _compute_layer_moments(draws.select(which), int(layer), k, weight)
        # a wave about the probe's axis is a sum of waves about the sphere's, eq. CF.17
        for p in range(len(positions)):
            factors = shift_waves(np.broadcast_to(k, (len(which), len(k))), np.maximum(axis_distance[which, p], ON_AXIS))
            kinds[:, which, p] = layer_moments * factors
    pressed, sheared = kinds.reshape(2, len(draws.radius), -1, len(k))
    modulus, poisson = draws.hosts
    volume = (4 * np.pi / 3 * draws.radius**3)[:, None, None]
    strengths, strengths_by_log = compute_strengths(modulus, poisson, draws.youngs_modulus, draws.poisson_ratio)
    return Moments(
        k,
        pressed,
        sheared,
        volume * build_moment_form(*strengths, ALL_MOMENTS),
        volume * build_moment_form(*strengths_by_log, ALL_MOMENTS),
    )


def _choose_wave_numbers(draws: TumourDraws, across: float) -> tuple[Floats, Floats]:
    """Choose wave numbers, 1/m, and weights k dk for the shallowest sphere, within what the nodes resolve; shapes (q,).

    ``across`` is the largest distance of a load from a sphere's axis, m: shorter waves oscillate too fast over it.
    """
    shortest_path = np.maximum(draws.depth - 0.8 * draws.radius, MIN_PATH_RADII * draws.radius)
    reach = min(INTEGRAL_REACH / float(shortest_path.min()), (MAX_WAVE_NUMBERS - 8) / (NODES_PER_WAVE * across))
    factors, weight = build_wave_rule(min(MAX_WAVE_NUMBERS, 2 * int(np.ceil((8 + NODES_PER_WAVE * reach * across) / 2))))
    k = reach * factors
    return k, k * reach * weight


def _compute_layer_moments(draws: TumourDraws, layer: int, k: Floats, weight: Floats) -> Floats:
    """Compute moments about the axes of the spheres in one layer, times k dk / 2 mu, shape (2, m, moments, q)."""
    # the third argument, the offset, is not used here: moments about the sphere's own axis do not depend on it
    sphere = SphereArray(
        draws.radius, draws.depth, draws.depth, draws.youngs_modulus, draws.poisson_ratio, on_axis=False, layer=layer
    )
    wave_numbers, host, nu = np.repeat(k[None], len(draws.radius), axis=0), *draws.hosts
    weights, layers = np.repeat(weight[None], len(wave_numbers), axis=0), build_layers(draws.tissue, draws.bounded)
    sphere_waves = build_sphere_in_layer(sphere, wave_numbers, weights, layers, draws.bounded).sphere_waves
    return np.stack(sphere_waves.moments) * (weight * ((1 + nu) / host)[:, None])[None, :, None, :]
