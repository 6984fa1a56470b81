"""Run `locate`: read the scan, prepare the model, infer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probe_design.estimation.measurements import Reading, read_readings
from probe_design.locating.forward_model import build_model
from probe_design.locating.inference import infer
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.scan_data import ScanData, TumourFree, check_readings
from probe_design.populations.design_file import Design
from probe_design.populations.noise import compute_reading_variances


def read_scan(path: Path, design: Design, tumour_free: TumourFree) -> tuple[Reading, ...]:
    """Return the readings of a scan; the design file's noise is that of readings that state none.

    Raises
    ------
    InputError
        The file or one of its entries is not allowed.
    """
    variances = compute_reading_variances(design.noise, tumour_free.scene, tumour_free.totals[None])[:, 0]
    noise, stiffness_noise = np.sqrt(variances).tolist()
    return read_readings(path, design.scene, noise, stiffness_noise, is_scan=True)


def run_locate(
    design: Design, scan: tuple[Reading, ...] | Path, outlier_rate: float, seed: int, *, advise: bool,
    model: ForwardModel | None = None,
) -> Location:  # fmt: skip
    """Return the tumours that explain a scan, see ``probe_design.locate``.

    Parameters
    ----------
    design
        Probe, tissue, population and noise.
    scan
        Readings, or the path of their file.
    outlier_rate
        Expected fraction of wild readings.
    seed
        Of the random numbers.
    advise
        Whether to choose the next place.
    model
        Predicts readings; default: the table of the probe on the tissue.
    """
    tumour_free = TumourFree.from_design(design)
    readings = read_scan(scan, design, tumour_free) if isinstance(scan, Path) else scan
    check_readings(readings)
    data = ScanData.from_readings(readings, design, tumour_free)
    prior = TumourPrior.from_design(design, data.positions[~data.is_baseline])
    known_model = build_model(prior) if model is None else model
    likelihood = Likelihood(data, known_model, prior, outlier_rate)
    return infer(likelihood, tumour_free, seed, advise=advise)
