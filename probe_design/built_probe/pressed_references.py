"""Compare readings on a bench's references with their predictions, for a calibration or a check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from hw.signal.measure import Measurement
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, predict_blocks
from probe_design.built_probe.film_forces import build_observation
from probe_design.built_probe.gain_matrix import Observation
from probe_design.built_probe.load_checks import apply_loads, check_reference_loads
from probe_design.built_probe.phase_lags import list_lag_warnings


@dataclass(frozen=True)
class PressedReferences:
    """Readings on references and the predictions under their loads.

    Attributes
    ----------
    observations
        One for each reference.
    predictions
        For the references that are blocks of tissue, under the loads that were read.
    lag_warnings
        See ``phase_lags.list_lag_warnings``.
    warnings
        Of loads, waveforms and lags, one line each.
    """

    observations: tuple[Observation, ...]
    predictions: BlockPredictions
    lag_warnings: tuple[str, ...]
    warnings: tuple[str, ...]

    @classmethod
    def from_measurements(
        cls, scene: Scene, bench: Bench, references: Sequence[Reference], measurements: Sequence[Measurement],
        shares: BlockPredictions | None, *, linear: bool,
    ) -> PressedReferences:  # fmt: skip
        """Compare the loads of readings with the expected ones, and predict the blocks under them.

        Parameters
        ----------
        scene
            The probe as drawn.
        bench
            Of the readings.
        references
            Of the bench, all or the blocks of tissue alone.
        measurements
            By ``film_forces.measure_strict_reading``, one on each reference.
        shares
            The predictions without load, if they are known already.
        linear
            Whether to accept loads whose finite strain may change a prediction by more than 0.8 %; it is counted anyway.

        Raises
        ------
        InputError
            There is not one reading for each reference, or a load is 30 times the expected one or a 30th of it.
        Refusal
            The axisymmetric evaluator cannot compute the probe, or a load is above the limit of linear elasticity.
        """
        if not references or len(measurements) != len(references):
            kind = "references" if len(references) == len(bench.reference) else "blocks of tissue, at least one"
            raise InputError("readings", len(measurements), f"one for each of the bench's {len(references)} {kind}")
        pairs = zip(measurements, references, strict=True)
        observations = tuple(build_observation(measurement, reference, scene) for measurement, reference in pairs)
        predictions = predict_blocks(scene, bench.reference) if shares is None else shares
        load_warnings = check_reference_loads(observations, predictions, scene)
        predictions = apply_loads(predictions, observations, load_warnings, linear)
        lag_warnings = tuple(list_lag_warnings(measurements, references, bench))
        waveform_warnings = _list_waveform_warnings(measurements, references)
        return cls(observations, predictions, lag_warnings, (*load_warnings, *waveform_warnings, *lag_warnings))


def _list_waveform_warnings(measurements: Sequence[Measurement], references: Sequence[Reference]) -> tuple[str, ...]:
    """List the warnings of all readings, each with the names of the references on which it occurs."""
    names_by_text: dict[str, list[str]] = {}
    for measurement, reference in zip(measurements, references, strict=True):
        for text in measurement.warnings:
            names_by_text.setdefault(text, []).append(reference.name)
    return tuple(f"{', '.join(names)}: {text}" for text, names in names_by_text.items())
