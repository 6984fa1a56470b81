"""Predict the readings of a scan over tumours from a table: the public face of the tables."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.calls import check_call
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.tumour_ranges import TumourRanges

SUPERPOSITION_ERROR_RELATIVE = 0.02  # of effects of tumours 0.5 mm apart or more; measured rms 0.013 (benchmarks.locating)


@dataclass(frozen=True)
class PredictedReadings:
    """Changes of the readings of n candidates at k positions against tissue without tumours.

    Attributes
    ----------
    log_ratio, log_stiffness
        Changes of the logarithms of the ratio (of charges or stresses, as the scene reads) and of the force per indentation,
        shape (n, k) each.
    error
        Root mean square error of either, relative to its size, shape (2,).
    """

    log_ratio: Floats
    log_stiffness: Floats
    error: Floats


@check_call
def predict_readings(
    scene: Scene | Path | str, tumours: Floats, positions: Floats, ranges: TumourRanges | None = None
) -> PredictedReadings:
    """Predict how tumours change the readings of a scan, for many candidates at once, some 100 000 a second.

    A table of the probe and tissue is built first, in 0.3 s for a single tumour and up to a minute for wide ranges, and cached on
    disk. Effects of several tumours add.

    Parameters
    ----------
    scene
        The probe and its tissue, or the name of a scene file; of its inclusions only Poisson's ratio is used.
    tumours
        n candidates of m tumours each: x, y, depth, diameter in m, Young's modulus in Pa; shape (n, m, 5).
    positions
        x and y of the probe's axis, m, shape (k, 2).
    ranges
        What the table covers; left out, the lowest and highest numbers of ``tumours``. Calls with the same ranges share a table.

    Returns
    -------
    PredictedReadings
        By ``equivalent-inclusion`` with reflections; by ``contact`` where the scene's load changes the ratio by more than 1 %.

    Raises
    ------
    InputError
        Numbers that are not finite or outside the ranges; tumours that touch, leave the tissue or have too little cover.
    Refusal
        The evaluator cannot model the scene, or its tissue is so narrow that effects do not decay within it.

    Examples
    --------
    >>> from probe_design import predict_readings
    >>> tumour = [3e-3, 0, 10e-3, 8e-3, 25e3]
    >>> predict_readings("examples/scene.toml", [[tumour]], [[0, 0], [8e-3, 0]]).log_ratio  # doctest: +SKIP
    """
    scene, candidates, places = load_scene(scene), _read_array("tumours", tumours), _read_array("positions", positions)
    if candidates.ndim != 3 or candidates.shape[2] != 5 or not candidates.size or not np.all(np.isfinite(candidates)):
        shape = f"an array of shape {candidates.shape}" if candidates.ndim != 3 or not candidates.size else "not all finite"
        raise InputError("tumours", Words(shape), "finite numbers of shape (candidates, tumours of each, 5)")
    if places.ndim != 2 or places.shape[1] != 2 or not np.all(np.isfinite(places)):
        raise InputError("positions", Words(f"an array of shape {places.shape}"), "finite x and y, m, of shape (positions, 2)")
    table = read_or_build_table(scene, ranges or _find_ranges(scene, candidates))
    signals = table.predict(candidates, places)
    allowed = table.is_allowed(candidates)
    if not np.all(allowed):
        number = int(np.flatnonzero(~allowed)[0])
        raise InputError("tumours", Words(f"candidate {number}"), "tumours inside the tissue and at least 0.5 mm apart")
    exchange = SUPERPOSITION_ERROR_RELATIVE if candidates.shape[1] > 1 else 0.0
    return PredictedReadings(signals[..., 0], signals[..., 1], np.hypot(table.error, table.scale_error) + exchange)


def _read_array(name: str, values: object) -> Floats:
    """Return numbers as an array; raise ``InputError`` for anything else."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, values, "numbers in SI units, in rows of one length") from None


def _find_ranges(scene: Scene, candidates: Floats) -> TumourRanges:
    """Return the lowest and highest numbers of candidates, with the cover that they have."""
    depth, diameter, modulus = (candidates[..., column] for column in (2, 3, 4))
    depths, diameters, moduli = ((float(values.min()), float(values.max())) for values in (depth, diameter, modulus))
    cover = max(float((depth - diameter / 2).min()), 0.0)
    nu = scene.inclusion[0].poisson_ratio if scene.inclusion else scene.tissue.poisson_ratio
    return TumourRanges(depths, diameters, moduli, poisson_ratio=nu, min_cover=cover)
