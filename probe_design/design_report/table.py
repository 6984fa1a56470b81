"""What an optimisation for a population found, as rows of text that a person can use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from probe_design.design_report.depth_map import DepthMap
from probe_design.design_search.judging import JudgedDesign
from probe_design.design_search.outcome import PopulationOptimum

MILLI, KILO, PICO = 1e-3, 1e3, 1e-12
BY = {
    "scene": "load", "force": "force limit", "linearity": "linearity", "indentation": "indentation",
    "tissue_strain": "tissue strain", "gap_closure": "gap closure", "charge": "charge",
}  # fmt: skip


def columns(optimum: PopulationOptimum) -> dict[str, JudgedDesign]:
    """Return the judged designs by their headings."""
    found = {"start": optimum.start} | ({} if optimum.single is None else {"one tumour": optimum.single})
    return found | {"population" if optimum.status == "improved" else "found, no gain": optimum.found}


def rows(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Iterator[tuple[str, ...]]:
    """Yield quantity and value of each design."""
    designs = columns(optimum)

    def row(name: str, of: Any) -> tuple[str, ...]:
        return (name, *(of(one) for one in designs.values()))

    yield row("tumours found, of 100", lambda one: _percent(one, "detection"))
    yield row("told, of 100", lambda one: _percent(one, "resolved"))
    yield row("learnt of ln contrast", lambda one: f"{one.judgement.information:.3f} +- {one.judgement.information_error:.2g}")
    largest = _largest_diameter(optimum)
    told = {name: maps[name].deepest(largest) for name in designs}
    name = f"{1e3 * largest:.2g} mm sure to, mm"
    yield (name, *("nowhere" if told[one] is None else f"{told[one] / MILLI:.3g}" for one in designs))  # type: ignore[operator]
    yield row("force, N", lambda one: f"{one.pressed.force:.3g}")
    yield row("force limited by", lambda one: BY[one.pressed.by])
    yield row("indentation, mm", lambda one: f"{one.pressed.indentation / MILLI:.2g}")
    yield row("weaker charge, pC", lambda one: f"{one.pressed.charge[0] / PICO:.2g}")
    yield row("inner radius, mm", lambda one: f"{one.scene.probe.inner_radius / MILLI:.4g}")
    yield row("outer radius, mm", lambda one: f"{one.scene.probe.tube_radius / MILLI:.4g}")
    yield row("gap, mm", lambda one: f"{one.scene.probe.gap / MILLI:.4g}")
    yield row("height, mm", _heights)
    yield row("moduli, kPa", _moduli)
    if any(_materials(one) for one in designs.values()):
        yield row("materials", lambda one: _materials(one) or "-")


def table(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Any:
    """Return the rows as a table for the terminal."""
    from rich.table import Table

    shown = Table(title=f"optimize: {optimum.status}", caption=caption(optimum))
    for heading in ("quantity", *columns(optimum)):
        shown.add_column(heading, justify="left" if heading == "quantity" else "right")
    for one in rows(optimum, maps):
        shown.add_row(*one)
    return shown


def caption(optimum: PopulationOptimum) -> str:
    """Say what the numbers hold for."""
    protocol, found = optimum.design.protocol, [one.name for one in optimum.limits if one.active]
    readings = f"{len(protocol.positions)} positions, ratio{' and stiffness' if protocol.stiffness else ''}"
    against = "a blank" if protocol.blank else "a prediction"
    alarms = f"{100 * protocol.false_alarm:g} % false alarms"
    judged = f"{len(optimum.start.judgement.depth)} tumours judged that the search has not seen"
    told = "sure: 9 times in 10 if it were known; told: ln contrast to 0.5"
    return f"{judged}; {readings} against {against}, {alarms}; {told}; +- one error; active limits: {', '.join(found) or 'none'}"


def _percent(one: JudgedDesign, kind: str) -> str:
    judgement = one.judgement
    return f"{100 * getattr(judgement, kind):.1f} +- {100 * getattr(judgement, f'{kind}_error'):.1f}"


def _heights(one: JudgedDesign) -> str:
    probe = one.scene.probe
    return " / ".join(f"{height / MILLI:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height)))


def _moduli(one: JudgedDesign) -> str:
    probe = one.scene.probe
    return f"{probe.inner.youngs_modulus / KILO:.4g} / {probe.outer.youngs_modulus / KILO:.4g}"


def _materials(one: JudgedDesign) -> str:
    """The names of the blocks' materials, nothing where neither has one."""
    names = one.scene.probe.inner.material, one.scene.probe.outer.material
    return " / ".join(name or "-" for name in names) if any(names) else ""


def _largest_diameter(optimum: PopulationOptimum) -> float:
    from probe_design.populations.population import ScenePopulation

    return max(ScenePopulation.of(optimum.design.scene, optimum.design.population).ranges["diameter"].values)
