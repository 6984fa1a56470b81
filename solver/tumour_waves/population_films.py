"""Compute film forces of many probes over a population, to first order in the tumours.

With t the tractions under a probe whose blocks move together and t_i those under block i alone, eq. CF.12, and M the moments of
the strain about a sphere, linear in the tractions, the force on film i and its change by the sphere are

    F_i = A_i . t,     dF_i = M(t_i) . V K M(t)                                                       (TW.1)

eq. CF.13 on moments without the image in surface and blocks, which nearly cancel each other. That leaves out 1 % of the ratio
for spheres whose cover is half their diameter and more, 13 % at a tenth: enough for a search, not to verify its result. The
derivative by ln E of the sphere has dK / d ln E in K's place. All is analytic in the probe's sizes and moduli: complex steps
differentiate it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.json_types import JsonObject
from solver.closed_form.bessel import Array
from solver.closed_form.contact import ContactSolution, Tissue, solve_contact
from solver.closed_form.contact import Films as FilmStacks
from solver.closed_form.designs import build_blocks
from solver.closed_form.tractions import transform_long_waves
from solver.layers.stack import TissueLayer
from solver.tumour_waves.moments import Moments, TumourDraws, compute_moments

FLOOR_NODES = 16
MOST_PAIRS = 4096  # pairs of probe and tissue solved at once


@dataclass(frozen=True)
class Films:
    """Forces per unit indentation, N/m, and charges, C/m, of n probes over m tumours from P positions.

    The last axis holds the forces on the inner and the outer film and, of films whose charges are computed, their charges.

    Attributes
    ----------
    without
        Without tumours, shape (n, m, 2 or 4).
    change
        By the tumour, shape (n, m, P, 2 or 4).
    by_log
        Derivatives by ln of the tumour's modulus, shape (n, m, P, 2 or 4).
    """

    without: Array
    change: Array
    by_log: Array


@dataclass(frozen=True)
class ManyTumours:
    """A population of tumours read at several positions, for any probe up to a maximum outer radius.

    Attributes
    ----------
    draws
        The tumours.
    moments
        See ``moments.Moments``.
    bonded
        Whether blocks and tissue stick.
    side
        Radius and nodes of the tissue's free sides, if they are near.
    layer_nodes
        Nodes of the integrals for layers.
    """

    draws: TumourDraws
    moments: Moments
    bonded: bool
    side: tuple[float, int]
    layer_nodes: int

    @classmethod
    def from_draws(
        cls, draws: TumourDraws, positions: Floats, widest: float, *, bonded: bool, side: tuple[float, int], layer_nodes: int
    ) -> ManyTumours:
        """Compute everything that does not depend on the probe.

        Parameters
        ----------
        draws
            The tumours.
        positions
            x and y of the probe's axis, m, shape (P, 2).
        widest
            Outer radius of the widest probe, m.
        bonded, side, layer_nodes
            See the class.
        """
        return cls(draws, compute_moments(draws, positions, widest), bonded, side, layer_nodes)

    def compute_films(self, probes: Array, stacks: FilmStacks | None = None) -> Films:
        """Compute the film forces of n probes, eq. TW.1, and their charges.

        A charge is linear in the tractions as a force is: it has the film's loads, eq. CF.28, in place of A_i, and the tractions
        under them in place of t_i.

        Parameters
        ----------
        probes
            The parameters ``closed_form.designs.PROBE_PARAMETERS``, a column for each, floats or complex, shape (9, n).
        stacks
            Films and bonds, of each probe or of all alike; None for forces alone.
        """
        chunks = np.split(np.arange(probes.shape[1]), range(self._chunk, probes.shape[1], self._chunk))
        parts = [self._compute_chunk(probes[:, chunk], stacks and stacks.take(chunk % stacks.count)) for chunk in chunks]
        return Films(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("without", "change", "by_log")))

    @property
    def _chunk(self) -> int:
        """How many probes are solved at once."""
        return max(1, MOST_PAIRS // int(self.draws.tissues[0].shape[2]))

    def _compute_chunk(self, probes: Array, stacks: FilmStacks | None) -> Films:
        """Compute the film forces of a few probes, shape (9, n), on all tissues, in one evaluation on arrays."""
        tissues, tissue_of_draw = self.draws.tissues
        n, u = probes.shape[1], tissues.shape[2]
        films = stacks and stacks.take(np.repeat(np.arange(n), u))
        bare = self._solve_without_tumours(np.repeat(probes, u, axis=1), np.tile(tissues, n), films)
        blocks = build_blocks(probes)
        k = np.repeat(self.moments.k[None], n, axis=0)
        kinds = transform_long_waves(blocks, k, self.bonded)
        tractions = bare.tractions.reshape(n, u, *bare.tractions.shape[1:])
        pressures = kinds[0].shape[2]
        # amplitudes of the waves that the tractions under each block's displacement send into each tissue, (n, u, q, s)
        amplitudes = [wave[:, None] @ part for wave, part in zip(kinds, np.split(tractions, [pressures], axis=2), strict=True)]
        block_moments = self._compute_moments(*amplitudes)  # (m, P, moments, n, s) of the s = 2 blocks, or 4 with films
        # M(t) of both blocks moved together; ``block_moments`` holds the M(t_i)
        summed_moments = block_moments[..., :2].sum(axis=-1, keepdims=True)
        forms = (self.moments.form, self.moments.form_by_log)
        change, by_log = (np.moveaxis((_apply_forms(form, summed_moments) * block_moments).sum(axis=2), 2, 0) for form in forms)
        baseline = bare.products.sum(axis=2).reshape(n, u, -1)[:, tissue_of_draw]
        return Films(baseline, change, by_log)

    def _solve_without_tumours(self, probes: Array, tissues: Floats, films: FilmStacks | None) -> ContactSolution:
        """Solve eq. CF.12 for pairs of probe and tissue without tumours, a pair in each column."""
        *upper, (depth, modulus, poisson) = tissues
        layers = tuple(TissueLayer(*layer) for layer in upper)
        side = np.full(probes.shape[1], self.side[0])
        tissue = Tissue(depth if self.draws.bounded else None, modulus, poisson, side, layers)
        settings: JsonObject = {"nodes": FLOOR_NODES, "side_nodes": self.side[1], "layer_nodes": self.layer_nodes}
        return solve_contact(build_blocks(probes), tissue, (), target=None, bonded=self.bonded, films=films, **settings)

    def _compute_moments(self, pressed: Array, sheared: Array) -> Array:
        """Compute moments about each sphere under each block from waves (n, u, q, s), shape (m, P, moments, n, s)."""
        n, states = len(pressed), pressed.shape[3]
        m, rows, _ = self.moments.pressed.shape
        moments: Any = 0.0
        for kernel, amplitudes in ((self.moments.pressed, pressed), (self.moments.sheared, sheared)):
            columns = np.ascontiguousarray(np.moveaxis(amplitudes, 0, 2)).reshape(
                amplitudes.shape[1], amplitudes.shape[2], -1
            )  # (u, q, s n)
            moments = moments + _multiply_real(kernel, columns, self.draws.tissues[1])
        return moments.reshape(m, -1, self.moments.form.shape[1], n, states) if rows else moments


def _apply_forms(form: Floats, vectors: Array) -> Array:
    """Multiply matrices (m, i, j) by vectors (m, P, j, n, 1), moments of m tumours, P positions and n probes."""
    m, P, size, n, _ = vectors.shape
    return _multiply_real(form[:, None], vectors.reshape(m, P, size, n), None).reshape(m, P, size, n, 1)


def _multiply_real(real: Floats, columns: Array, which: Ints | None) -> Array:
    """Multiply real matrices (m, ..., i, j) by columns (u, ..., j, l), real or complex, as one real product.

    ``which``, shape (m,), gives for each matrix the index of its columns among the u; None where each matrix has its own. A
    complex number counts as two real columns, and a single set of columns (u = 1) allows one product for all matrices.
    """
    parts = columns.view(float) if np.iscomplexobj(columns) else columns
    if which is not None and len(parts) == 1:
        product = (real.reshape(-1, real.shape[-1]) @ parts[0]).reshape(*real.shape[:-1], -1)
    else:
        product = real @ (parts if which is None else parts[which])
    return product.view(complex) if np.iscomplexobj(columns) else product
