"""Covariances of complex amplitudes, as those of (re, im) of each amplitude in turn, and their propagation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hw.common.samples import Complexes, Floats

QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # multiplication by j, as a matrix on (re, im)
RELATIVE_STEP = 1e-6  # of the central differences that propagate covariances


def split_parts(values: Complexes) -> Floats:
    """Return (re, im) of complex values (n,) in turn, shape (2 n,)."""
    return np.stack([values.real, values.imag], axis=1).ravel()


def build_multiplication_matrix(factors: Complexes) -> Floats:
    """Return the real matrix, (2 n, 2 n), that multiplies n complex numbers by complex factors (n,).

    It acts on the vector of their real and imaginary parts in turn: re, im of the first, re, im of the second, ...
    """
    return np.asarray(np.kron(np.diag(factors.real), np.eye(2)) + np.kron(np.diag(factors.imag), QUARTER_TURN))


def propagate_covariance(function: Callable[[Floats], Floats], values: Floats, covariance: Floats) -> Floats:
    """Return the covariance of a function's values by the delta method, with derivatives by central differences.

    Parameters
    ----------
    function
        From (n,) to (m,) values.
    values
        (n,) at which it is evaluated.
    covariance
        Of ``values``, shape (n, n).
    """
    step = RELATIVE_STEP * float(np.abs(values).max())
    shifts = step * np.eye(len(values))
    derivatives = np.stack([(function(values + shift) - function(values - shift)) / (2 * step) for shift in shifts], axis=1)
    return np.asarray(derivatives @ covariance @ derivatives.T)


def propagate_complex_covariance(function: Callable[[Complexes], Floats], values: Complexes, covariance: Floats) -> Floats:
    """Return the covariance of a real function of complex values (n,).

    ``covariance`` is that of (re, im) of the values in turn, shape (2 n, 2 n).
    """
    return propagate_covariance(lambda parts: function(parts[0::2] + 1j * parts[1::2]), split_parts(values), covariance)
