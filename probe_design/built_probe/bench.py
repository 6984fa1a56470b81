"""Describe the measuring bench: load, amplifier, reference force, reference blocks, and the uncertainty of each.

A bench file (TOML) looks like ``probe_design/data/bench.toml``, the built-in bench.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from geometry.common.text_files import parse_tables, read_tables
from geometry.scenes.file_kinds import check_kind
from geometry.scenes.quantities import Frozen, Length, Modulus
from geometry.scenes.units import PERCENTAGE, Quantity
from geometry.scenes.validation_messages import convert_error
from hw.signal.amplifier import ChargeAmplifier, FilmAmplifiers

Frequency = Annotated[float, Quantity("frequency", "Hz", "Hz", 1e-3, 1e5)]
Resistance = Annotated[float, Quantity("resistance", "ohm", "ohm", 1e3, 1e15)]
Capacitance = Annotated[float, Quantity("capacitance", "F", "pF", 1e-14, 1.0)]
Sensitivity = Annotated[float, Quantity("sensitivity", "V/N", "V/N", 1e-9, 1e9)]
Warming = Annotated[float, Quantity("temperature change", "K", "K", 1e-6, 100.0)]
Fraction = Annotated[float, PERCENTAGE, Field(ge=0.0, le=1.0, description="a number from 0 to 1, such as 0.02 or 2 %")]
Skew = Annotated[float, Quantity("time", "s", "us", -1.0, 1.0)]
SkewTolerance = Annotated[float, Quantity("time", "s", "us", 0.0, 1.0)]
Radius = Annotated[float, Quantity("radius", "m", "mm", 0.0, 1.0)]
KnownForce = Annotated[float, Quantity("force", "N", "mN", 1e-9, 1e6)]
ReferenceKind = Literal["tissue", "inner", "outer"]
ReferenceContact = Literal["frictionless", "stuck"]
SIGNIFICANT_SD = 3.0  # standard deviations from which a charge, a lag or a difference is significant
CONTRADICTION_SD = 5.0  # standard deviations from which two statements contradict each other
# fraction of a pin's or ring's load on the other block, 1 sd: 1 % occurs, and is within 95 % (docs/guides/calibrate.md)
DEFAULT_LEAK_SD = 0.007


class Shaker(Frozen):
    """The sinusoidal load.

    Attributes
    ----------
    frequency
        Of the drive, Hz; the fit corrects it.
    frequency_tolerance
        Relative standard deviation of the drive's frequency; a larger difference is reported as a wrong sampling rate.
    least_cycles
        Minimum periods of the load in a reading for a calibration.
    most_warming
        Maximum temperature change of a film during such a reading, K.
    """

    frequency: Frequency = 5.0
    frequency_tolerance: Fraction = 0.001
    least_cycles: Annotated[float, Field(ge=3.0, le=1e6, description="a number from 3 to 1e6")] = 20.0
    most_warming: Warming = 0.1


class OwnAmplifier(Frozen):
    """The properties in which one film's amplifier differs from ``Amplifier``; None where it does not."""

    resistance: Resistance | None = None
    capacitance: Capacitance | None = None
    resistance_tolerance: Fraction | None = None
    capacitance_tolerance: Fraction | None = None


class Amplifier(Frozen):
    """The charge amplifiers, equal within the tolerances of their parts (relative standard deviations), or one for each film."""

    resistance: Resistance = 1e9
    capacitance: Capacitance = 1e-9
    resistance_tolerance: Fraction = 0.05
    capacitance_tolerance: Fraction = 0.02
    inner: OwnAmplifier | None = None
    outer: OwnAmplifier | None = None

    def build_films(self) -> FilmAmplifiers:
        """Build the inner film's and the outer film's amplifier."""
        common = self.model_dump(exclude={"inner", "outer"})  # values of both amplifiers, unless one film overrides them
        overrides = [{} if film is None else film.model_dump(exclude_none=True) for film in (self.inner, self.outer)]
        return ChargeAmplifier(**common | overrides[0]), ChargeAmplifier(**common | overrides[1])


class Sampling(Frozen):
    """The sampling times of the channels.

    Attributes
    ----------
    skew
        Time by which the outer film's channel is sampled later than the inner's, s; corrected.
    skew_tolerance
        Standard deviation of ``skew``, s.
    """

    skew: Skew = 0.0
    skew_tolerance: SkewTolerance = 1e-6


class ReferenceForce(Frozen):
    """The force channel.

    Attributes
    ----------
    sensitivity
        V/N.
    tolerance
        Relative standard deviation of the sensitivity, as its maker states it.
    verified
        Whether a known load has confirmed it; if not, and no reference has a known load, its scale is unknown.
    delay
        Delay of the channel behind the inner film's by a digital filter, s, below 0 if it is sampled later; corrected.
    """

    sensitivity: Sensitivity
    tolerance: Fraction = 0.005
    verified: bool = False
    delay: Skew = 0.0


class Channels(Frozen):
    """The uncertainty of the two channels before a calibration, and their stability after it.

    Attributes
    ----------
    gain
        Relative standard deviation of each film's charge per force about the nominal.
    cross_talk
        Standard deviation of the fraction of one film's force that shows in the other channel.
    warming
        Standard deviation of each film's temperature about that of its calibration, K.
    """

    gain: Fraction = 0.05
    cross_talk: Fraction = 0.01
    warming: Warming = 1.0


class Workshop(Frozen):
    """Tolerances of manufacture: standard deviations of every length (m), modulus (relative) and Poisson's ratio.

    Without ``length``, each block's lengths have the tightest tolerance of its process, no less than 0.02 mm; see
    ``geometry.workshop.tolerance.find_length_sd``. Thicknesses and the modulus of films and bonds are relative, and so is
    ``film_piezo``, of d31, d32 and d33: makers and batches differ in their ratios, while a calibration determines one scale of
    all. The modulus of the soft bonds is not among them: a calibration determines it, too.
    """

    length: Length | None = None
    modulus: Fraction = 0.02
    poisson_ratio: Fraction = 0.003
    film_thickness: Fraction = 0.05
    bond_thickness: Fraction = 0.1
    film_modulus: Fraction = 0.2
    film_poisson_ratio: Fraction = 0.03
    film_piezo: Fraction = 0.1


class Reference(Frozen):
    """A reference to press on.

    Attributes
    ----------
    on
        ``tissue``, a block of the scene's tissue's shape and Poisson's ratio without inclusion; ``inner``, a pin that touches the
        inner block alone; ``outer``, a ring that touches the outer block alone.
    youngs_modulus
        Of the tissue, Pa.
    tolerance
        Relative standard deviation of the modulus.
    leak
        Of a pin or ring, the standard deviation of the fraction of its load on the other block; None: the default
        ``DEFAULT_LEAK_SD``, or the fraction in the other film's channel if that is more.
    inner_radius, outer_radius
        Of a pin's or ring's flat end, m; left out, those of the fixture that ``export --fixture`` makes.
    contact
        Of a pin or ring with the block; left out, either is possible, and the difference of the charges counts as an error.
    known_force
        Amplitude of the load, N, if it is known independently: of a shaken mass, or a spring of known stiffness.
    known_force_tolerance
        Relative standard deviation of ``known_force``.
    """

    on: ReferenceKind = "tissue"
    youngs_modulus: Modulus | None = None
    tolerance: Fraction = 0.01
    leak: Fraction | None = None
    inner_radius: Radius | None = None
    outer_radius: Radius | None = None
    contact: ReferenceContact | None = None
    known_force: KnownForce | None = None
    known_force_tolerance: Annotated[
        float, PERCENTAGE, Field(ge=1e-6, le=1.0, description="a number from 1e-6 to 1, such as 0.01 or 1 %")
    ] = 0.01

    @model_validator(mode="after")
    def _check_modulus(self) -> Self:
        """Refuse a pin or ring with a modulus, a block of tissue without one, and a block of tissue with a leak."""
        if (self.youngs_modulus is None) == (self.on == "tissue"):
            entry = Words("missing" if self.on == "tissue" else f"given beside on = '{self.on}'")
            raise InputError("youngs_modulus", entry, "given for on = 'tissue', and for nothing else")
        for key in ("leak", "inner_radius", "outer_radius", "contact") if self.on == "tissue" else ():
            if getattr(self, key) is not None:
                raise InputError(key, getattr(self, key), "given for a pin or a ring, and for nothing else")
        return self

    @property
    def leak_sd(self) -> float:
        """Standard deviation of the fraction of a pin's or ring's load that the other block carries; 0 on tissue."""
        return 0.0 if self.on == "tissue" else DEFAULT_LEAK_SD if self.leak is None else self.leak

    @property
    def name(self) -> str:
        """Name of the reference for tables and messages."""
        if self.youngs_modulus is None:
            known = "" if self.known_force is None else f", {1e3 * self.known_force:.4g} mN"
            return {"inner": "pin on the inner block", "outer": "ring on the outer block"}[self.on] + known
        return f"block of {self.youngs_modulus / 1e3:.6g} kPa"


class Bench(Frozen):
    """All properties of a measurement that are not in the scene."""

    load: Shaker = Shaker()
    amplifier: Amplifier = Amplifier()
    sampling: Sampling = Sampling()
    force: ReferenceForce | None = None
    channels: Channels = Channels()
    workshop: Workshop = Workshop()
    reference: Annotated[tuple[Reference, ...], Field(strict=False, min_length=1, max_length=100)]

    @property
    def blocks(self) -> tuple[Reference, ...]:
        """The references that are blocks of tissue."""
        return tuple(reference for reference in self.reference if reference.on == "tissue")


def read_builtin_bench() -> Bench:
    """Return the built-in bench."""
    text = files("probe_design.data").joinpath("bench.toml").read_text(encoding="utf-8")
    return bench_from_dict(parse_tables(text, "bench.toml", "TOML"))


def read_bench(path: Path | str) -> Bench:
    """Read a bench file. Raises ``InputError`` if it cannot be read or is not valid."""
    contents = read_tables(path, "bench file", "a TOML file like probe_design/data/bench.toml")
    check_kind(contents, str(path), "bench file", "a bench file, like probe_design/data/bench.toml")
    return bench_from_dict(contents)


def bench_from_dict(data: JsonObject) -> Bench:
    """Build a bench from the tables of a bench file. Raises ``InputError`` for an invalid entry."""
    try:
        return Bench.model_validate(data, context={"units_required": True})
    except ValidationError as refused:
        raise convert_error(refused, Bench, "bench") from None
