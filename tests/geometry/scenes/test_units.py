"""Quantities: what is read, to the last digit of SI values worked out by hand, and that nothing else ever happens."""

from __future__ import annotations

import math
from datetime import timedelta

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.units import UNIT_FACTORS, Quantity, find_factor_by_pint

POSITION = Quantity("position", "m", "mm", -10.0, 10.0)
MODULUS = Quantity("modulus", "Pa", "Pa", 1e-3, 1e13)
FORCE = Quantity("force", "N", "N", 0.0, 1e9)
ANGLE = Quantity("angle", "rad", "deg", -math.pi, math.pi)
CHARGE = Quantity("charge per force", "C/N", "pC/N", -1e-8, 1e-8)
WARMING = Quantity("temperature change", "K", "K", 1e-6, 100.0)
KINDS = [LENGTH_QUANTITY, POSITION, MODULUS, FORCE, ANGLE, CHARGE]


class TestReading:
    @pytest.mark.parametrize(
        ("kind", "text", "value"),
        [
            (LENGTH_QUANTITY, "5 mm", 0.005),
            (LENGTH_QUANTITY, "5mm", 0.005),
            (LENGTH_QUANTITY, " 5 mm ", 0.005),
            (LENGTH_QUANTITY, "5\tmm\n", 0.005),
            (LENGTH_QUANTITY, "5e-3 m", 0.005),
            (LENGTH_QUANTITY, "5E-3m", 0.005),
            (LENGTH_QUANTITY, "0.5 cm", 0.005),
            (LENGTH_QUANTITY, ".5 cm", 0.005),
            (LENGTH_QUANTITY, "5. mm", 0.005),
            (LENGTH_QUANTITY, "+5 mm", 0.005),
            (LENGTH_QUANTITY, "5000 um", 0.005),
            (LENGTH_QUANTITY, "5000 \N{MICRO SIGN}m", 0.005),
            (LENGTH_QUANTITY, "5000 \N{GREEK SMALL LETTER MU}m", 0.005),
            (LENGTH_QUANTITY, "5 millimetre", 0.005),
            (LENGTH_QUANTITY, "5 millimeters", 0.005),
            (LENGTH_QUANTITY, "5 mm^1", 0.005),
            (LENGTH_QUANTITY, "5 mm**2/mm", 0.005),
            (LENGTH_QUANTITY, "5 mm * mm / mm", 0.005),
            (LENGTH_QUANTITY, "1 inch", 0.0254),
            (LENGTH_QUANTITY, "1 in", 0.0254),
            (POSITION, "-3 mm", -0.003),
            (POSITION, "-0 mm", 0.0),
            (MODULUS, "1 kPa", 1e3),
            (MODULUS, "2.5 GPa", 2.5e9),
            (MODULUS, "1 bar", 1e5),
            (MODULUS, "1 N/mm^2", 1e6),
            (MODULUS, "1 N/mm**2", 1e6),
            (MODULUS, "1 psi", 0.45359237 * 9.80665 / 0.0254**2),
            (FORCE, "10 mN", 0.01),
            (FORCE, "1 kg m/s^2", 1.0),
            (FORCE, "1 kgf", 9.80665),
            (ANGLE, "90 deg", math.pi / 2),
            (ANGLE, "90 degree", math.pi / 2),
            (ANGLE, "90\N{DEGREE SIGN}", math.pi / 2),
            (ANGLE, "100 mrad", 0.1),
            (ANGLE, "0.25 turn", math.pi / 2),
            (CHARGE, "20 pC/N", 20e-12),
            (CHARGE, "-20 pm/V", -20e-12),  # C/N = (N m / V) / N
        ],
    )
    def test_by_hand(self, kind: Quantity, text: str, value: float) -> None:
        assert kind.parse(text) == pytest.approx(value, rel=4e-16)

    def test_bounds_pass_through_any_unit(self) -> None:
        for text in ("10 m", "10000 mm", "1e7 um", "0.01 km", "1000 cm"):
            assert LENGTH_QUANTITY.parse(text) == LENGTH_QUANTITY.high
        for text in ("1 nm", "1e-6 mm", "1e-9 m", "1e-12 km"):
            assert LENGTH_QUANTITY.parse(text) == LENGTH_QUANTITY.low
        with pytest.raises(ValueError, match=r"^out of range$"):
            LENGTH_QUANTITY.parse("10000.0001 mm")


class TestRefusals:
    @pytest.mark.parametrize(
        ("kind", "text", "reason"),
        [
            (LENGTH_QUANTITY, "5", "the unit is missing"),
            (LENGTH_QUANTITY, "5.0e3", "the unit is missing"),
            (LENGTH_QUANTITY, "", "not a number with a unit"),
            (LENGTH_QUANTITY, " ", "not a number with a unit"),
            (LENGTH_QUANTITY, "mm", "not a number with a unit"),
            (LENGTH_QUANTITY, "five mm", "not a number with a unit"),
            (LENGTH_QUANTITY, "--5 mm", "not a number with a unit"),
            (LENGTH_QUANTITY, "(5) mm", "not a number with a unit"),
            (LENGTH_QUANTITY, "\N{FULLWIDTH DIGIT FIVE} mm", "not a number with a unit"),
            (LENGTH_QUANTITY, "5 " + "m" * 100, "not a number with a unit"),
            (LENGTH_QUANTITY, "5 Pa", "'Pa' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 mm^2", "'mm^2' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 m/m", "'m/m' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 MM", "'MM' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 milli meter", "'milli meter' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 m rad", "'m rad' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 if", "'if' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 nan", "'nan' is no unit that converts to m"),
            (LENGTH_QUANTITY, "5 degC", "'degC' is no unit that converts to m"),
            (LENGTH_QUANTITY, "1/2 mm", "'/2 mm' is no unit"),
            (LENGTH_QUANTITY, "5,0 mm", "',0 mm' is no unit"),
            (LENGTH_QUANTITY, "5 mm.real", "'mm.real' is no unit"),
            (LENGTH_QUANTITY, "5 mm²", "'mm²' is no unit"),
            (LENGTH_QUANTITY, "5 mm^99", "'mm^99' is no unit"),
            (LENGTH_QUANTITY, "5 __import__", "'__import__' is no unit"),
            (LENGTH_QUANTITY, "nan mm", "not a finite number"),
            (LENGTH_QUANTITY, "-inf mm", "not a finite number"),
            (LENGTH_QUANTITY, "1e999 mm", "not a finite number"),
            (LENGTH_QUANTITY, "1e-999 mm", "out of range"),
            (LENGTH_QUANTITY, "0e99999999999999999999 mm", "out of range"),
            (LENGTH_QUANTITY, "1e-99999999999999999999 mm", "out of range"),
            (LENGTH_QUANTITY, "0.1 mm^0", "'mm^0' is no unit"),
            (LENGTH_QUANTITY, "0.1 mm**-0", "'mm**-0' is no unit"),
            (WARMING, "0.1 degC", "'degC' is no unit that converts to K"),
            (WARMING, "0.1 degF", "'degF' is no unit that converts to K"),
            (LENGTH_QUANTITY, "0 mm", "out of range"),
            (LENGTH_QUANTITY, "-1 mm", "out of range"),
            (LENGTH_QUANTITY, "5 Mm", "out of range"),
            (FORCE, "-1 N", "out of range"),
            (FORCE, "1 kg", "'kg' is no unit that converts to N"),
            (ANGLE, "0.1", "the unit is missing"),
            (ANGLE, "0.1 m/m", "'m/m' is no unit that converts to rad"),
            (ANGLE, "0.1 sr", "'sr' is no unit that converts to rad"),
            (ANGLE, "0.1 count", "'count' is no unit that converts to rad"),
        ],
    )
    def test_states_the_reason(self, kind: Quantity, text: str, reason: str) -> None:
        with pytest.raises(ValueError) as fault:  # noqa: PT011 - the whole text is compared
            kind.parse(text)
        assert str(fault.value) == reason

    @pytest.mark.timeout(10)
    @pytest.mark.parametrize(
        "unit",
        [
            "a   " * 18 + "!",  # blanks with several places in a pattern take exponential time
            "m" + " " * 70 + "!",
            "m*" * 36 + "m",
            "Qm^9*Qm^9*m^-9*m^-8",  # 1e30^18 overflows
            "m^9*m^9*m/qm^9/qm^9",
        ],
    )
    def test_tricky_units_are_refused_at_once(self, unit: str) -> None:
        with pytest.raises(ValueError, match=r"no unit|not a finite number|out of range"):
            LENGTH_QUANTITY.parse(f"5 {unit}")

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10.1, 0.0, -1.0])
    def test_floats(self, value: float) -> None:
        with pytest.raises(ValueError, match=r"not a finite number|out of range"):
            LENGTH_QUANTITY.check(value)


@st.composite
def kinds_and_values(draw: st.DrawFn) -> tuple[Quantity, float]:
    kind = draw(st.sampled_from(KINDS))
    return kind, draw(st.floats(kind.low, kind.high))


class TestWriting:
    @given(kinds_and_values())
    @settings(max_examples=500)
    def test_reads_back_as_the_same_float(self, pair: tuple[Quantity, float]) -> None:
        kind, value = pair
        assert kind.parse(kind.format_value(value)) == value

    @pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
    def test_bounds_and_their_neighbours(self, kind: Quantity) -> None:
        for bound in (kind.low, kind.high):
            for value in (bound, math.nextafter(bound, 0.0), bound * (1 - 1e-13)):
                held = kind.check(value)
                assert kind.parse(kind.format_value(held)) == held

    def test_in_the_usual_unit_where_that_is_exact(self) -> None:
        assert (LENGTH_QUANTITY.format_value(0.005), CHARGE.format_value(20e-12), ANGLE.format_value(math.pi / 2)) == (
            "5 mm",
            "20 pC/N",
            "90 deg",
        )


UNITS = st.text(st.sampled_from("mkNPaµ°radeg*/^ -0123456789._()[]'\"eE%\t\n!"), max_size=90)


class TestGarbage:
    @given(st.one_of(st.text(max_size=100), UNITS, st.builds("{} {}".format, st.floats(), UNITS)), st.sampled_from(KINDS))
    @settings(max_examples=1000, deadline=timedelta(seconds=5))
    @example("5 " + "m/" * 39, LENGTH_QUANTITY)
    @example("\x00", LENGTH_QUANTITY)
    @example("5 \ud800", LENGTH_QUANTITY)
    def test_nothing_but_a_value_in_range_or_a_value_error(self, text: str, kind: Quantity) -> None:
        try:
            value = kind.parse(text)
        except ValueError:
            return
        assert kind.low <= value <= kind.high


@pytest.mark.parametrize(
    ("text", "si"), [("3.53 mm", 0.00353), ("8.01 mm", 0.00801), ("110 um", 0.00011), ("0.1 mm", 0.0001), ("35.3 cm", 0.353)]
)
def test_decimal_lengths_are_the_nearest_float(text: str, si: float) -> None:
    assert LENGTH_QUANTITY.parse(text) == si


@pytest.mark.parametrize(("unit", "si"), [(unit, si) for si, units in UNIT_FACTORS.items() for unit in units])
def test_usual_units_are_what_pint_says(unit: str, si: str) -> None:
    assert UNIT_FACTORS[si][unit] == find_factor_by_pint(unit, si)
