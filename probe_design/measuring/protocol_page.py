"""Draw the calibration protocol as one page: what to press, with which load, the expected signals, and the commands.

Its numbers are computed for the probe and the bench: expected signals reveal an exchanged cable at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import fixture
from geometry.cad.solids import PART_COLOURS
from geometry.common.percent import format_percent
from geometry.provenance.texts import build_picture_metadata
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.scene import Scene
from geometry.workshop.parts import build_section_outlines
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import compute_inner_fractions, predict_blocks
from probe_design.built_probe.reference_charges import compute_charge_units, find_pin_load

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PAGE_NAME = "calibration.pdf"
SHEET_SIZE_INCHES = (8.27, 11.69)  # inches: A4
DEFAULT_LOAD_N = 0.01  # where neither scene nor blocks limit it
MAX_ROWS = 20  # references that fit on the page


@dataclass(frozen=True)
class ExpectedSignal:
    """The expected signal on a reference: its name, the load's amplitude, N, the inner film's fraction, both amplitudes, V."""

    name: str
    load: float
    inner_fraction: float
    volts: tuple[float, float]


def compute_expected_signals(scene: Scene, bench: Bench) -> tuple[ExpectedSignal, ...]:
    """Compute the expected signals on the bench's references at the scene's force, or less on a soft block.

    Raises
    ------
    Refusal
        The axisymmetric evaluator cannot compute the probe.
    """
    predictions = predict_blocks(scene, bench.reference, variables=())
    limits = dict(zip(bench.blocks, predictions.list_reference_loads(), strict=True))
    load = scene.load.amplitude or min(limits.values(), default=DEFAULT_LOAD_N)
    limits |= {item: find_pin_load(scene, item) for item in bench.reference if item.on != "tissue"}
    loads = [item.known_force or min(load, limits[item]) for item in bench.reference]
    pressed = predictions.apply_forces(loads, bench.reference, linear=False)
    sums = [math.exp(factor.log) for factor in pressed.load_factors] or [1.0] * len(loads)
    responses = [amplifier.response(bench.load.frequency) for amplifier in bench.amplifier.build_films()]
    inner, outer = abs(compute_charge_units(scene) * responses).tolist()
    parts = compute_inner_fractions(pressed.log_ratios, bench.reference).tolist()
    return tuple(
        ExpectedSignal(item.name, force, part, (force * total * inner * part, force * total * outer * (1 - part)))
        for item, force, total, part in zip(bench.reference, loads, sums, parts, strict=True)
    )


def build_writers(scene: Scene, bench: Bench, name: str) -> dict[str, Callable[[Path], object]]:
    """Return, by file name, the functions that write the fixture's parts and the page; ``name`` is the scene's file.

    Raises
    ------
    InputError
        A block is too narrow for the fixture.
    MissingLibrary
        See ``geometry.cad.solids.load_cadquery``.
    Refusal
        The axisymmetric evaluator cannot compute the probe.
    """
    page = partial(draw_page, scene.probe, bench, compute_expected_signals(scene, bench), name)
    return {**fixture.build_writers(scene.probe), PAGE_NAME: page}


def draw_page(probe: Probe, bench: Bench, expected: Sequence[ExpectedSignal], name: str, path: Path) -> Path:
    """Write the page as a PDF, or as a picture by the path's suffix; return ``path``.

    Parameters
    ----------
    probe
        As drawn.
    bench
        For load, channels and references.
    expected
        Expected signals on its references.
    name
        Name of the scene's file, which the printed commands contain.
    path
        Of the new file.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=SHEET_SIZE_INCHES, facecolor="white")
    figure.text(0.07, 0.955, "Calibration of a tactile probe", fontsize=17, weight="bold")
    figure.text(0.07, 0.948, _format_headline(probe, name), fontsize=8.5, va="top")
    for column, (part, title) in enumerate((("pin", "pin: inner block alone"), ("ring", "ring: outer block alone"))):
        _draw_section(figure.add_axes((0.05 + 0.46 * column, 0.69, 0.44, 0.215)), probe, part, title)
    _draw_table(figure, expected[:MAX_ROWS])
    foot = 0.645 - 0.0185 * (min(len(expected), MAX_ROWS) + 2)  # y below the table, as a fraction of the page's height
    for line, text in enumerate(_list_steps(bench, expected, name)):
        mono = text.startswith("   $")
        figure.text(0.07, foot - 0.0168 * line, text, fontsize=8.3 if mono else 9, family="monospace" if mono else None)
    figure.text(
        0.07,
        0.03,
        "date                         by                              probe no.                         room, °C",
        fontsize=9,
    )
    kind = path.suffix.removeprefix(".") or "pdf"
    figure.savefig(path, format=kind, dpi=150, metadata=build_picture_metadata(kind))
    return path


def _format_headline(probe: Probe, name: str) -> str:
    """Format the scene's name and the probe's dimensions and moduli."""
    radii = (
        f"inner radius {format_mm(probe.inner_radius)}, gap {format_mm(probe.gap)}, outer radius {format_mm(probe.tube_radius)}"
    )
    heights = f"heights {format_mm(probe.core_height)} and {format_mm(probe.tube_height)}"
    moduli = f"moduli {probe.inner.youngs_modulus / 1e3:.4g} and {probe.outer.youngs_modulus / 1e3:.4g} kPa"
    return f"{name[:90]}\n{radii}; {heights}; {moduli}"


def _draw_section(axes: Axes, probe: Probe, part: str, title: str) -> None:
    """Draw the section of the probe on a fixture's part, with the sleeve up (dashed) and down; lengths in mm, z upwards.

    Parameters
    ----------
    axes
        To draw on.
    probe
        As drawn.
    part
        "pin" or "ring".
    title
        Above the picture.
    """
    sizes = fixture.find_fixture_sizes(probe)
    for name, polygons in build_section_outlines(probe).items():
        for polygon in polygons:
            axes.fill(*zip(*polygon, strict=True), facecolor=(*PART_COLOURS[name], 0.75), edgecolor="0.2", lw=0.5)
    for polygon in _build_pressing_outlines(sizes, part):
        axes.fill(*zip(*polygon, strict=True), facecolor=(*PART_COLOURS[part], 0.8), edgecolor="0.2", lw=0.5)
    low = -fixture.CARRIER_RISE_MM - sizes.sleeve
    for bottom, style in ((low, "-"), (-fixture.CARRIER_RISE_MM - fixture.SLEEVE_GRIP_MM, "--")):
        for side in (-1, 1):
            inner, outer = side * sizes.bore, side * (sizes.bore + fixture.SLEEVE_WALL_MM)
            x, z = (inner, outer, outer, inner, inner), (bottom, bottom, *2 * (bottom + sizes.sleeve,), bottom)
            axes.plot(x, z, style, color="0.35", lw=0.9)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=9.5, loc="left")
    axes.text(
        0.5, -0.03, "sleeve: up to centre (dashed), down to read", transform=axes.transAxes, fontsize=7.5, ha="center", va="top"
    )


def _build_pressing_outlines(sizes: fixture.FixtureSizes, part: str) -> list[list[tuple[float, float]]]:
    """Build the outlines, mm, of the carrier with its pin or ring, as corners of rectangles."""
    low, top, foot = -fixture.CARRIER_RISE_MM - sizes.sleeve, -fixture.CARRIER_RISE_MM, sizes.carrier + fixture.SLEEVE_WALL_MM
    boxes = [(-foot, foot, low - fixture.FOOT_HEIGHT_MM, low), (-sizes.carrier, sizes.carrier, low, top)]
    inner, outer = sizes.ring
    boxes += [(-sizes.pin, sizes.pin, top, 0.0)] if part == "pin" else [(-outer, -inner, top, 0.0), (inner, outer, top, 0.0)]
    return [[(x_low, z_low), (x_high, z_low), (x_high, z_high), (x_low, z_high)] for x_low, x_high, z_low, z_high in boxes]


def _draw_table(figure: Figure, expected: Sequence[ExpectedSignal]) -> None:
    """Draw the table of references in their order, with a box to tick."""
    columns = (
        (0.07, "reference, in this order"),
        (0.40, "load, mN"),
        (0.52, "inner, mV"),
        (0.64, "outer, mV"),
        (0.76, "inner's fraction"),
        (0.90, "read"),
    )
    for x, heading in columns:
        figure.text(x, 0.655, heading, fontsize=9, weight="bold")
    for k, signal in enumerate(expected):
        y = 0.655 - 0.0185 * (k + 1)
        cells = (
            f"{k + 1}  {signal.name}",
            f"{1e3 * signal.load:.3g}",
            *(f"{1e3 * amplitude:.3g}" for amplitude in signal.volts),
            f"{signal.inner_fraction:.3f}",
        )
        for (x, _), cell in zip(columns, (*cells, "\N{WHITE SQUARE}"), strict=True):
            figure.text(x, y, cell, fontsize=9)


def _list_steps(bench: Bench, expected: Sequence[ExpectedSignal], name: str) -> list[str]:
    """List the lines of the protocol's steps; lines with a $ are commands, with ``name``, the scene's file."""
    # 20 % more than the minimum number of periods
    seconds = max(10.0, 1.2 * bench.load.least_cycles / bench.load.frequency)
    slack, play = fixture.RING_ALIGNMENT_MM, fixture.SLEEVE_PLAY_MM
    count, channels = len(expected), bench.channels
    known = ", ".join(format_percent(item, 6) for item in sorted({item.tolerance for item in bench.blocks})) or "no block"
    return [
        f"Amplitudes: a sinusoidal load of {bench.load.frequency:g} Hz; signals at nominal gain,",
        f"± {format_percent(channels.gain, 6)}, and up to {format_percent(channels.cross_talk, 6)} of cross-talk.",
        "Where the larger signal shows on the other channel, or neither does: cables exchanged, or a film dead.",
        "",
        "1. Amplifiers on, films on them for half an hour; null the offsets. During a reading a film may warm",
        f"    by at most {bench.load.most_warming:g} K. The force channel, if any, is the third input.",
        "2. Stand the pin's carrier under the probe. Lift the sleeve over the base's rim, lower the probe until it touches,",
        "    clamp the carrier, slide the sleeve down again: it must not touch the base while the load is on.",
        f"    That centres to {slack:g} mm: twice {play:g} mm of play, 0.01 mm for each turned part. The ring likewise.",
        "3. On each reference: the table's load on, wait until it is steady,",
        f"    read for {seconds:.3g} s or more ({bench.load.least_cycles:g} cycles at least).",
        "4. Blocks of tissue, homogeneous, of the scene's shape, probe in the middle:",
        f"    moduli known to {known} (tolerance, in the bench file). 5 % does for calibrating with pin, ring and force;",
        "    a check then detects less of the probe's deviations, and reports it.",
        "5. Without a terminal, so many seconds to change what is pressed; exit code 0 is a record written, 1 or 2 none:",
        f"   $ probe-design calibrate {name} --device usb --wait 60 --record cal.probe -o probe.toml",
        f"    or from recordings of {count} readings, in the order above:",
        f"   $ probe-design read {name} --record 1.probe     (and so on, one for each)",
        f"   $ probe-design calibrate {name} --replay 1.probe ... --replay {count}.probe -o probe.toml",
        "6. Is the probe as drawn?  Exit code 0: nothing contradicts it; 1: the readings do, and the likely cause is printed",
        f"   $ probe-design check {name} --device usb --wait 60 --calibration probe.toml",
    ]
