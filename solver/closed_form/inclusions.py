"""Changes of the film forces by spheres in the tissue: equivalent inclusions, their images and the blocks' response.

By Betti and Eshelby a sphere of volume V with strengths k_v, k_d (eq. IN.2 of ``eshelby``) adds to the work of two tractions

    dF_ij = Int [(k_v - k_d/3) tr(eps_i) tr(eps_j) + k_d eps_i : eps_j] dV                        (CF.13)

over the tissue's strains without it. Of these the moments e, V e.K e, are treated better: the sphere responds to the image G of
its own polarisation in the free surface, ``sphere_moments``, or in all faces, ``layered_spheres``, off the axis less that of
``off_axis``, so that loads of moments M polarise it by K D^-1 M, D = 1 + G K, and it gives way to them: with all spheres, t'
takes the place of the t of eq. CF.12,

    (C - sum M^T V K D^-1 M) t' = A,     dF = A^T (t' - t),     dF / d ln E = y.V (dK / d ln E) y,     y = D^-1 M t'    (CF.14)

and eq. CF.13 counts to first order, under t, what it has beyond the moments. Blocks and free surface nearly cancel under a stiff
probe: with one of them alone the effect of a shallow sphere would be up to 80 % off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.closed_form.bessel import Array
from solver.closed_form.lateral_boundary import Sides
from solver.closed_form.layered_spheres import SphereInLayer
from solver.closed_form.off_axis import Disc, compute_off_axis_response, shift_waves
from solver.closed_form.sphere_moments import (
    AXIAL_MOMENTS,
    MOMENT_WEIGHTS,
    OFF_AXIS_POINTS,
    ON_AXIS_POINTS,
    SphereArray,
    compute_tissue_strain,
)
from solver.inclusions.eshelby import compute_strengths
from solver.layers.stack import TissueLayer


@dataclass(frozen=True)
class LoadedSpheres:
    """One sphere in each of n designs, under the m unit loads of a probe.

    Attributes
    ----------
    sphere
        Places, sizes and materials.
    in_layer
        The waves that reach the spheres, and their images.
    axis_distance
        Distances of the points from the probe's axis, m, shape (n, points); None for spheres on the axis.
    loads
        The transforms of pressures and of shears, times k dk / 2 mu, shapes (n, q, .).
    sides
        Strains at the points that near sides add under unit works, (n, 4 points, works), and the works under each load, (n,
        works, m); None where sides are far.
    moments
        M of eq. CF.14: moments of the strain under each load, shape (n, moments, m).
    image
        G of eq. CF.15 less V S of eq. CF.18, shape (n, moments, moments).
    strength, strength_by_log
        (k_v, k_d) of eq. CF.13 and their derivatives by ln E.
    """

    sphere: SphereArray
    in_layer: SphereInLayer
    axis_distance: Array | None
    loads: tuple[Array, Array]
    sides: tuple[Array, Array] | None
    moments: Array
    image: Array
    strength: tuple[Array, Array]
    strength_by_log: tuple[Array, Array]

    @property
    def volume(self) -> Array:
        """Volume V of the spheres, m^3, shape (n, 1, 1)."""
        return (4 * np.pi / 3 * self.sphere.radius**3)[:, None, None]

    @cached_property
    def form(self) -> Array:
        """V K of eq. CF.14, which is eq. CF.13 on the moments, shape (n, moments, moments)."""
        return self.volume * build_moment_form(*self.strength, self.moments.shape[1])

    @cached_property
    def form_by_log(self) -> Array:
        """Derivative of V K by ln E of the sphere, shape (n, moments, moments)."""
        return self.volume * build_moment_form(*self.strength_by_log, self.moments.shape[1])

    @cached_property
    def effective_moments(self) -> Array:
        """D^-1 M of eq. CF.14: the moments that polarise the sphere under each load, its image included, (n, moments, m)."""
        D = np.eye(self.moments.shape[1]) + (self.image / self.volume) @ self.form
        return np.linalg.solve(D, self.moments)

    @property
    def works(self) -> Array:
        """Work of unit loads on each other through the sphere: M^T V K D^-1 M of eq. CF.14, shape (n, m, m)."""
        return self.moments.swapaxes(1, 2) @ (self.form @ self.effective_moments)

    def compute_log_modulus_derivative(self, tractions: Array) -> Array:
        """Return the forces' derivative by ln E (eq. CF.14) under tractions t' (n, m, 2), shape (n, 2, 2)."""
        y = self.effective_moments @ tractions
        return y.swapaxes(1, 2) @ self.form_by_log @ y

    def compute_higher_moments(self, tractions: Array) -> tuple[Array, Array]:
        """Return the part of eq. CF.13 beyond the moments, N/m, and its derivative by ln E, both of shape (n, 2, 2).

        ``tractions`` are t of eq. CF.12, without spheres, shape (n, m, 2).
        """
        sphere_waves, moments = self.in_layer.sphere_waves, self.moments @ tractions
        pressures = self.loads[0].shape[2]
        t = tractions.swapaxes(1, 2)
        pressed, sheared = (
            rows @ load.swapaxes(1, 2) for rows, load in zip((t[:, :, :pressures], t[:, :, pressures:]), self.loads, strict=True)
        )
        pp, pq, qp, qq = (np.broadcast_to(part, sphere_waves.waves.k.shape)[:, None] for part in self.in_layer.arriving)
        arriving = pp * pressed + pq * sheared, qp * pressed + qq * sheared
        strain = compute_tissue_strain(sphere_waves, arriving, self.axis_distance)
        if self.sides is not None:
            strain += ((self.sides[1] @ tractions).swapaxes(1, 2) @ self.sides[0].swapaxes(1, 2)).reshape(strain.shape)
        weight = (ON_AXIS_POINTS if self.sphere.on_axis else OFF_AXIS_POINTS).weight
        trace = strain[:, :, 0] + strain[:, :, 2]
        traces = (weight * trace) @ trace.swapaxes(1, 2)
        # eps:eps = (rr + hoop)^2 / 2 + (rr - hoop)^2 / 2 + zz^2 + 2 rz^2
        strain_weights = np.concatenate([times * weight for times in (0.5, 0.5, 1.0, 2.0)])
        flat = strain.reshape(*strain.shape[:2], -1)
        squares = (strain_weights * flat) @ flat.swapaxes(1, 2)
        moments_transposed = moments.swapaxes(1, 2)

        def compute_excess(strength: tuple[Array, Array], form: Array) -> Array:
            """Return eq. CF.13 by quadrature, less its part in the moments."""
            k_v, k_d = (part[:, None, None] for part in strength)
            return self.volume * ((k_v - k_d / 3) * traces + k_d * squares) - moments_transposed @ form @ moments

        return compute_excess(self.strength, self.form), compute_excess(self.strength_by_log, self.form_by_log)


def build_loaded_spheres(
    sphere: SphereArray,
    in_layer: SphereInLayer,
    loads: tuple[Array, Array],
    weights: Array,
    *,
    layer: TissueLayer,
    disc: Disc | None,
    sides: Sides | None = None,
) -> LoadedSpheres:
    """Build spheres under a probe's loads.

    Parameters
    ----------
    sphere
        Places, sizes and materials.
    in_layer
        The waves that reach the spheres, and their images.
    loads
        Transforms of pressures and of shears, shapes (n, q, .).
    weights
        k dk of the waves, shape (n, q).
    layer
        The layer that holds the spheres.
    disc
        The probe's end, None for spheres on its axis.
    sides
        Of the tissue, where they are near.
    """
    sphere_waves, k = in_layer.sphere_waves, in_layer.sphere_waves.waves.k
    scaled = (weights / (2 * layer.mu))[:, :, None]
    weighed = loads[0] * scaled, loads[1] * scaled
    moments, axis_distance = sphere_waves.moments, None
    x_from_axis, y_from_axis = sphere.radius[:, None] * ON_AXIS_POINTS.x, sphere.radius[:, None] * 0
    if not sphere.on_axis:
        shares = shift_waves(k, sphere.offset)
        x_from_axis = sphere.offset[:, None] + sphere.radius[:, None] * OFF_AXIS_POINTS.x
        y_from_axis = sphere.radius[:, None] * OFF_AXIS_POINTS.y
        moments, axis_distance = (moments[0] * shares, moments[1] * shares), np.sqrt(x_from_axis**2 + y_from_axis**2)
    load_moments = np.concatenate([moments[0] @ weighed[0], moments[1] @ weighed[1]], axis=2)
    side_strains = None
    if sides is not None:
        depths = sphere.depth[:, None] - sphere.radius[:, None] * ON_AXIS_POINTS.z
        strains = sides.compute_strain(x_from_axis if axis_distance is None else axis_distance, depths)
        strains = strains * (sides.tissue.E / layer.E)[:, None, None]  # the layer bears the stress of the column
        side_strains = strains, sides.side_works
        side_moments = MOMENT_WEIGHTS @ strains if sphere.on_axis else _compute_moments(strains, x_from_axis, y_from_axis)
        load_moments = load_moments + side_moments @ sides.side_works
    G = in_layer.image
    if disc is not None:
        volume = (4 * np.pi / 3 * sphere.radius**3)[:, None, None]
        bonded = loads[1].shape[2] > 0
        G = G - volume * compute_off_axis_response(sphere, sphere_waves, k, weights, disc=disc, mu=layer.mu, bonded=bonded)
    strengths = compute_strengths(layer.E, layer.nu, sphere.E, sphere.nu)
    return LoadedSpheres(sphere, in_layer, axis_distance, weighed, side_strains, load_moments, G, *strengths)


def _compute_moments(strain: Array, x_from_axis: Array, y_from_axis: Array) -> Array:
    """Return all moments, shape (n, moments, l), of strains (n, 4 points, l) at ``OFF_AXIS_POINTS``.

    The strains rr + hoop, rr - hoop, zz and rz are about the probe's axis, from which the points have the coordinates x and y, m,
    shape (n, points).
    """
    parts = strain.reshape(len(strain), 4, x_from_axis.shape[1], -1)
    r, x, y, z, w = (
        np.sqrt(x_from_axis**2 + y_from_axis**2),
        OFF_AXIS_POINTS.x,
        OFF_AXIS_POINTS.y,
        OFF_AXIS_POINTS.z,
        OFF_AXIS_POINTS.weight,
    )
    # cosine and sine of the points' angles about the probe's axis turn strains to x and y
    c, s = x_from_axis / r, y_from_axis / r
    fixed, cos_2phi, sin_2phi = np.stack([w, 5 * w * z, 5 * w * x]), c * c - s * s, 2 * c * s
    in_plane, zz = fixed @ parts[:, 0], fixed @ parts[:, 2]
    slides = np.stack([2.5 * w * (c * x + s * y), w * c, 5 * w * z * c], axis=1) @ parts[:, 3]
    crossed = np.stack([1.25 * w * (cos_2phi * x + sin_2phi * y), w * cos_2phi], axis=1) @ parts[:, 1]
    centre = np.stack([in_plane[:, :2], zz[:, :2]], axis=2).reshape(len(in_plane), 4, -1)
    return np.concatenate([centre, slides, in_plane[:, 2:], zz[:, 2:], crossed], axis=1)


def build_moment_form(k_v: Array, k_d: Array, size: int) -> Array:
    """Build the form K of eq. CF.15, that is eq. CF.13 on the moments, shape (n, size, size).

    ``k_v`` and ``k_d`` are the strengths, shape (n,), ``size`` the number of moments: ``AXIAL_MOMENTS`` or ``ALL_MOMENTS``.
    """
    K = np.zeros((len(k_d), size, size), dtype=k_d.dtype)
    trace_coefficient = k_v - k_d / 3
    for start, times in ((0, 1.0), (2, 0.2), (7, 0.2))[: 2 if size == AXIAL_MOMENTS else 3]:  # the mean of zeta^2 is R^2 / 5
        K[:, start, start], K[:, start + 1, start + 1] = times * (trace_coefficient + k_d / 2), times * (trace_coefficient + k_d)
        K[:, start, start + 1] = K[:, start + 1, start] = times * trace_coefficient
    for i, times in ((4, 0.8), (5, 2.0), (6, 0.4), (9, 0.8), (10, 0.5))[: 1 if size == AXIAL_MOMENTS else 5]:
        K[:, i, i] = times * k_d
    return K
