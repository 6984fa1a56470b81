"""Build the report of an optimisation for a population: comparison, maps, gains of improvements, fronts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Literal

import tomli_w

from geometry.common.percent import format_percent
from geometry.provenance.block import build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.scene_file import scene_to_dict
from geometry.scenes.units import PA_PER_KPA
from probe_design.design_report.depth_map import DepthMap, compute_depth_map
from probe_design.design_report.improvements import compute_improvements
from probe_design.design_report.pictures import draw_front, draw_improvements, draw_maps
from probe_design.design_report.report import C_PER_PC, Report, Writer, format_heights
from probe_design.design_report.verdict import format_bonds, format_film, list_assumptions, write_population_verdict
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.optimum import PopulationOptimum
from probe_design.design_search.pareto import Front
from probe_design.design_search.scan_choices import ScanChoice, compute_pitch
from probe_design.design_search.variables import M_PER_MM
from probe_design.design_search.verification import PopulationVerification
from probe_design.populations.design_file import PROTOCOL_FILE, QUESTION_FILE, Design
from probe_design.populations.objective import Objective
from probe_design.populations.population import PLACE_AXES, ScenePopulation
from probe_design.populations.tables import ChannelSet
from probe_design.reporting.page import Chapter, Code, Text
from probe_design.reporting.table import Table

MAPS_FILE, IMPROVEMENTS_FILE, FRONT_FILE = "maps.png", "levers.png", "pareto.png"
TOLERANCE_NOTE = (
    ", by the closed form over 64 draws of what is built, each with all that probe-design tolerances lists: sizes as "
    "exactly as each block is made, moduli as measured or as their material scatters, films, and bonds as their makers vary."
)
LIMITS_NOTE = (
    "linearity and gap_closure are forces: up to the first, finite strain changes the ratio by at most 1 %; up to the second, "
    "the gap stays open, for every tumour and tissue of the population, both with a margin of a tenth. They are lower than those "
    "of the one scene below."
)
CHANNEL_LABELS: dict[ChannelSet, str] = {"ratio": "ratio alone", "stiffness": "stiffness alone", "both": "both"}
FORCE_LIMIT_LABELS = {
    "scene": "load", "loads": "largest load", "force": "force limit", "largest force": "largest force", "linearity": "linearity",
    "indentation": "indentation", "tissue_strain": "tissue strain", "gap_closure": "gap closure", "charge": "charge",
    "pressure": "pressure", "contact": "depth of contact", "last_converged": "convergence", "indentation_per_depth": "depth",
}  # fmt: skip


FILM_NOTE = (
    "Every film with every bond was tried by itself: the search by the closed form chose the other numbers of the probe anew "
    "for each, and the best designs of the best films were verified."
)


SCAN_NOTE = (
    "Every number of presses was tried with every pitch, each with a probe of its own, quickly, and the best three "
    "combinations once more: other rows may be worse than their scans. More presses say more. protocol.toml has the places of "
    "the recommended scan, which locate and survey take from this folder."
)


def build_population_report(optimum: PopulationOptimum, fronts: tuple[Front, ...] = ()) -> Report:
    """Return the report of an optimisation for a design file's population, with its Pareto fronts."""
    design, designs, error_note = optimum.design, optimum.list_columns(), optimum.best.performance.error_note
    search, design_file = optimum.search.how, write_design_file(design)
    maps = {name: compute_depth_map(design, item.scene, item.pressed.force) for name, item in designs.items()}
    improvements = compute_improvements(optimum.scene, design)
    provenance = build_provenance(design.scene, evaluator=optimum.best.evaluator, seed=design.population.seed)
    pictures: dict[str, tuple[str, Writer]] = {
        MAPS_FILE: (
            "probability and standard deviation of ln contrast over depth and diameter",
            partial(draw_maps, maps, designs),
        ),
        IMPROVEMENTS_FILE: (
            "the objective after each change of the readings",
            partial(draw_improvements, improvements, design.objective),
        ),
    }
    if fronts:
        pictures[FRONT_FILE] = "Pareto fronts", partial(draw_front, fronts, design.objective)
    space = optimum.search_space
    films = {"Which film and bond": (Text(FILM_NOTE), build_choice_table(optimum, "film"))} if space.film_choices else {}
    scans = {"Which scan": (Text(SCAN_NOTE), build_choice_table(optimum, "scan"))} if space.scan_choices else {}
    protocol = tomli_w.dumps({"protocol": optimum.best.protocol.model_dump(mode="json", exclude_none=True)})
    notes = [
        f"{describe_conditions(optimum)}. The sampling error is one standard error, of the tumours drawn and of the draws of "
        "noise; the model error is a bound on what the evaluator's own errors change. Of the recommended design "
        f"{error_note}. A gain counts only where it is beyond twice its own error, for which the same tumours are read with both "
        f"probes, under one force for all of them. The search used the closed form: {search}."
    ]
    if optimum.why_no_single:
        notes.append(f"No design for one tumour: {optimum.why_no_single}.")
    return Report(
        optimum=optimum,
        table=build_population_table(optimum, maps),
        advice=write_population_verdict(optimum, maps, improvements),
        assumptions=list_assumptions(optimum),
        notes=notes,
        provenance=provenance,
        cautions=optimum.warnings,
        shown_scene=optimum.scene,
        pictures=pictures,
        texts={QUESTION_FILE: format_toml_comment(provenance) + design_file}
        | ({PROTOCOL_FILE: format_toml_comment(provenance) + protocol} if scans else {}),
        chapters={
            "Which tumours are detected and resolved": (MAPS_FILE,),
            "What would help most": (IMPROVEMENTS_FILE,),
            "What more would cost": (FRONT_FILE,),
            **films,
            **scans,
            "After the workshop": (
                Text(optimum.design.objective.label.capitalize() + TOLERANCE_NOTE),
                build_tolerance_table(optimum),
            ),
        },
        limit_notes=(LIMITS_NOTE,) if {"linearity", "gap_closure"} & {limit.name for limit in optimum.limits} else (),
        last_chapters=(Chapter("What was asked", (Code(design_file),)),),
        additions={"levers": [asdict(item) for item in improvements], "pareto": [front.as_dict() for front in fronts]},
        messages=(f"search: {search}", f"error of the detection: {error_note}"),
    )


def build_population_table(optimum: PopulationOptimum, maps: dict[str, DepthMap]) -> Table:
    """Return the table that compares the verified designs: quantities in rows, designs in columns.

    ``maps`` are those of the designs, from which the depth down to which the largest tumours are detected is read.
    """
    designs, rows = optimum.list_columns(), list[tuple[str, ...]]()

    def add_row(name: str, format_cell: Callable[[PopulationVerification], str]) -> None:
        """Append the row of a quantity, with the text that ``format_cell`` returns for each design."""
        rows.append((name, *(format_cell(verified) for verified in designs.values())))

    for channel_set, label in CHANNEL_LABELS.items():
        star = " *" if channel_set == optimum.design.protocol.channel_set else ""
        add_row(f"detected of 100, {label}{star}", partial(_format_detected, channel_set=channel_set))
    add_row("* sampling, model error", _format_error_split)
    add_row(
        "* resolved of 100",
        lambda verified: _format_percent(verified.performance.means["resolved"], verified.performance.errors["resolved"].total),
    )
    ranges = ScenePopulation.from_scene(optimum.design.scene, optimum.design.population).ranges
    add_row("* information, nats", partial(_format_located, aim=Objective(maximise="information")))
    if not all(ranges[name].is_single for name in PLACE_AXES):
        add_row("* place error, mm", partial(_format_located, aim=Objective(maximise="place_error")))
    if optimum.search_space.scan_choices:
        add_row("presses over tissue", lambda verified: str(verified.protocol.count))
        add_row("pitch, mm", lambda verified: f"{compute_pitch(verified.protocol) / M_PER_MM:.4g}")
    diameter = max(ranges["diameter"].values)
    depths = [maps[name].find_deepest(diameter) for name in designs]
    texts = ("nowhere" if depth is None else f"{depth / M_PER_MM:.3g}" for depth in depths)
    rows.append((f"{diameter / M_PER_MM:.2g} mm detected (90 %) to, mm", *texts))
    add_row("force, N", lambda verified: f"{verified.pressed.force:.3g}")
    add_row("force limited by", lambda verified: FORCE_LIMIT_LABELS[verified.pressed.limited_by])
    add_row("indentation, mm", lambda verified: f"{verified.pressed.indentation / M_PER_MM:.2g}")
    add_row("weaker charge, pC", lambda verified: f"{verified.pressed.charge[0] / C_PER_PC:.2g}")
    add_row("inner radius, mm", lambda verified: f"{verified.scene.probe.inner_radius / M_PER_MM:.4g}")
    add_row("outer radius, mm", lambda verified: f"{verified.scene.probe.tube_radius / M_PER_MM:.4g}")
    add_row("gap, mm", lambda verified: f"{verified.scene.probe.gap / M_PER_MM:.4g}")
    add_row("height, mm", lambda verified: format_heights(verified.scene.probe))
    add_row("moduli, kPa", _format_moduli)
    if optimum.search_space.film_choices:
        add_row("film, um", lambda verified: format_film(verified.scene.probe.film))
        add_row("bonds to block / base", lambda verified: format_bonds(verified.scene.probe.film))
    if any(_format_materials(verified) for verified in designs.values()):
        add_row("materials", lambda verified: _format_materials(verified) or "-")
    return Table(("quantity", *designs), rows, optimum.title, describe_conditions(optimum))


def describe_conditions(optimum: PopulationOptimum) -> str:
    """Describe the conditions for which the numbers hold."""
    protocol, performance = optimum.design.protocol, optimum.start.performance
    active = [limit.name for limit in optimum.limits if limit.active]
    read = "the ratio is that of the films' charges; " if optimum.design.scene.observable == "charge" else ""
    located = "of simulated scans that locate explains" if optimum.start.trials else "as if readings were linear in the unknowns"
    places = "the places of each column" if optimum.search_space.scan_choices else f"{protocol.count} positions"
    against = "a baseline reading" if protocol.blank else "a prediction"
    forces = " and ".join(f"{load:g} N" for load in sorted(protocol.loads))
    loads = f", each under {forces}, or the design's force where that is less," if protocol.loads else ""
    return (
        f"Verified with {performance.evaluator} on {len(performance.draw)} tumours that were not used in the search; "
        f"{places}{loads} against {against}, {format_percent(protocol.false_alarm, 6)} false alarms; "
        f"*: by what the probe is designed for, {CHANNEL_LABELS[protocol.channel_set]} ([protocol] stiffness); {read}± "
        f"sampling and model error together; information and place error {located}; detected (90 %): 9 times in 10 if the tumour "
        f"were known; resolved: ln contrast to "
        f"0.5; active limits: {', '.join(active) or 'none'}"
    )


def build_tolerance_table(optimum: PopulationOptimum) -> Table:
    """Return the table of each design's objective as drawn, and its mean and 5 % and 95 % quantiles as built."""
    designs, scale = (optimum.start, *optimum.finalists), optimum.design.objective.scale
    names = ["start", *(f"design {k + 1}" for k in range(len(optimum.finalists)))]
    rows = [
        (
            f"{name}, recommended" if verified is optimum.best else name,
            *(f"{scale * value:.3g}" for value in (item.nominal, item.expected, item.low, item.high)),
        )
        for name, verified, item in zip(names, designs, optimum.robust, strict=True)
    ]
    return Table(("design", "as drawn", "expected", "5 % below", "95 % below"), rows)


def write_design_file(design: Design) -> str:
    """Return the design file with all defaults written out; reading it yields the same design."""
    tables = design.model_dump(mode="json", exclude_none=True, exclude={"scene"})
    return tomli_w.dumps(tables | {"scene": scene_to_dict(design.scene)})


def _format_detected(verified: PopulationVerification, channel_set: ChannelSet) -> str:
    """Return how many of 100 tumours are detected by a set of channels, with the error; a dash without a result."""
    performance = verified.performance.by_channels[channel_set]
    return "-" if performance is None else _format_percent(performance.means["detection"], performance.errors["detection"].total)


def _format_located(verified: PopulationVerification, aim: Objective) -> str:
    """Return the information or the place error with its error, of simulated scans where there are any."""
    aim = aim.model_copy(update={"statistic": verified.aim.statistic})
    if verified.trials is not None:
        value, error = verified.trials.compute_objective(aim)
    else:
        value, error = verified.performance.means[aim.maximise], verified.performance.errors[aim.maximise].total
    return f"{aim.scale * value:.3g} ± {aim.scale * error:.1g}"


def _format_error_split(verified: PopulationVerification) -> str:
    """Return the sampling error and the model error of the tumours detected of 100."""
    error = verified.performance.errors["detection"]
    return f"± {100 * error.sampling:.1f}, ± {100 * error.model:.1f}"


def _format_percent(value: float, error: float) -> str:
    """Return a fraction and its error in per cent."""
    return f"{100 * value:.1f} ± {100 * error:.1f}"


def _format_moduli(verified: PopulationVerification) -> str:
    """Return the moduli of the inner and the outer block, kPa."""
    probe = verified.scene.probe
    return f"{probe.inner.youngs_modulus / PA_PER_KPA:.4g} / {probe.outer.youngs_modulus / PA_PER_KPA:.4g}"


def _format_materials(verified: PopulationVerification) -> str:
    """Return the names of the blocks' materials; empty if neither has one."""
    names = verified.scene.probe.inner.material, verified.scene.probe.outer.material
    return " / ".join(name or "-" for name in names) if any(names) else ""


def build_choice_table(optimum: PopulationOptimum, kind: Literal["film", "scan"]) -> Table:
    """Return the table of all films and bonds, or of all scans, that were tried: searched and verified objective, best first."""
    aim, best = optimum.design.objective, dict[str, tuple[FilmChoice | ScanChoice, float]]()
    for choice in optimum.search.choices:  # best first
        option: FilmChoice | ScanChoice = getattr(choice.combination, kind)
        best.setdefault(option.description, (option, choice.value))
    rows = []
    for option, value in best.values():
        items = [item for item in optimum.finalists if option.is_of(item.scene, item.protocol)]
        top = max(items, key=lambda item: aim.sign * item.objective[0], default=None)
        text = "-" if top is None else aim.format_value(*top.objective)
        recommended = "yes" if any(item is optimum.winner for item in items) else "no"
        rows.append((*option.texts.values(), f"{aim.scale * aim.convert_searched(value):.4g}", text, recommended))
    names = next(iter(best.values()))[0].texts
    return Table((*names, f"{aim.label}, closed form", f"{aim.label}, verified", "recommended"), rows)
