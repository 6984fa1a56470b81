"""Read readings of the built probe as data for an estimate: each ratio with its noise and its shared error.

The noise n_i of a reading i is independent; errors c_i of calibration and amplifiers are shared by all readings that they serve.
The covariance is diag(n^2) + S with S_ii = c_i^2 and any correlation. As no correlation matrix of k readings has an eigenvalue
above k,

    S <= k diag(c^2)                                                                                     (BP.5)

and independent errors of sqrt(n_i^2 + k c_i^2) understate no combination of the readings: a shared error never averages out.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from hw.signal.fingerprint import Fingerprint
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.film_forces import compute_film_forces
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.probe_identity import describe_probe_difference, list_probe_numbers
from probe_design.built_probe.reading import StressReading, compute_reading
from solver.results.result import Result

MAX_NUMBER = 1e150  # so that its square does not overflow
MAX_PLACEMENT_M = 10.0
MAX_RELATIVE_SD = 1e3
MAX_LOG_BONDS = 10.0  # of ln of a factor on the bonds' modulus: 14 standard deviations of a tape's
MAX_FILE_BYTES = 1_000_000  # of what `read --json` prints
READING_ORIGIN = "what `probe-design read --json` has printed"
NO_SAMPLES = Fingerprint((), ())
READ_AGAIN_HINT = f"as {READING_ORIGIN}; read the recording again, with `probe-design read SCENE --replay FILE --json`"


@dataclass(frozen=True)
class FieldReading:
    """One reading of the probe over tissue.

    Attributes
    ----------
    ratio
        Of charges or stresses, as the scene reads.
    noise
        Relative standard deviation of ``ratio`` due to the reading's own noise.
    shared
        Relative standard deviation of ``ratio`` due to calibration and amplifiers.
    calibration
        SHA-256 of the calibration's file; None: nominal gains.
    force
        Of the load, N.
    placement
        x and y of the probe's axis, m, or None if not recorded.
    fingerprint
        Of its samples.
    log_bonds
        ln of the factor on the moduli of the films' bonds by the calibration; 0 where none was fitted.
    blank
        Whether its recording says that it is over tumour-free tissue.
    load
        Force that was to be pressed, N, as its recording says; None: the scene's load.
    """

    ratio: float
    noise: float
    shared: float
    calibration: str | None
    force: float
    placement: tuple[float, float] | None
    fingerprint: Fingerprint = NO_SAMPLES
    log_bonds: float = 0.0
    blank: bool = False
    load: float | None = None


def compute_ratio_noise(measurement: Measurement, scene: Scene, bench: Bench, gains: Gains | None) -> float:
    """Return the relative standard deviation of a ratio due to the reading's noise alone.

    Parameters
    ----------
    measurement
        Of both films.
    scene
        For its film.
    bench
        For the nominal gains.
    gains
        Of a calibration, here taken as exact; None: nominal.
    """
    used_gains = Gains.from_bench(bench) if gains is None else gains
    exact_gains = replace(used_gains, covariance=np.zeros_like(used_gains.covariance))
    films, noise = compute_film_forces(measurement, scene)
    log_ratio_derivatives = np.array([1.0, -1.0]) / exact_gains.compute_forces(films)  # of ln(F_inner / F_outer)
    return float(np.sqrt(log_ratio_derivatives @ exact_gains.compute_forces_covariance(films, noise) @ log_ratio_derivatives))


def build_reading_json(
    result: StressReading, noise: float, origin: JsonObject, scene: Scene, fingerprint: Fingerprint
) -> JsonObject:
    """Build the JSON object of `read`, including the data that an estimate needs.

    Parameters
    ----------
    result
        The reading.
    noise
        Of its ratio, relative.
    origin
        Its placement, scene, calibration and board.
    scene
        For the probe that was read.
    fingerprint
        Of the samples.
    """
    origin_fields = {key: origin.get(key) for key in ("placement", "scene_sha256", "calibration_sha256", "serial")}
    identity = {"probe": list_probe_numbers(scene), "fingerprint": fingerprint.as_dict()}
    return result.as_dict() | {"ratio_noise": noise} | origin_fields | identity


def build_reading_without_prediction(
    measurement: Measurement, scene: Scene, bench: Bench, gains: Gains | None, *, origin: JsonObject, fingerprint: Fingerprint
) -> JsonObject:
    """Build the JSON object of `read` for a reading whose scene was not evaluated.

    Parameters
    ----------
    measurement
        Of both films.
    scene
        For the probe.
    bench
        Of the measurement.
    gains
        Of a calibration; None: nominal.
    origin, fingerprint
        As for ``build_reading_json``.
    """
    result = compute_reading(measurement, scene, bench, Result("none", 0.0), gains)
    return build_reading_json(result, compute_ratio_noise(measurement, scene, bench, gains), origin, scene, fingerprint)


def parse_field_reading(contents: JsonObject, name: str, scene: Scene) -> FieldReading:
    """Build a reading from the JSON object of `read`.

    Parameters
    ----------
    contents
        The object.
    name
        Of its file, for messages.
    scene
        For the probe, which must be the same.

    Raises
    ------
    InputError
        The object is no reading, its ratio is null, or it is of another probe.
    """
    _check_probe(contents, name, scene)
    observable = contents.get("observable", "stress")  # older readings are of stresses
    if observable != scene.observable:
        kind = "charges" if scene.observable == "charge" else "stresses"
        read = f"a ratio of {kind}, which the scene reads ([reading] observable; by default charges of films with bonds)"
        raise InputError(f"{name}: observable", observable, f"{read}; read the recording again, with `probe-design read SCENE`")
    fingerprint = Fingerprint.from_dict(contents.get("fingerprint"))
    if fingerprint is None:
        entry = Words("missing" if "fingerprint" not in contents else "no fingerprint")
        raise InputError(f"{name}: fingerprint", entry, READ_AGAIN_HINT)
    if "ratio" in contents and contents["ratio"] is None:
        remedy = "press harder, read longer, or lower the noise of its charge ([noise] charge, the bench's amplifier)"
        raise InputError(f"{name}: ratio", Words("null"), f"a reading whose outer stress stands out: {remedy}")
    ratio, ratio_sd, force = (_get_number(contents, key, name) for key in ("ratio", "ratio_uncertainty", "force"))
    if not 0 < ratio_sd <= MAX_RELATIVE_SD * ratio:
        raise InputError(f"{name}: ratio", ratio, f"a ratio above 0, its uncertainty above 0, up to {MAX_RELATIVE_SD:g} of it")
    if not isinstance(contents.get("calibration_sha256"), str | None):
        raise InputError(f"{name}: calibration_sha256", contents["calibration_sha256"], f"a text, as {READING_ORIGIN}")
    relative_sd, place = ratio_sd / ratio, contents.get("placement")
    # the noise is a part of the whole uncertainty, so that rounding must not make it larger
    noise = 0.0 if contents.get("ratio_noise") is None else min(_get_number(contents, "ratio_noise", name), relative_sd)
    return FieldReading(
        ratio=ratio,
        noise=noise,
        shared=math.sqrt(max(relative_sd**2 - noise**2, 0.0)),
        calibration=contents.get("calibration_sha256"),
        force=force if contents.get("reference_force") is None else _get_number(contents, "reference_force", name),
        placement=None if place is None else _get_placement(place, name),
        fingerprint=fingerprint,
        log_bonds=0.0 if contents.get("log_bonds") is None else _get_number(contents, "log_bonds", name),
        blank=contents.get("blank") is True,
        load=None if contents.get("load") is None else _get_number(contents, "load", name),
    )


def read_result(path: Path) -> JsonObject | None:
    """Read the JSON object of a file; return None for another kind of file.

    Raises
    ------
    InputError
        The file cannot be read, or has the suffix .json and is no such object.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as fault:
        raise InputError("reading", str(path), f"a file that can be read ({fault.strerror})") from None
    has_json_name = path.suffix.lower() == ".json"
    if not has_json_name and not data.lstrip().startswith(b"{"):
        return None
    try:
        contents = json.loads(data)
    except (ValueError, RecursionError):
        if has_json_name:
            raise InputError("reading", str(path), READING_ORIGIN) from None
        return None
    if not isinstance(contents, dict) or "ratio" not in contents:
        raise InputError("reading", str(path), READING_ORIGIN)
    return contents


def check_different(key: str, readings: Sequence[tuple[str, Fingerprint]]) -> None:
    """Refuse one press that is given as two readings, in files of any name and format: its noise would be understated.

    Parameters
    ----------
    key
        For the message.
    readings
        File and fingerprint of each reading.

    Raises
    ------
    InputError
        Two readings are of the same samples.
    """
    for k, (name, fingerprint) in enumerate(readings):
        for earlier_name, earlier in readings[:k]:
            if fingerprint.is_same(earlier):
                allowed = f"another reading than {earlier_name}, which holds the same samples: give each reading once"
                raise InputError(key, name, allowed)


def _check_probe(contents: JsonObject, name: str, scene: Scene) -> None:
    """Refuse the JSON object of a reading whose probe differs from the scene's; ``name`` is the file's."""
    numbers = contents.get("probe")
    if not isinstance(numbers, dict):
        raise InputError(f"{name}: probe", Words("missing" if "probe" not in contents else "no table"), READ_AGAIN_HINT)
    difference = describe_probe_difference({key: float(value) for key, value in numbers.items() if _is_number(value)}, scene)
    if difference is not None:
        raise InputError("reading", name, f"one of the scene's probe: {difference}")


def find_common_bonds(readings: Sequence[FieldReading]) -> float:
    """Return ln of the factor on the moduli of the films' bonds, with which all readings are to be predicted.

    Raises
    ------
    InputError
        The readings have calibrations with different factors, or one that predictions cannot have.
    """
    factors = sorted({reading.log_bonds for reading in readings}) or [0.0]
    if len(factors) > 1:
        moduli = Words(f"with bonds of {math.exp(factors[0]):.3g} and {math.exp(factors[-1]):.3g} times the drawing's modulus")
        raise InputError("reading", moduli, "readings of one calibration, which states the modulus of the films' bonds")
    if abs(factors[0]) > MAX_LOG_BONDS:
        raise InputError("log_bonds", factors[0], f"a number from -{MAX_LOG_BONDS:g} to {MAX_LOG_BONDS:g}, {READING_ORIGIN}")
    return factors[0]


def compute_spreads(readings: Sequence[FieldReading]) -> tuple[float, ...]:
    """Return the relative standard deviations with which the readings may be treated as independent, eq. BP.5.

    The shared error of a reading is enlarged by sqrt(k), with k readings of the same calibration.
    """
    count = Counter(reading.calibration for reading in readings)
    return tuple(math.sqrt(reading.noise**2 + count[reading.calibration] * reading.shared**2) for reading in readings)


def _get_number(contents: JsonObject, key: str, name: str) -> float:
    """Return the number of a key; ``name`` is the file's. Raises ``InputError`` if it is missing or no number."""
    value = contents.get(key)
    if not _is_number(value):
        raise InputError(f"{name}: {key}", Words("missing") if key not in contents else value, f"a number, as {READING_ORIGIN}")
    return float(value)


def _is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a number whose square does not overflow."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < MAX_NUMBER


def _get_placement(place: Any, name: str) -> tuple[float, float]:
    """Return x and y of a placement, m; ``name`` is the file's. Raises ``InputError`` if it is no pair of finite lengths."""
    values = place if isinstance(place, list) else []
    if len(values) != 2 or not all(_is_number(value) and abs(value) <= MAX_PLACEMENT_M for value in values):
        raise InputError(f"{name}: placement", place, f"x and y in m, up to {MAX_PLACEMENT_M:g} m, as {READING_ORIGIN}")
    return float(values[0]), float(values[1])
