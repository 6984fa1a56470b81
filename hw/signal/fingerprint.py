"""Identify a reading, in whatever file it is stored, by a fingerprint of its first samples.

The noise of a film is the residual of a linear prediction from its previous samples. The signs of its projections on fixed random
vectors are a similarity hash (M. S. Charikar, STOC 2002, 380): for two noise vectors at an angle a, the fraction a / pi of all
signs differs, one half for independent noise. Rounding to fewer digits, another unit and another file format change few signs or
none; a second press at the same place changes half of them. Beginnings of several lengths are used. The longest one that both
readings have is compared, so that a shortened copy is recognised, too.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.samples import FILM_NAMES, Floats, Samples

FINGERPRINT_ROWS = 1 << 13  # samples of each film that are used: 0.8 s at 10 kS/s
BEGINNING_LENGTHS = tuple(1 << k for k in range(6, 14))  # samples in a beginning: from the minimum of a fit to all that are used
PREDICTOR_ORDER = 12  # previous samples that predict the next: enough for the load, its harmonics and the mains
HASH_BITS = 128
MIN_DIFFERENT_BITS = 32  # signs: a quarter of all, 5.7 standard deviations below the half of independent noise
SAME_VOLTS = 5e-4  # relative: rounding and the scale of a sound file cause less


@dataclass(frozen=True)
class Fingerprint:
    """The fingerprint of a reading's first samples.

    Attributes
    ----------
    noise
        128 signs in hexadecimal for each beginning of ``BEGINNING_LENGTHS`` that the reading has; "" without noise.
    volts
        Standard deviation of each film's voltage in each of them, V, inner and outer.
    """

    noise: tuple[str, ...]
    volts: tuple[tuple[float, float], ...]

    @classmethod
    def from_samples(cls, samples: Samples) -> Self:
        """Compute the fingerprint of samples from the reading's begin on; they must have both films."""
        films = np.nan_to_num(samples.select_channels(FILM_NAMES).volts[:FINGERPRINT_ROWS], posinf=0.0, neginf=0.0)
        beginnings = [films[:length] for length in BEGINNING_LENGTHS if length <= len(films)]
        deviations = (beginning.std(axis=0) for beginning in beginnings)
        return cls(tuple(map(_compute_signs, beginnings)), tuple((float(inner), float(outer)) for inner, outer in deviations))

    @classmethod
    def from_dict(cls, contents: Any) -> Self | None:
        """Read the result of ``as_dict``; return None for anything else."""
        try:
            noise = tuple(contents["noise"])
            volts = tuple((float(inner), float(outer)) for inner, outer in contents["volts"])
            sizes = {len(bytes.fromhex(signs)) for signs in noise}
            is_valid = len(noise) == len(volts) <= len(BEGINNING_LENGTHS) and sizes <= {0, HASH_BITS // 8}
            return cls(noise, volts) if is_valid else None
        except (KeyError, TypeError, ValueError, OverflowError):
            return None

    def as_dict(self) -> dict[str, object]:
        """Return the fingerprint as a JSON object."""
        return asdict(self)

    def is_same(self, other: Fingerprint) -> bool:
        """Whether both fingerprints are of the same samples, by the longest beginning that both have."""
        beginnings = list(zip(self.noise, other.noise, self.volts, other.volts, strict=False))
        if not beginnings:
            return False
        signs, other_signs, volts, other_volts = beginnings[-1]
        if not signs or not other_signs or not np.allclose(volts, other_volts, rtol=SAME_VOLTS, atol=0):
            return False
        return (int(signs, 16) ^ int(other_signs, 16)).bit_count() < MIN_DIFFERENT_BITS  # number of signs that differ


def _compute_signs(films: Floats) -> str:
    """Return the signs of projections of both films' noise (n, 2) on fixed vectors, in hexadecimal; "" without noise."""
    noise = np.concatenate([_compute_noise(film) for film in films.T])
    if not noise.any():
        return ""
    return np.packbits(_build_vectors(len(noise)) @ noise > 0).tobytes().hex()


def _compute_noise(volts: Floats) -> Floats:
    """Return the residual of a linear prediction of a film's voltage, scaled to unit variance, shape (n - PREDICTOR_ORDER,)."""
    spread = volts.std()
    if spread == 0:
        return np.zeros(len(volts) - PREDICTOR_ORDER)
    scaled = (volts - volts.mean()) / spread
    past = np.lib.stride_tricks.sliding_window_view(scaled, PREDICTOR_ORDER)[:-1]
    residual = scaled[PREDICTOR_ORDER:] - past @ np.linalg.lstsq(past, scaled[PREDICTOR_ORDER:], rcond=None)[0]
    size = residual.std()
    return np.asarray(residual / size if size > 0 else np.zeros_like(residual))


@cache
def _build_vectors(length: int) -> NDArray[np.float32]:
    """Return fixed vectors of +1 and -1, shape (HASH_BITS, length), from a hash function: the same on every computer."""
    bits = np.frombuffer(hashlib.shake_128(b"probe-design").digest(HASH_BITS * length // 8 + 1), dtype=np.uint8)
    return np.unpackbits(bits)[: HASH_BITS * length].reshape(length, HASH_BITS).T.astype(np.float32) * 2 - 1
