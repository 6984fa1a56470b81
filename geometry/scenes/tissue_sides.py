"""Compute how far points in a tissue are from its sides."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene_tables import Tissue


def compute_side_distance(tissue: Tissue, x: Floats | float, y: Floats | float) -> Floats:
    """Return the distance of points x, y in the scene's axes from the tissue's nearest side, m; infinite in a half-space."""
    if tissue.shape == "cylinder":
        return np.asarray(tissue.radius - np.hypot(x, y))
    if tissue.shape == "block":
        return np.asarray(np.minimum(tissue.length / 2 - np.abs(x), tissue.breadth / 2 - np.abs(y)))
    return np.full(np.shape(x), np.inf)
