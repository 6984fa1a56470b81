"""Measured curves of stress against deformation: which tests there are, and what a curve must hold.

The invariant I = tr(F^T F) of an incompressible body and the energy W(I - 3) give the stress of each test, for the deformation s:

    uniaxial:     I = s^2 + 2/s,       P = W' dI/ds
    equibiaxial:  I = 2 s^2 + s^-4,    P = W' dI/ds / 2
    simple shear: I = 3 + s^2,         P = W' dI/ds                                                  (MF.1)

with the stretch s, in simple shear the tangent of the angle, and the nominal stress P, force over undeformed area. The true
stress is P s under tension and compression, and P in simple shear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from probe_design.material_fit.kinds import StressKind, Test

MIN_POINTS = 5  # points: three constants and as much again to see a misfit
MAX_STRETCH = 10.0  # the stretch up to which laws are tested for stability; soft silicones break there
MAX_BACK_STEP_RELATIVE = 0.02  # of the range: jitter of a gauge; more is an unloading branch


@dataclass(frozen=True)
class StressCurve:
    """A measured curve.

    Attributes
    ----------
    test
        How the sample was loaded.
    deformation
        Stretches, or the tangents of the angle in simple shear; shape (n,).
    stress
        Nominal stress, Pa, tension positive; shape (n,).
    """

    test: Test
    deformation: Floats
    stress: Floats

    @property
    def distortion(self) -> Floats:
        """I - 3 at each point, shape (n,)."""
        s = self.deformation
        if self.test == "shear":
            return np.asarray(s**2)
        return np.asarray((2 * s**2 + s**-4 if self.test == "equibiaxial" else s**2 + 2 / s) - 3)

    @property
    def stress_factor(self) -> Floats:
        """P / W' of eq. MF.1 at each point, shape (n,)."""
        s = self.deformation
        if self.test == "shear":
            return np.asarray(2 * s)
        return np.asarray(2 * s - 2 * s**-5 if self.test == "equibiaxial" else 2 * s - 2 / s**2)

    def describe_range(self) -> str:
        """Return the test and its range in words, such as "tension, stretches from 1.02 to 2"."""
        measure = "shears" if self.test == "shear" else "stretches"
        return f"{self.test}, {measure} from {self.deformation.min():.4g} to {self.deformation.max():.4g}"


def build_curve(test: Test, deformation: Floats, stress: Floats, kind: StressKind, max_strain: float | None) -> StressCurve:
    """Return a checked curve.

    Parameters
    ----------
    test
        How the sample was loaded.
    deformation
        Stretches or shears, shape (n,), in the order of the measurement.
    stress
        Pa, shape (n,), of ``kind``; under compression of either sign.
    max_strain
        |stretch - 1| or shear beyond which points are left out; None: none are.

    Raises
    ------
    InputError
        The points are no curve of that test.
    """
    if test == "bonded-compression":
        remedy = "'compression' of a lubricated sample; a bonded one is strained unevenly, so that its curve gives no law"
        raise InputError("test", test, remedy)
    if not (np.isfinite(deformation).all() and np.isfinite(stress).all()):
        (row, *_) = np.flatnonzero(~(np.isfinite(deformation) & np.isfinite(stress)))
        raise InputError("curve", Words(f"no number in row {row + 1} of {deformation.size}"), "finite numbers in every row")
    unloaded = 0.0 if test == "shear" else 1.0
    _check_stretches(test, deformation)
    if test == "compression" and stress.sum() > 0:  # written as a pressure
        stress = -stress
    kept = np.abs(deformation - unloaded) <= (np.inf if max_strain is None else max_strain)
    deformation, stress = deformation[kept], stress[kept]
    _check_loading(deformation, unloaded)
    nominal = stress / deformation if kind == "true" and test != "shear" else stress
    if np.dot(nominal, deformation - unloaded) <= 0:
        raise InputError("stress", Words("against the deformation"), "a stress that rises with the strain: tension above 0")
    return StressCurve(test, deformation, nominal)


def _check_stretches(test: Test, deformation: Floats) -> None:
    """Raise ``InputError`` for stretches that this test cannot have."""
    low, high = float(deformation.min()), float(deformation.max())
    if test == "shear":
        if low < -1e-6 or high > MAX_STRETCH:
            raise InputError("shear", low if low < 0 else high, f"from 0 to {MAX_STRETCH:g}, displacement over height")
        return
    if low <= 0:
        raise InputError("stretch", low, "above 0: length over undeformed length; a strain belongs in a column 'strain'")
    if not 1 / MAX_STRETCH <= low <= high <= MAX_STRETCH:
        value = high if high > MAX_STRETCH else low
        raise InputError("stretch", value, f"{1 / MAX_STRETCH:g} to {MAX_STRETCH:g}; a strain in per cent needs the unit %")
    if test in ("tension", "equibiaxial") and low < 1 - 1e-3:
        raise InputError("stretch", low, f"at least 1 in {test}; --test compression below 1, --test uniaxial for both")
    if test == "compression" and high > 1 + 1e-3:
        raise InputError("stretch", high, "at most 1 in compression; --test tension above 1, --test uniaxial for both")


def _check_loading(deformation: Floats, unloaded: float) -> None:
    """Raise ``InputError`` for too few points, or for rows that go back as unloading does."""
    count = np.unique(deformation[np.abs(deformation - unloaded) > 1e-9]).size
    if count < MIN_POINTS:
        raise InputError("curve", Words(f"{count} strained points"), f"at least {MIN_POINTS} different stretches besides 1")
    steps = np.diff(deformation) * np.sign(deformation[-1] - deformation[0] or 1.0)
    if steps.min(initial=0.0) < -MAX_BACK_STEP_RELATIVE * np.ptp(deformation):
        row = int(np.argmin(steps)) + 2
        raise InputError("curve", Words(f"row {row} goes back"), "rows in rising strain: keep one loading branch, and sort it")
