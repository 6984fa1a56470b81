"""A forward model in closed form with the shape of the true one: for tests of the inference alone."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats


class StandInModel:
    """Signals fall with depth and distance, grow with diameter^3 and contrast; those of several tumours add."""

    error = np.zeros(2)
    scale_error = np.zeros(2)

    def predict(self, tumours: Floats, positions: Floats) -> Floats:
        x, y, depth, diameter, modulus = np.moveaxis(tumours[..., None], -2, 0)
        squared = ((x - positions[:, 0]) ** 2 + (y - positions[:, 1]) ** 2) / (0.8 * depth) ** 2
        strength = (diameter / depth) ** 3 * (modulus - 5.3e3) / (modulus + 8e3)
        ratio = 0.25 * strength * (1 - 0.2 * squared) * np.exp(-squared)
        stiffness = 0.12 * strength * np.exp(-squared / 2)
        return np.stack([ratio.sum(axis=1), stiffness.sum(axis=1)], axis=-1)

    def slopes(self, tumours: Floats, positions: Floats) -> Floats:
        step = 1e-6
        changes = [
            self.predict(tumours, positions + step * axis) - self.predict(tumours, positions - step * axis) for axis in np.eye(2)
        ]
        return np.stack(changes, axis=-1) / (2 * step)
