"""Read every place under each load of a protocol: the scene at each, and the noise and signals of all readings together.

A load is one more reading of each place. Its white noise and its baseline reading are its own; the gains, and what is unknown of
the tissue, are common to all. The readings are ordered by load, and under each load as ``ScanReadings`` are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from geometry.common.arrays import Floats, Numeric
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.scan_readings import ScanReadings
from probe_design.populations.tables import Protocol


def list_loaded_scenes(scene: Scene, protocol: Protocol) -> tuple[Scene, ...]:
    """Return a scene under each load of a protocol, none above the scene's own force; the scene itself without loads."""
    forces = limit_loads(protocol, np.inf if scene.load.force is None else scene.load.force)
    return tuple(scene.model_copy(update={"load": Load(force=force)}) for force in forces) or (scene,)


def limit_loads(protocol: Protocol, force: float) -> list[float]:
    """Return the loads of a protocol, N, with the force, N, in place of those above it."""
    return [min(load, force) for load in protocol.loads]


def join_noise(parts: Sequence[LinearGaussian], *, common: bool) -> LinearGaussian:
    """Return the noise of the readings under all loads from that under each.

    ``common`` says whether they have the same shared errors, as gains are; otherwise each has its own, as those of the baseline
    readings are.
    """
    if len(parts) == 1:
        return parts[0]
    columns = [part.derivatives for part in parts]
    shared = np.concatenate(columns) if common else block_diag(*columns)
    return LinearGaussian.from_shared_errors(shared, np.concatenate([part.variance for part in parts]))


def join_signals(parts: Sequence[ScanReadings]) -> Floats:
    """Return the signals of n tumours under all loads, shape (n, loads x m)."""
    return np.concatenate([part.signal for part in parts], axis=1)


def combine_variances(parts: Sequence[Numeric]) -> Numeric:
    """Return the variance of the mean of readings of one signal, weighted by their inverse variances; arrays of one shape.

    Linear elasticity predicts the same signal under all loads: their mean contains all that they say.
    """
    return parts[0] if len(parts) == 1 else 1 / sum(1 / part for part in parts)
