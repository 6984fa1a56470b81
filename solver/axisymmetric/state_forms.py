"""Express energy forms of many pairs of states by those of a few, for gradients along a whole curve of moduli.

A film's total is the form g_i(u) = u_i^T A (u_1 + u_2) of both states, A the stiffness or its derivative by anything, and it
changes with the states, by w, as g_i'(u, w) = w_i^T A (u_1 + u_2) + u_i^T A (w_1 + w_2). On a basis of m vectors both are sums of
A's m^2 products. But states at all moduli lie on one smooth curve, and so do their products: forms and changes at 50 moduli are
to 1e-7 sums of the forms at ten, whatever A is (empirical interpolation: Barrault et al., C. R. Acad. Sci. Paris I 339, 2004,
667-672).
Where these do not suffice, changes are differences of forms, g_i'(u, w) = [g_i(u + w) - g_i(u - w)] / 2, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints

NEGLIGIBLE_RELATIVE = 1e-7  # remainder of a form, in the norm of the coefficients of its products
MIN_USEFUL_FACTOR = 1e-2  # times that: with a smaller remainder another form helps little
FIRST_CANDIDATES = 20  # states, evenly spaced, among which pivots are chosen first
REMAINDER_FACTOR = 2.0  # times the negligible remainder: allowed for the other states then


@dataclass(frozen=True)
class StateForms:
    """Forms of k pairs of states, and their changes, as sums of forms of a few pairs.

    Attributes
    ----------
    states
        Coefficients of s pairs on the basis, shape (m, 2, s).
    values
        Weights that give g_i of all pairs from g_i of these, shape (k, s).
    changes
        Weights that give g_i' of all pairs likewise, shape (k, s).
    """

    states: Floats
    values: Floats
    changes: Floats

    @classmethod
    def choose_pairs(cls, u: Floats, w: Floats, size: Floats) -> StateForms:
        """Choose the pairs by whose forms all forms g_i and changes g_i' are expressed, and compute the weights.

        A form depends on products of coefficients alone: the pairs are those whose products, with weights, give all others'.

        Parameters
        ----------
        u
            Coefficients of the states on a basis, shape (k, m, 2).
        w
            Coefficients of their changes, shape (k, m, 2).
        size
            Norms of the basis vectors, shape (m,): coefficients times norms are compared.
        """
        step = _compute_steps(u * size[:, None], w * size[:, None])
        products = np.concatenate([_compute_products(u, u, size), 2 * _compute_products(u, step * w, size)])
        chosen = _choose_pivots(products, len(u))
        orthonormal, triangle = np.linalg.qr(products[chosen].T)
        weights = np.linalg.solve(triangle, orthonormal.T @ products.T).T  # (2 k, chosen)
        plain = np.count_nonzero(chosen < len(u))
        changed = chosen[plain:] - len(u)
        displacements = (step * w)[changed]
        # a change is half the difference of the forms at u + w and u - w
        half = weights[:, plain:] / 2
        weights = np.concatenate([weights[:, :plain], half, -half], axis=1)
        states = np.concatenate([u[chosen[:plain]], u[changed] + displacements, u[changed] - displacements])
        return cls(states.transpose(1, 2, 0), weights[: len(u)], weights[len(u) :] / step[:, 0])

    def sum_forms(self, forms: Floats) -> tuple[Floats, Floats]:
        """Return g_i and g_i' of all pairs, shape (k, v, 2) both, from g_i of the chosen pairs, (v, 2, s)."""
        values, changes = (np.moveaxis(forms @ part.T, -1, 0) for part in (self.values, self.changes))
        return values, changes


def _compute_steps(u: Floats, w: Floats) -> Floats:
    """Return factors that scale changes w to the size of the states u, both (k, m, 2), shape (k, 1, 1); 1 where w is zero."""
    states, changes = (np.linalg.norm(array, axis=(1, 2), keepdims=True) for array in (u, w))
    return np.asarray(np.divide(states, changes, out=np.ones_like(states), where=changes > 0))


def _compute_products(u: Floats, w: Floats, size: Floats) -> Floats:
    """Return the factors of A's entries in g_1 - g_2 and g_1 + g_2, bilinear and symmetric in u and w, shape (k, products).

    ``u`` and ``w`` are coefficients of pairs on the basis, shape (k, m, 2), ``size`` the norms of the basis vectors, shape (m,).
    As A is symmetric, products of its upper triangle suffice.
    """
    low, high = np.triu_indices(len(size))
    weight = np.where(low < high, 2**0.5, 1.0)  # of entries that stand for two
    (sums, differences), (other_sums, other_differences) = (_add_and_subtract(array * size[:, None]) for array in (u, w))
    outer = (
        sums[:, :, None] * other_differences[:, None] + differences[:, :, None] * other_sums[:, None],
        sums[:, :, None] * other_sums[:, None],
    )
    halves = (outer[0] / 2, outer[1])
    return np.concatenate([weight * (array + array.swapaxes(1, 2))[:, low, high] / 2 for array in halves], axis=1)


def _add_and_subtract(u: Floats) -> tuple[Floats, Floats]:
    """Return u_1 + u_2 and u_1 - u_2 of pairs, shape (k, m, 2) to (k, m) both."""
    return u[..., 0] + u[..., 1], u[..., 0] - u[..., 1]


def _choose_pivots(products: Floats, plain: int) -> Ints:
    """Choose rows whose linear combinations give all others; return their indices in order, shape (chosen,).

    Parameters
    ----------
    products
        Rows of products: first ``plain`` of states, then as many of changes, shape (2 plain, products).
    plain
        Number of states; as many of these rows as are useful are taken first. A few rows, evenly spaced, are tried before all,
        which usually suffices.
    """
    norms = np.linalg.norm(products, axis=1, keepdims=True)
    residual_rows = np.divide(products, norms, out=np.zeros_like(products), where=norms > 0)
    candidates = np.unique(np.linspace(0, plain - 1, FIRST_CANDIDATES).astype(int))
    chosen, basis = _choose_rows(residual_rows[np.concatenate([candidates, plain + candidates])], len(candidates))
    remainders = np.linalg.norm(residual_rows - (residual_rows @ basis.T) @ basis, axis=1)
    if remainders.max() > REMAINDER_FACTOR * NEGLIGIBLE_RELATIVE:
        return _choose_rows(residual_rows, plain)[0]
    return np.asarray(candidates[chosen % len(candidates)] + plain * (chosen >= len(candidates)))


def _choose_rows(residual_rows: Floats, plain: int) -> tuple[Ints, Floats]:
    """Choose rows by pivoting: always the row with the largest remainder, whose direction is then removed from all others.

    Returns the chosen rows' indices in increasing order, and an orthonormal basis of these rows. Rows below index ``plain`` come
    first while one of them has a useful remainder.
    """
    chosen: list[int] = []
    basis: list[Floats] = []
    for _ in range(len(residual_rows)):
        size = np.linalg.norm(residual_rows, axis=1)
        if size.max() <= NEGLIGIBLE_RELATIVE:
            break
        sizes = size[:plain] if size[:plain].max() > MIN_USEFUL_FACTOR * NEGLIGIBLE_RELATIVE else size
        chosen.append(int(np.argmax(sizes)))
        basis.append(residual_rows[chosen[-1]] / size[chosen[-1]])
        residual_rows = residual_rows - np.outer(residual_rows @ basis[-1], basis[-1])
    return np.sort(chosen).astype(int), np.array(basis)
