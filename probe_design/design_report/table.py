"""Build the table of an optimisation for a population: quantities of each design, as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from probe_design.design_report.depth_map import DepthMap
from probe_design.design_search.population_optimum import PopulationOptimum
from probe_design.design_search.verification import PopulationVerification
from probe_design.populations.population import ScenePopulation
from probe_design.populations.tables import Observable
from probe_design.reporting.table import Table

OBSERVABLE_LABELS: dict[Observable, str] = {"ratio": "ratio alone", "stiffness": "stiffness alone", "both": "both"}
M_PER_MM, PA_PER_KPA, C_PER_PC = 1e-3, 1e3, 1e-12
LIMIT_LABELS = {
    "scene": "load", "force": "force limit", "linearity": "linearity", "indentation": "indentation",
    "tissue_strain": "tissue strain", "gap_closure": "gap closure", "charge": "charge",
}  # fmt: skip


def list_rows(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Iterator[tuple[str, ...]]:
    """Yield quantity and value of each design."""
    designs = optimum.list_columns()

    def build_row(name: str, format_cell: Any) -> tuple[str, ...]:
        return (name, *(format_cell(verified) for verified in designs.values()))

    protocol_observable = optimum.design.protocol.observable
    for observable, label in OBSERVABLE_LABELS.items():
        name = f"detected of 100, {label}{' *' if observable == protocol_observable else ''}"
        yield build_row(name, lambda verified, observable=observable: _format_detected(verified, observable))
    yield build_row("* sampling, model error", _format_error_split)
    yield build_row(
        "* resolved of 100", lambda verified: _format_percent(verified.judgement.resolved, verified.judgement.resolved_error)
    )
    yield build_row(
        "* information, nats",
        lambda verified: f"{verified.judgement.information:.3f} ± {verified.judgement.information_error:.1g}",
    )
    largest = _find_largest_diameter(optimum)
    depths = {name: maps[name].find_deepest(largest) for name in designs}
    name = f"{1e3 * largest:.2g} mm detected (90 %) to, mm"
    yield (name, *("nowhere" if depths[verified] is None else f"{depths[verified] / M_PER_MM:.3g}" for verified in designs))  # type: ignore[operator]
    yield build_row("force, N", lambda verified: f"{verified.pressed.force:.3g}")
    yield build_row("force limited by", lambda verified: LIMIT_LABELS[verified.pressed.limited_by])
    yield build_row("indentation, mm", lambda verified: f"{verified.pressed.indentation / M_PER_MM:.2g}")
    yield build_row("weaker charge, pC", lambda verified: f"{verified.pressed.charge[0] / C_PER_PC:.2g}")
    yield build_row("inner radius, mm", lambda verified: f"{verified.scene.probe.inner_radius / M_PER_MM:.4g}")
    yield build_row("outer radius, mm", lambda verified: f"{verified.scene.probe.tube_radius / M_PER_MM:.4g}")
    yield build_row("gap, mm", lambda verified: f"{verified.scene.probe.gap / M_PER_MM:.4g}")
    yield build_row("height, mm", _format_heights)
    yield build_row("moduli, kPa", _format_moduli)
    if any(_format_materials(verified) for verified in designs.values()):
        yield build_row("materials", lambda verified: _format_materials(verified) or "-")


def build_table(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Table:
    """Return the table that compares the verified designs."""
    rows = [*list_rows(optimum, maps)]
    return Table(("quantity", *optimum.list_columns()), rows, optimum.title, describe_conditions(optimum))


def describe_conditions(optimum: PopulationOptimum) -> str:
    """Describe the conditions for which the numbers hold."""
    protocol, judgement = optimum.design.protocol, optimum.start.judgement
    active = [limit.name for limit in optimum.limits if limit.active]
    against = "a baseline reading" if protocol.blank else "a prediction"
    return (
        f"Verified with {judgement.evaluator} on {len(judgement.depth)} tumours that were not used in the search; "
        f"{len(protocol.positions)} positions against {against}, {100 * protocol.false_alarm:g} % false alarms; "
        f"*: by what the probe is designed for, {OBSERVABLE_LABELS[protocol.observable]} ([protocol] stiffness); ± "
        "sampling and model error "
        "together; detected (90 %): 9 times in 10 if the tumour were known; resolved: ln contrast to 0.5; "
        f"active limits: {', '.join(active) or 'none'}"
    )


def _format_detected(verified: PopulationVerification, observable: Observable) -> str:
    judged = verified.judgement.by_observable[observable]
    return "-" if judged is None else _format_percent(judged.detection, judged.detection_error)


def _format_error_split(verified: PopulationVerification) -> str:
    error = verified.judgement.errors["detection"]
    return f"± {100 * error.sampling:.1f}, ± {100 * error.model:.1f}"


def _format_percent(value: float, error: float) -> str:
    return f"{100 * value:.1f} ± {100 * error:.1f}"


def _format_heights(verified: PopulationVerification) -> str:
    probe = verified.scene.probe
    return " / ".join(f"{height / M_PER_MM:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height)))


def _format_moduli(verified: PopulationVerification) -> str:
    probe = verified.scene.probe
    return f"{probe.inner.youngs_modulus / PA_PER_KPA:.4g} / {probe.outer.youngs_modulus / PA_PER_KPA:.4g}"


def _format_materials(verified: PopulationVerification) -> str:
    """Return the names of the blocks' materials; empty if neither has one."""
    names = verified.scene.probe.inner.material, verified.scene.probe.outer.material
    return " / ".join(name or "-" for name in names) if any(names) else ""


def _find_largest_diameter(optimum: PopulationOptimum) -> float:
    return max(ScenePopulation.from_scene(optimum.design.scene, optimum.design.population).ranges["diameter"].values)
