"""Compute the noise of the readings of one scan.

w_c is the standard deviation of a single reading of channel c. If a baseline reading over tumour-free tissue is subtracted from
the readings at p positions, their covariance is

    C = w_c^2 (1 + u u^T) within a channel, u = (1, ..., 1)                                         (PO.2)

with u of length p. A gain common to the scan cancels, and all differences contain the noise of the baseline reading. Without a
baseline reading a prediction is subtracted. With g_c the standard deviation of the gain of channel c, s_j those of the unknown
numbers of the tissue and t_j the derivatives of the readings with respect to these numbers,

    C = w_c^2 + g_c^2 u u^T within a channel, and sum s_j^2 t_j t_j^T over all                     (PO.3)

A detector uses these covariances, so that with a baseline reading it need not know the tissue. The parameters of a tumour are
estimated from all readings as they are, the baseline reading included, over which u extends as well,

    C = w_c^2 + g_c^2 u u^T within a channel                                                        (PO.8)

For the ratio w^2 = white^2 + tilt^2 + sum_j (q0 / Q_j)^2, with white, tilt and q0 (charge noise) from the design file and Q_j
the charge of channel j: that of its film where charges are read, else |d33| F_j under the force F_j (PHYSICS section 2). g^2 is
that of two channels, 2 gain^2.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.data.noise import MIN_NOISE, find_charge_per_force
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.tables import CHANNEL_INDICES, ChannelSet, NoiseModel, Protocol

WHITE_NOISE_KEYS = ("white", "stiffness_white")  # keys of [noise] for ratio and stiffness


def build_difference_noise(
    noise: NoiseModel,
    protocol: Protocol,
    scene: Scene,
    blank: Floats,
    *,
    tissue: Floats | None = None,
    tumour_forces: Floats | None = None,
    channel_set: ChannelSet | None = None,
) -> LinearGaussian:
    """Return the noise of readings less the baseline reading (eq. PO.2), or less a prediction (eq. PO.3).

    Parameters
    ----------
    noise
        Noise of the design file.
    protocol
        Protocol of the design file.
    scene
        Scene with films and load.
    blank
        Force on each film per unit indentation without tumours, N/m, shape (2,); where charges are read with the charge of each
        film, C/m, shape (4,).
    tumour_forces
        The same at each position over tumours, shape (p, 2 or 4), since charges depend on it; default: ``blank``.
    tissue
        s_j t_j of eq. PO.3, shape (m, q); default: the tissue is known. Not used with a baseline reading.
    channel_set
        The channels that are read; default: those of the protocol.

    Returns
    -------
    LinearGaussian
        Noise of m readings, in the order of ``scan_readings.compute_logarithms``; its unknowns are their common errors.

    Raises
    ------
    InputError
        A reading would have less noise than ``MIN_NOISE``, or charges are noisy and the scene has no load.
    """
    p = protocol.count
    # film forces at the place of the baseline reading, then at the p positions
    places = np.vstack([blank, np.tile(blank, (p, 1)) if tumour_forces is None else tumour_forces])
    channels = CHANNEL_INDICES[channel_set or protocol.channel_set]
    white_variances, gain_variances = (
        _compute_channel_variances(noise, channels, scene, places),
        compute_common_variances(noise, channels, blank),
    )
    common = white_variances[:, 0] if protocol.blank else gain_variances
    shared = np.repeat(np.diag(np.sqrt(common)), p, axis=0)
    if tissue is not None and not protocol.blank:
        shared = np.hstack([shared, tissue])
    return LinearGaussian.from_shared_errors(shared, white_variances[:, 1:].ravel())


def build_full_noise(
    noise: NoiseModel,
    protocol: Protocol,
    scene: Scene,
    blank: Floats,
    tumour_forces: Floats,
    *,
    channel_set: ChannelSet | None = None,
) -> LinearGaussian:
    """Return the noise of all readings, the baseline reading included (eq. PO.8).

    The arguments are those of ``build_difference_noise``.

    Returns
    -------
    LinearGaussian
        Noise of m readings in the order of ``scan_readings.compute_logarithms``, then of the c channels of a baseline reading.
    """
    channels = CHANNEL_INDICES[channel_set or protocol.channel_set]
    white_variances, common = (
        _compute_channel_variances(noise, channels, scene, np.vstack([blank, tumour_forces])),
        compute_common_variances(noise, channels, blank),
    )
    variances = np.concatenate([white_variances[:, 1:].ravel(), white_variances[:, 0]])
    gains = np.diag(np.sqrt(common))
    shared = np.concatenate([np.repeat(gains, len(tumour_forces), axis=0), gains])
    size = len(variances) - (0 if protocol.blank else len(common))
    return LinearGaussian.from_shared_errors(shared[:size], variances[:size])


def compute_reading_deviations(noise: NoiseModel, protocol: Protocol, scene: Scene, blank: Floats) -> Floats:
    """Return the standard deviations of one reading of ratio and stiffness, less the baseline reading if any, shape (2,)."""
    variances = np.maximum(compute_reading_variances(noise, scene, blank[None])[:, 0], MIN_NOISE**2)
    return np.asarray(np.sqrt((1 + protocol.blank) * variances))


def _compute_channel_variances(noise: NoiseModel, channels: tuple[int, ...], scene: Scene, places: Floats) -> Floats:
    """Return the variances w_c^2 of some channels at k places, shape (c, k).

    Parameters
    ----------
    noise
        Noise of the design file.
    channels
        Indices of the channels: 0 for the ratio, 1 for the stiffness.
    scene
        Scene with films and load.
    places
        Film forces, and charges where they are read, per unit indentation at each place, shape (k, 2 or 4).

    Raises
    ------
    InputError
        A reading would have less noise than ``MIN_NOISE``.
    """
    variances = compute_reading_variances(noise, scene, places)
    for channel in channels:
        variance = float(variances[channel].min())
        if not variance >= MIN_NOISE**2:
            allowed = f"{MIN_NOISE:g} or more: far below it the model's own error is all there is"
            raise InputError(f"noise.{WHITE_NOISE_KEYS[channel]}", math.sqrt(variance), allowed)
    return variances[list(channels)]


def compute_reading_variances(noise: NoiseModel, scene: Scene, places: Floats) -> Floats:
    """Return the variances w_c^2 of ratio and stiffness at k places with film forces and charges (k, 2 or 4), shape (2, k)."""
    charges = compute_film_charges(scene, places) if noise.charge else np.ones((len(places), 2))
    ratio = noise.white**2 + noise.tilt**2 + ((noise.charge / charges) ** 2).sum(axis=1)
    return np.stack([ratio, np.full_like(ratio, noise.stiffness_white**2)])


def compute_common_variances(noise: NoiseModel, channels: tuple[int, ...], blank: Floats) -> Floats:
    """Return the variance of the gain of some channels, shape (c,)."""
    return np.array([_compute_ratio_gain_variance(noise, blank), noise.stiffness_gain**2])[list(channels)]


def compute_film_charges(scene: Scene, places: Floats) -> Floats:
    """Return the charge of each film under the scene's load at k places, C, shape (k, 2).

    Parameters
    ----------
    scene
        Scene with films and load.
    places
        Film forces, and charges where they are read, per unit indentation at each place, shape (k, 2 or 4).

    Raises
    ------
    InputError
        The load is 0.
    """
    load, forces = scene.load, places[:, :2]
    indentation = load.find_indentation(forces.sum(axis=1))
    per_indentation = np.abs(places[:, 2:]) if places.shape[1] == 4 else find_charge_per_force(scene.probe) * np.abs(forces)
    charges = per_indentation * indentation[:, None]
    if not np.all(charges > 0):
        key = "force" if load.indentation is None else "indentation"
        raise InputError(f"load.{key}", getattr(load, key), f"a {key} above 0: at 0 the films give no charge to read")
    return np.asarray(charges)


def _compute_ratio_gain_variance(noise: NoiseModel, blank: Floats) -> float:
    """Return the variance of ln ratio due to the gains, from the calibration file if there is one, else 2 gain^2.

    The calibrated channels read y = M f with the gain matrix M and the film forces f. The variance of ln(y1 / y2) follows from
    its derivatives with respect to the four entries of M, and to the modulus of the films' bonds, and from their covariance.
    """
    if noise.calibration is None:
        return 2 * noise.gain**2
    matrix, entries, by_bonds = _read_calibration(noise.calibration)
    read = blank[-2:]  # charges, which come after the forces, where they are read
    fractions = read / np.abs(read).sum()
    first, second = matrix @ fractions
    gradient = np.concatenate([fractions / first, -fractions / second, by_bonds])
    return float(gradient @ entries @ gradient)


@lru_cache(maxsize=4)
def _read_calibration(path: str) -> tuple[Floats, Floats, Floats]:
    """Read the gain matrix M, shape (2, 2), and the covariance of its entries row by row, (n, n), from a calibration record.

    Where the modulus of the films' bonds is fitted, n is 5, and the third result holds the derivative of ln(y1 / y2) with respect
    to its logarithm; else n is 4, and it is empty.
    """
    from probe_design.built_probe.calibration_record import read_record

    gains = read_record(path).build_gains()
    by_bonds = [] if gains.bonds is None else [gains.bonds.film_derivatives[0] - gains.bonds.film_derivatives[1]]
    return gains.matrix, gains.covariance, np.array(by_bonds)
