"""Build the tables of what a search tried one by one: films with their bonds, and scans."""

from __future__ import annotations

from collections.abc import Callable

from probe_design.design_search.combination import Combination
from probe_design.design_search.optimum import PopulationOptimum
from probe_design.design_search.verification import PopulationVerification
from probe_design.reporting.table import Table


def build_film_table(optimum: PopulationOptimum) -> Table:
    """Return the table of all films and bonds tried, best first."""
    films = {item.combination.film.description: item.combination.film for item in optimum.search.choices if item.combination.film}
    names = tuple(name.replace("_", " ") for name in optimum.search_space.film_choices[0].values)
    cells = {key: tuple(film.values.values()) for key, film in films.items()}
    verified = {key: [item for item in optimum.finalists if item.scene.probe.film == film.film] for key, film in films.items()}
    best = _find_best(optimum, lambda choice: choice.film.description if choice.film else None)
    return _build_table(optimum, names, cells, best, verified)


def build_scan_table(optimum: PopulationOptimum) -> Table:
    """Return the table of all scans tried, best first."""
    scans = {item.combination.scan.description: item.combination.scan for item in optimum.search.choices if item.combination.scan}
    cells: dict[str, tuple[str, ...]] = {key: (str(item.presses), f"{1e3 * item.pitch:.4g}") for key, item in scans.items()}
    verified = {key: [item for item in optimum.finalists if item.protocol == scan.protocol] for key, scan in scans.items()}
    best = _find_best(optimum, lambda choice: choice.scan.description if choice.scan else None)
    return _build_table(optimum, ("presses", "pitch, mm"), cells, best, verified)


def _find_best(optimum: PopulationOptimum, describe: Callable[[Combination], str | None]) -> dict[str, float]:
    """Return the best searched value of each choice by its description, best first."""
    best: dict[str, float] = {}
    for choice in optimum.search.choices:  # best first
        if (key := describe(choice.combination)) is not None:
            best.setdefault(key, choice.value)
    return best


def _build_table(
    optimum: PopulationOptimum, names: tuple[str, ...], cells: dict[str, tuple[str, ...]], best: dict[str, float],
    verified: dict[str, list[PopulationVerification]],
) -> Table:  # fmt: skip
    """Return a table with a row for each choice, by its description: cells, searched and verified objective, recommended."""
    aim, rows = optimum.design.objective, list[tuple[str, ...]]()
    for key, value in best.items():
        items = sorted(verified[key], key=lambda item: -aim.sign * item.objective[0])
        text = aim.format_value(*items[0].objective) if items else "-"
        recommended = "yes" if any(item is optimum.winner for item in items) else ""
        rows.append((*cells[key], f"{aim.scale * aim.convert_searched(value):.4g}", text, recommended))
    return Table((*names, f"{aim.label}, closed form", f"{aim.label}, verified", "recommended"), rows)
