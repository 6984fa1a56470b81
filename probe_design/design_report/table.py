"""What an optimisation for a population found, as rows of text that a person can use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from probe_design.design_report.depth_map import DepthMap
from probe_design.design_search.judging import JudgedDesign
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.populations.tables import Observable

LABELS: dict[Observable, str] = {"ratio": "ratio alone", "stiffness": "stiffness alone", "both": "both"}
MILLI, KILO, PICO = 1e-3, 1e3, 1e-12
BY = {
    "scene": "load", "force": "force limit", "linearity": "linearity", "indentation": "indentation",
    "tissue_strain": "tissue strain", "gap_closure": "gap closure", "charge": "charge",
}  # fmt: skip


def columns(optimum: PopulationOptimum) -> dict[str, JudgedDesign]:
    """Return the verified designs by their headings, the recommended one, of which everything else speaks, last."""
    single = {} if optimum.single is None else {"one tumour": optimum.single}
    if optimum.status == "improved":
        return {"start": optimum.start} | single | {"recommended": optimum.best}
    tried = {"best tried, no gain": optimum.found} if optimum.finalists else {}
    return tried | single | {"start, recommended": optimum.best}


def rows(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Iterator[tuple[str, ...]]:
    """Yield quantity and value of each design."""
    designs = columns(optimum)

    def row(name: str, of: Any) -> tuple[str, ...]:
        return (name, *(of(one) for one in designs.values()))

    own = optimum.design.protocol.observable
    for observable, label in LABELS.items():
        name = f"detected of 100, {label}{' *' if observable == own else ''}"
        yield row(name, lambda one, observable=observable: _detected(one, observable))
    yield row("* sampling, model error", _split)
    yield row("* resolved of 100", lambda one: _percent(one.judgement.resolved, one.judgement.resolved_error))
    yield row("* information, nats", lambda one: f"{one.judgement.information:.3f} ± {one.judgement.information_error:.1g}")
    largest = _largest_diameter(optimum)
    told = {name: maps[name].deepest(largest) for name in designs}
    name = f"{1e3 * largest:.2g} mm detected (90 %) to, mm"
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

    shown = Table(title=heading(optimum), caption=caption(optimum))
    for name in ("quantity", *columns(optimum)):
        shown.add_column(name, justify="left" if name == "quantity" else "right")
    for one in rows(optimum, maps):
        shown.add_row(*one)
    return shown


def heading(optimum: PopulationOptimum) -> str:
    """Say whether there is a gain, and which design is recommended."""
    return "optimize: improved" if optimum.status == "improved" else "optimize: no gain, the start is exported"


def caption(optimum: PopulationOptimum) -> str:
    """Say what the numbers hold for."""
    protocol, judgement = optimum.design.protocol, optimum.start.judgement
    active = [one.name for one in optimum.limits if one.active]
    against = "a baseline reading" if protocol.blank else "a prediction"
    return (
        f"Verified with {judgement.evaluator} on {len(judgement.depth)} tumours that were not used in the search; "
        f"{len(protocol.positions)} positions against {against}, {100 * protocol.false_alarm:g} % false alarms; "
        f"*: by what the probe is designed for, {LABELS[protocol.observable]} ([protocol] stiffness); ± sampling and model error "
        "together; detected (90 %): 9 times in 10 if the tumour were known; resolved: ln contrast to 0.5; "
        f"active limits: {', '.join(active) or 'none'}"
    )


def _detected(one: JudgedDesign, observable: Observable) -> str:
    judged = one.judgement.by_observable[observable]
    return "-" if judged is None else _percent(judged.detection, judged.detection_error)


def _split(one: JudgedDesign) -> str:
    error = one.judgement.errors["detection"]
    return f"± {100 * error.sampling:.1f}, ± {100 * error.model:.1f}"


def _percent(value: float, error: float) -> str:
    return f"{100 * value:.1f} ± {100 * error:.1f}"


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
