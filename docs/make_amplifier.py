"""Draw the charge amplifier of ``docs/guides/board.md``, and print its noise budget.

``python docs/make_amplifier.py`` prints; with ``--draw`` it draws, too.

Noise is referred to the film's charge: the standard deviation of the amplitude of a sine, fitted to T = 1 s of samples, which is
the square root of the one-sided density at its frequency over T. The circuit is linear and its sources independent; the density
of each source, through the circuit's response, is divided by that of a charge at the input (``compute_densities``).

Sources of the figures:

- OPA2320: https://ti.com/document-viewer/OPA2320/datasheet/specifications.html, typical; at 5 Hz from the noise of 0.1 to 10 Hz;
- ADS131M04: table 7-1 of the ADS131M04-Q1's data sheet, ZHCSOL7A, at 0.25 kS/s, where 1/f noise counts most; range 1.2 V / gain;
- RP2040: input-referred noise of 0.97 LSB rms of 12 bits at 3.3 V, measured, https://pico-adc.markomo.me; taken as white;
- PVDF: Piezo Film Sensors, technical manual, table 1: relative permittivity 12, loss tangent 0.02 at 1 kHz, 30 uC/(m2 K).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from math import pi, sqrt
from pathlib import Path

BOLTZMANN, TEMPERATURE_K = 1.380649e-23, 296.0
PICTURE = Path(__file__).parent / "pictures" / "charge-amplifier.svg"
DRIVE_HZ, READING_S = 5.0, 1.0
SMALLEST_C, LARGEST_C = 65e-12 * 0.01, 200e-12 * 0.3  # 65 to 200 pC/N on tape (film-charges.md), 0.01 to 0.3 N
WHITE_VOLTAGE, PEAK_TO_PEAK_V, CURRENT = 8.5e-9, 2.8e-6, 0.6e-15  # V/sqrt(Hz) at 1 kHz; V, 0.1 to 10 Hz; A/sqrt(Hz): OPA2320
RMS_IN_PEAK_TO_PEAK = 6.6  # of Gaussian noise, by convention
PERMITTIVITY, LOSS_TANGENT = 12 * 8.8541878128e-12, 0.02
PYROELECTRIC, WARMING_K_PER_S = 30e-6, 0.01  # C/(m2 K); a film that is touched, 0.1 K in 10 s
SERIES_OHM, STRAY_F = 10e3, 110e-12  # 1 m of coaxial cable, 100 pF, diodes and inputs


@dataclass(frozen=True)
class Channel:
    """A film, its amplifier and its converter; SI units.

    Attributes
    ----------
    feedback_resistance, feedback_capacitance
        Rf and Cf.
    converter_density
        Noise of the converter, V/sqrt(Hz).
    count, rate
        V per count of the protocol's 16 bits, and samples per second; a count of 0 leaves their rounding out.
    range
        Largest amplitude that the converter takes, V.
    film_radius, film_thickness
        Of the electrodes.
    """

    feedback_resistance: float
    feedback_capacitance: float
    converter_density: float
    count: float
    rate: float
    range: float
    film_radius: float = 8.25e-3
    film_thickness: float = 28e-6

    @property
    def film_capacitance(self) -> float:
        """Capacitance of the film, F."""
        return PERMITTIVITY * pi * self.film_radius**2 / self.film_thickness


GAIN_1 = {"converter_density": 1.90e-6 / sqrt(125.0), "count": 2.4 / 65536, "rate": 4000.0, "range": 1.2}
GAIN_4 = {"converter_density": 1.56e-6 / sqrt(125.0), "count": 0.6 / 65536, "rate": 4000.0, "range": 0.3}
RP2040 = {"converter_density": 0.97 * 3.3 / 4096 / sqrt(50e3), "count": 0.0, "rate": 100e3, "range": 1.6}
BOARD = Channel(1e9, 1e-9, **GAIN_4)
CHANNELS = {
    "1 nF, 1 GΩ, ADS131M04 at gain 4": BOARD,
    "100 pF, 10 GΩ, ADS131M04 at gain 1": Channel(10e9, 100e-12, **GAIN_1),
    "1 nF, 1 GΩ, RP2040's own converter": Channel(1e9, 1e-9, **RP2040),
}


def compute_voltage_noise(frequency: float) -> float:
    """Return the op-amp's voltage noise, V/sqrt(Hz): white and 1/f, the latter from the noise between 0.1 and 10 Hz."""
    flicker = (PEAK_TO_PEAK_V / RMS_IN_PEAK_TO_PEAK) ** 2 - WHITE_VOLTAGE**2 * 9.9
    return sqrt(WHITE_VOLTAGE**2 + flicker / 4.605 / frequency)  # 4.605 = ln(10 / 0.1)


def compute_densities(channel: Channel, frequency: float) -> dict[str, float]:
    """Return the noise density of each source, referred to the film's charge, C/sqrt(Hz)."""
    w, thermal = 2 * pi * frequency, 4 * BOLTZMANN * TEMPERATURE_K
    film, feedback = channel.film_capacitance, abs(1 / channel.feedback_resistance + 1j * w * channel.feedback_capacitance)
    total = abs(1 / channel.feedback_resistance + 1j * w * (channel.feedback_capacitance + film + STRAY_F))  # siemens
    rounding = channel.count / sqrt(12) / sqrt(channel.rate / 2)
    return {
        "feedback resistor": sqrt(thermal / channel.feedback_resistance) / w,
        "op-amp, voltage": compute_voltage_noise(frequency) * total / w,
        "op-amp, current": CURRENT / w,
        "film's loss": sqrt(thermal * LOSS_TANGENT * film / w),
        "series resistor": sqrt(thermal * SERIES_OHM) * (film + STRAY_F),
        "converter": channel.converter_density * feedback / w,
        "rounding to 16 bits": rounding * feedback / w,
    }


def print_budget() -> None:
    """Print the table of the page."""
    budgets = {name: compute_densities(channel, DRIVE_HZ) for name, channel in CHANNELS.items()}
    totals = {name: sqrt(sum(value**2 for value in budget.values())) / sqrt(READING_S) for name, budget in budgets.items()}
    rows = [
        (source, [budget[source] / sqrt(READING_S) * 1e15 for budget in budgets.values()])
        for source in next(iter(budgets.values()))
    ]
    rows.append(("all", [1e15 * total for total in totals.values()]))
    rows.append(("largest charge, pC", [1e12 * channel.range * channel.feedback_capacitance for channel in CHANNELS.values()]))
    rows.append(
        ("output at 200 pC/N, 0.3 N, mV", [1e3 * LARGEST_C / channel.feedback_capacitance for channel in CHANNELS.values()])
    )
    rows.append(("65 pC/N, 10 mN over noise", [SMALLEST_C / total for total in totals.values()]))
    print(f"| fC in {READING_S:g} s at {DRIVE_HZ:g} Hz | {' | '.join(CHANNELS)} |\n|---|{'---|' * len(CHANNELS)}")
    for name, values in rows:
        print(f"| {name} | {' | '.join(f'{value:.2g}' if value < 10 else f'{value:.0f}' for value in values)} |")
    print()
    for radius, thickness in ((4e-3, 110e-6), (8.25e-3, 28e-6), (8.25e-3, 9e-6)):
        channel = replace(BOARD, film_radius=radius, film_thickness=thickness)
        total = sqrt(sum(value**2 for value in compute_densities(channel, DRIVE_HZ).values()) / READING_S)
        drift = PYROELECTRIC * pi * radius**2 * WARMING_K_PER_S * channel.feedback_resistance * channel.feedback_capacitance
        film = f"radius {1e3 * radius:g} mm, {1e6 * thickness:g} um: {1e12 * channel.film_capacitance:.0f} pF"
        print(f"{film}; noise {1e15 * total:.2f} fC; {WARMING_K_PER_S} K/s shift it by {1e12 * drift:.0f} pC")


def draw_schematic(path: Path) -> None:
    """Draw the amplifier of one film, with part values, as an SVG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"], mpl.rcParams["svg.fonttype"] = "probe-design", "none"
    figure = Figure(figsize=(9.4, 4.4))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0.2, 19.0), ylim=(0.4, 9.2), aspect="equal")
    axes.axis("off")

    def wire(*points: tuple[float, float]) -> None:
        axes.plot(*zip(*points, strict=True), color="black", lw=1.3, solid_capstyle="round")

    def dot(x: float, y: float) -> None:
        axes.plot([x], [y], "o", color="black", ms=4)

    def text(x: float, y: float, label: str, **style: object) -> None:
        axes.text(x, y, label, **({"ha": "center", "va": "center", "fontsize": 9.5} | style))

    def resistor(x: float, y: float, label: str, vertical: bool = False) -> None:
        width, height = (0.4, 1.2) if vertical else (1.2, 0.4)
        axes.fill(*zip(*_corners(x, y, width, height), strict=True), facecolor="white", edgecolor="black", lw=1.3, zorder=3)
        text(x + 0.4 if vertical else x, y if vertical else y + 0.55, label, ha="left" if vertical else "center")

    def capacitor(x: float, y: float, label: str, vertical: bool = False) -> None:
        for side in (-0.12, 0.12):
            ends = [(x - 0.45, y + side), (x + 0.45, y + side)] if vertical else [(x + side, y - 0.45), (x + side, y + 0.45)]
            wire(*ends)
        gap = _corners(x, y, 0.9, 0.2) if vertical else _corners(x, y, 0.2, 0.9)
        axes.fill(*zip(*gap, strict=True), color="white", zorder=2.5)
        text(x + 0.65 if vertical else x, y if vertical else y + 0.75, label, ha="left" if vertical else "center")

    def diode(x: float, y: float, up: bool) -> None:
        sign = 1 if up else -1
        corners = [(x - 0.3, y - 0.25 * sign), (x + 0.3, y - 0.25 * sign), (x, y + 0.25 * sign)]
        axes.fill(*zip(*corners, strict=True), facecolor="white", edgecolor="black", lw=1.3, zorder=3)
        wire((x - 0.3, y + 0.25 * sign), (x + 0.3, y + 0.25 * sign))

    def ground(x: float, y: float, label: str = "") -> None:
        for k, half in enumerate((0.35, 0.22, 0.09)):
            wire((x - half, y - 0.14 * k), (x + half, y - 0.14 * k))
        text(x, y - 0.6, label)

    # film and cable
    wire((1.6, 5.2), (1.6, 1.5), (14.7, 1.5), (14.7, 4.7))
    capacitor(1.6, 3.9, "", vertical=True)
    text(0.55, 3.9, "film", rotation=90)
    text(3.0, 1.9, "shield")
    wire((1.6, 5.2), (4.6, 5.2), (8.6, 5.2))
    for y in (4.85, 5.55):
        axes.plot([2.3, 3.7], [y, y], "--", color="black", lw=1)
    text(2.6, 6.05, "coaxial, at most 1 m")
    resistor(5.0, 5.2, "Rs  10 kΩ")
    # clamps to the reference
    for x, up in ((6.5, True), (7.3, False)):
        dot(x, 5.2)
        wire((x, 5.2), (x, 3.0))
        diode(x, 4.1, up)
    wire((6.5, 3.0), (7.3, 3.0), (8.1, 3.0), (8.1, 4.2), (8.6, 4.2))
    dot(7.3, 3.0)
    text(4.6, 3.8, "D1  BAV199\npin 3 at the input,\n1 and 2 below", fontsize=8.5)
    # op-amp
    axes.fill([8.6, 8.6, 11.2], [5.8, 3.6, 4.7], facecolor="white", edgecolor="black", lw=1.5, zorder=3)
    text(8.85, 5.2, "−", zorder=4), text(8.85, 4.2, "+", zorder=4), text(9.55, 4.7, "U1 ½\nOPA2320", fontsize=7.5, zorder=4)
    wire((9.6, 5.4), (9.6, 6.05)), text(9.85, 6.2, "+3.3 V", fontsize=8.5)
    wire((9.6, 4.0), (9.6, 3.4)), ground(9.6, 3.4)
    # feedback
    dot(7.9, 5.2)
    wire((7.9, 5.2), (7.9, 8.3), (12.0, 8.3), (12.0, 4.7))
    wire((7.9, 7.0), (12.0, 7.0))
    dot(7.9, 7.0), dot(12.0, 7.0)
    resistor(10.0, 8.3, "Rf  1 GΩ")
    capacitor(10.0, 7.0, "Cf  1 nF C0G")
    # output filter and converter
    wire((11.2, 4.7), (15.9, 4.7))
    dot(12.0, 4.7), dot(14.7, 4.7)
    resistor(13.4, 4.7, "Ra  1 kΩ")
    capacitor(14.7, 3.7, "", vertical=True)
    text(13.6, 3.7, "Ca\n10 nF")
    axes.fill(*zip(*_corners(17.2, 4.2, 2.6, 2.2), strict=True), facecolor="white", edgecolor="black", lw=1.5, zorder=3)
    text(17.2, 4.2, "converter\nADS131M04\ngain 4", fontsize=8.5, zorder=4)
    wire((14.7, 2.6), (15.4, 2.6), (15.4, 3.7), (15.9, 3.7))
    # reference
    wire((7.3, 3.0), (7.3, 1.5))
    dot(7.3, 1.5), dot(14.7, 2.6)
    text(
        10.0,
        0.95,
        "reference 1.25 V: an op-amp as follower, 1 µF to ground; the guard ring around the thick node is on it",
        fontsize=8.5,
    )
    axes.plot([6.2, 8.6], [5.2, 5.2], color="black", lw=2.6)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def _corners(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    """Return the corners of a rectangle about a point."""
    return [(x + a * width / 2, y + b * height / 2) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


if __name__ == "__main__":
    print_budget()
    if "--draw" in sys.argv[1:]:
        draw_schematic(PICTURE)
