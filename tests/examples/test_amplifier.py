"""The charge amplifier's noise budget: against the equations of the circuit's nodes, and the page's table."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from docs import make_amplifier
from docs.make_amplifier import CHANNELS, DRIVE_HZ, READING_S, Channel, compute_densities, compute_voltage_noise
from hw.signal.amplifier import ChargeAmplifier
from probe_design.data.noise import DEFAULT_CHARGE_NOISE_C
from tests.support.paths import DOCS


def solve_nodes(channel: Channel, frequency: float) -> dict[str, complex]:
    """The output for a unit of each source, at nodes film, input and output, behind an op-amp of gain 1e7."""
    w, gain = 2 * pi * frequency, 1e7
    loss = w * channel.film_capacitance * make_amplifier.LOSS_TANGENT
    series = 1 / make_amplifier.SERIES_OHM
    feedback = 1 / channel.feedback_resistance + 1j * w * channel.feedback_capacitance
    film = loss + 1j * w * channel.film_capacitance
    nodes = np.array(
        [
            [film + series, -series, 0],
            [-series, series + feedback + 1j * w * make_amplifier.STRAY_F, -feedback],
            [0, gain, 1],  # output = -gain x (input - noise voltage)
        ]
    )
    current, at_input, voltage = [1, 0, 0], [0, 1, 0], [0, 0, gain]
    sources = {"charge": current, "film's loss": current, "feedback resistor": at_input, "op-amp, current": at_input}
    sources |= {"op-amp, voltage": voltage, "series resistor": [-series, series, 0]}
    return {name: np.linalg.solve(nodes, source)[2] * (1j * w if name == "charge" else 1) for name, source in sources.items()}


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=CHANNELS)
def test_each_source_is_as_the_nodes_equations_have_it(channel: Channel) -> None:
    outputs = solve_nodes(channel, DRIVE_HZ)
    amplifier = ChargeAmplifier(channel.feedback_resistance, channel.feedback_capacitance)
    assert outputs["charge"] == pytest.approx(amplifier.response(DRIVE_HZ), rel=1e-3)
    thermal = 4 * 1.380649e-23 * 296
    densities = {
        "film's loss": sqrt(thermal * 2 * pi * DRIVE_HZ * channel.film_capacitance * 0.02),
        "feedback resistor": sqrt(thermal / channel.feedback_resistance),
        "op-amp, current": 0.6e-15,
        "op-amp, voltage": compute_voltage_noise(DRIVE_HZ),
        "series resistor": sqrt(thermal * 10e3),
    }
    stated = compute_densities(channel, DRIVE_HZ)
    for name, density in densities.items():
        expected = density * abs(outputs[name] / outputs["charge"])
        assert stated[name] == pytest.approx(expected, rel=0.15 if name == "series resistor" else 0.01), name
    assert stated["converter"] == pytest.approx(channel.converter_density / abs(outputs["charge"]), rel=0.01)


def test_voltage_noise_adds_up_to_that_of_the_data_sheet() -> None:
    frequencies = np.geomspace(0.1, 10, 2001)
    squares = [compute_voltage_noise(frequency) ** 2 for frequency in frequencies]
    assert 6.6 * sqrt(np.trapezoid(squares, frequencies)) == pytest.approx(2.8e-6, rel=1e-3)


def test_a_fitted_amplitude_has_the_root_of_density_over_time() -> None:
    """White noise of density 1 at 1 kS/s has a standard deviation of the root of 500."""
    times = np.arange(int(1000 * READING_S)) / 1000
    sines = np.column_stack([np.sin(2 * pi * DRIVE_HZ * times), np.cos(2 * pi * DRIVE_HZ * times)])
    assert 500 * np.linalg.inv(sines.T @ sines)[0, 0] == pytest.approx(1 / READING_S)


def test_the_default_charge_noise_is_within_reach() -> None:
    for channel in CHANNELS.values():
        total = sum(density**2 for density in compute_densities(channel, DRIVE_HZ).values()) / READING_S
        assert sqrt(total) < DEFAULT_CHARGE_NOISE_C


def test_the_page_shows_what_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    make_amplifier.print_budget()
    table, films = capsys.readouterr().out.split("\n\n")
    page = (DOCS / "guides" / "board.md").read_text(encoding="utf-8")
    assert table in page
    assert "28 um: 811 pF; noise 0.28 fC; 0.01 K/s shift it by 64 pC" in films
