"""Built-in materials: each number with its sources, test methods, licences and tolerance.

Open databases differ by a factor of 2.0 to 2.3 for the same product: one tests in compression, the other in tension. The
catalogue gives the geometric mean of the published range, and a standard deviation of ln E that reaches both ends:

    E = (E_low E_high)^(1/2),   s = ln(E_high / E_low) / 2.   (SC.2)

with E_low and E_high the lowest and the highest published modulus, and s the standard deviation. A modulus measured by one method
alone deviates from this mean, and the mean from the true modulus. If ln E by either method scatters about the true ln E with the
same standard deviation s, it follows from the mean < > over the products that both methods have measured:

    s = <(ln E_compression - ln E_tension)^2 / 2>^(1/2).   (SC.3)
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal

from geometry.common.errors import InputError, describe_choices
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.catalogue_laws import build_law_numbers, fill_in_law
from geometry.scenes.recipes import MixingRatio, Thinned, parse_name
from geometry.scenes.sourced_numbers import Number, format_comment, format_toml
from geometry.scenes.units import MODULUS_DIGITS, MODULUS_QUANTITY, format_modulus

Kind = Literal["elastomer", "base", "film"]
TABLE_OF_KIND: dict[str, str] = {"elastomer": "probe.inner", "base": "probe.base", "film": "probe.film"}
FILM_KEYS = ("thickness", "d31", "d33")
CATALOGUE_NUMBERS = ("youngs_modulus", "poisson_ratio")  # that a name in the catalogue stands for
MAX_DEVIATIONS = 2.0  # standard deviations of ln E: what measures further off is another material, or another recipe
MAX_POISSON_DIFFERENCE = 0.05  # the catalogue's own are assumed, or differ between data sheets by less


@dataclass(frozen=True)
class PublishedModulus:
    """One published value of Young's modulus.

    Attributes
    ----------
    youngs_modulus
        Pa.
    method
        Of the test.
    source, licence
        Of the value.
    scatter
        Standard deviation between samples, Pa; 0 where none is given.
    """

    youngs_modulus: float
    method: str
    source: str
    licence: str
    scatter: float = 0.0

    @property
    def description(self) -> str:
        """Modulus, scatter, method, source and licence in one line."""
        scatter = f" ± {format_modulus(self.scatter)}" if self.scatter else ""
        return f"{format_modulus(self.youngs_modulus)}{scatter}: {self.method}; {self.source}; {self.licence}"


@dataclass(frozen=True)
class CatalogueMaterial:
    """A material to buy, or to cast by a recipe.

    Attributes
    ----------
    name
        As in the catalogue, with its recipe.
    kind
        Its use: blocks and phantoms, the base, the films.
    about
        description.
    youngs_modulus
        The value to take, Pa.
    log_sd
        Standard deviation of its natural logarithm: its tolerance until the part itself is measured.
    tolerance
        The source of ``log_sd``.
    published
        The values that it rests on; of a recipe, without thinner or at the ratio.
    law
        Keys of its law at finite strain, where a curve of it was measured.
    process
        How parts of it are made, a name in ``geometry/workshop/processes.toml``.
    numbers
        The other keys of its table: ``poisson_ratio``, and of a film ``thickness``, ``d31`` and ``d33``.
    recipe
        What its recipe may be, in words; empty where it has none.
    """

    name: str
    kind: Kind
    about: str
    youngs_modulus: float
    log_sd: float
    tolerance: str
    published: tuple[PublishedModulus, ...]
    numbers: dict[str, Number]
    law: dict[str, Number]
    process: str
    recipe: str = ""

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio; ``source`` says whether it is assumed."""
        return float(self.numbers["poisson_ratio"].value)

    def admits(self, youngs_modulus: float) -> bool:
        """Return whether a modulus, Pa, is possible for this material: within ``MAX_DEVIATIONS`` standard deviations of ln E."""
        return abs(math.log(youngs_modulus / self.youngs_modulus)) <= MAX_DEVIATIONS * self.log_sd

    def is_tabulated(self, youngs_modulus: float) -> bool:
        """Return whether a modulus, Pa, is the catalogue's, and so was not measured on the part itself."""
        return math.isclose(youngs_modulus, self.youngs_modulus, rel_tol=0.5 * 10.0 ** (1 - MODULUS_DIGITS))

    def check_numbers(self, table: Mapping[str, object]) -> None:
        """Raise ``InputError`` unless a table's numbers are possible for this material; other values are not checked here."""
        given, poisson = table["youngs_modulus"], table["poisson_ratio"]
        try:
            modulus = MODULUS_QUANTITY.convert(given, units_required=False)
        except (ValueError, OverflowError):
            return
        if not self.admits(modulus):
            ends = (format_modulus(self.youngs_modulus * math.exp(sign * MAX_DEVIATIONS * self.log_sd)) for sign in (-1, 1))
            remedy = "leave youngs_modulus out for the catalogue's, or material for another"
            raise InputError("youngs_modulus", given, f"{' to '.join(ends)}, what {self.name} may measure; {remedy}")
        if isinstance(poisson, int | float) and not abs(poisson - self.poisson_ratio) <= MAX_POISSON_DIFFERENCE:
            value = f"{self.poisson_ratio:g}, that of {self.name}"
            remedy = f"within {MAX_POISSON_DIFFERENCE:g} of {value}; leave out material for another"
            raise InputError("poisson_ratio", poisson, remedy)

    @property
    def source(self) -> str:
        """The source of the modulus and of its tolerance, in one line."""
        return f"{self.tolerance} | {' | '.join(value.description for value in self.published)}"

    @property
    def modulus(self) -> Number:
        """Young's modulus as a scene file has it."""
        return Number(format_modulus(self.youngs_modulus), f"standard deviation of ln E {self.log_sd:.2g}: {self.tolerance}")

    @property
    def _name_entry(self) -> dict[str, Number]:
        """Return the key that names the material in a scene's table; films have none."""
        explanation = "the name alone gives modulus and Poisson's ratio, in whose place one may write measured ones"
        return {} if self.kind == "film" else {"material": Number(self.name, explanation)}

    def as_dict(self) -> dict[str, object]:
        """Return the JSON object of ``probe-design material show``: SI numbers, a scene's table, where each number comes from."""
        keys = self._table_numbers
        values = [vars(value) for value in self.published]
        entry = {"name": self.name, "kind": self.kind, "about": self.about, "youngs_modulus": self.youngs_modulus}
        entry |= {"poisson_ratio": self.poisson_ratio, "log_sd": self.log_sd}
        entry |= {"law": {key: number.value for key, number in self.law.items()} or None}
        entry |= {"tolerance": self.tolerance, "published": values, "recipe": self.recipe or None}
        table = {TABLE_OF_KIND[self.kind]: {key: number.value for key, number in keys.items()}}
        return entry | {"table": table, "sources": {key: number.description for key, number in keys.items()}}

    def to_toml(self) -> str:
        """Return a table of a scene file, each number below a comment with its source."""
        lines = format_comment(f"{self.name}: {self.about}") + (format_comment(f"recipe: {self.recipe}") if self.recipe else [])
        for value in self.published:
            lines += format_comment(f"- {value.description}")
        also = "  # as well [probe.outer]; of a phantom [tissue] and [[inclusion]]" if self.kind == "elastomer" else ""
        return "\n".join([*lines, f"[{TABLE_OF_KIND[self.kind]}]{also}", *format_toml(self._table_numbers), ""])

    @property
    def _table_numbers(self) -> dict[str, Number]:
        """All keys of its table of a scene, with their sources."""
        return self._name_entry | {"youngs_modulus": self.modulus} | self.numbers | self.law


def find_material(name: str, *, thinner: float | None = None, ratio: float | None = None) -> CatalogueMaterial:
    """Return a built-in material.

    Parameters
    ----------
    name
        As ``list_materials`` has it; a recipe may follow: ``"ecoflex-00-10 with 30 % thinner"``, ``"sylgard-184 20:1"``.
    thinner
        Fraction of thinner, 0.3 for 30 %; None for the one in the name, if any.
    ratio
        Parts of base to one part of agent; None likewise.

    Raises
    ------
    InputError
        No material has that name, or no recipe is known with these numbers.
    """
    plain, share, parts = parse_name(name)
    if plain not in read_catalogue():
        raise InputError("material", name, describe_choices(plain, read_catalogue()))
    share, parts = (share if thinner is None else thinner), (parts if ratio is None else ratio)
    return _find_with_recipe(plain, share, parts)


def list_materials() -> dict[str, CatalogueMaterial]:
    """Return all built-in materials by name, each by its usual recipe."""
    return {name: find_material(name) for name in read_catalogue()}


@cache
def read_catalogue() -> dict[str, JsonObject]:
    """Return the entries of the catalogue by name, as its files have them."""
    entries = _read_data("materials.toml")
    shared = {kind: entries.pop(kind) for kind in ("elastomer", "film")}  # what holds for all materials of a kind
    return {name: shared.get(entry["kind"], {}) | entry for name, entry in entries.items()}


def fill_in(table: object, numbers: bool = True) -> object:
    """Return a material's table, completed by the catalogue's entry for its key ``material``.

    The name takes the catalogue's spelling; ``law = "yeoh"`` alone gets its curve's constants. Numbers that the table has stay:
    they were measured on what was cast or bought. A modulus may lie up to ``MAX_DEVIATIONS`` sd of ln E from the catalogue's, a
    Poisson's ratio up to ``MAX_POISSON_DIFFERENCE``.

    Parameters
    ----------
    table
        Table of a scene file; anything that is no table, or names no material, is returned as it is.
    numbers
        Whether the table takes numbers, as that of a rigid base does not.

    Raises
    ------
    InputError
        There is no such material, it is a film, or a number beside the name is not possible for it.
    """
    if not isinstance(table, Mapping) or not isinstance(table.get("material"), str):
        return table
    material = find_material(table["material"])
    if material.kind == "film":
        raise InputError("material", material.name, "an elastomer or a base material; a film's numbers belong in [probe.film]")
    if not numbers:
        return {**table, "material": material.name}
    filled = {
        "youngs_modulus": MODULUS_QUANTITY.format_value(material.youngs_modulus),
        "poisson_ratio": material.poisson_ratio,
        **table,
    }
    material.check_numbers(filled)
    return {**fill_in_law(filled, material.law), "material": material.name}


def set_number(table: JsonObject, key: str, value: float) -> None:
    """Set a number of a part's table; remove the material's name if the number is no longer the catalogue's.

    Parameters
    ----------
    table
        Table of a block, tissue, layer, inclusion or base, or any other; it is changed.
    key
        Key of the number in the table.
    value
        The number's new value, SI.
    """
    if key in CATALOGUE_NUMBERS and table.get(key) != value:
        table.pop("material", None)
    table[key] = value


def _find_with_recipe(name: str, thinner: float | None, ratio: float | None) -> CatalogueMaterial:
    """Return a material with a fraction of thinner or a mixing ratio, None for the usual; raise as ``find_material``."""
    entry, thinned = read_catalogue()[name], read_compressed().get(name)
    if thinner is not None and thinned is None:
        raise InputError("thinner", thinner, f"none for {name}; measured with thinner: {', '.join(read_compressed())}")
    if ratio is not None and "base_per_agent" not in entry:
        raise InputError("ratio", ratio, f"none for {name}; by its mixing ratio: sylgard-184")
    if "base_per_agent" in entry:
        return _build_mixed(name, entry, ratio)
    published = _list_published(name, entry)
    youngs_modulus, log_sd, tolerance = _combine_published(entry, published)
    if thinned is None:
        return _build_material(name, entry, (youngs_modulus, log_sd, tolerance), published)
    recipe = (
        f"thinner, added to parts A and B: 0 to {format_percent(thinned.thinner[-1], 6)} (--thinner), as compressed; interpolated"
    )
    change, added_sd = thinned.compute_softening(thinner or 0.0)
    if thinner:
        name = f"{name} with {format_percent(thinner, 6)} thinner"
        tolerance += f"; without thinner, whose effect of {math.exp(change):.3g} adds {added_sd:.2g}"
    return _build_material(
        name, entry, (youngs_modulus * math.exp(change), math.hypot(log_sd, added_sd), tolerance), published, recipe
    )


def _build_mixed(name: str, entry: JsonObject, ratio: float | None) -> CatalogueMaterial:
    """Return a material whose modulus depends on the ratio of base to agent; None for the usual ratio."""
    given = entry["base_per_agent"]
    mix = MixingRatio(given["low"], given["high"], given["usual"], MODULUS_QUANTITY.read(name, given["modulus"]))
    parts = mix.usual if ratio is None else ratio
    value = mix.compute_youngs_modulus(parts)
    published = tuple(PublishedModulus(value, **value_entry) for value_entry in entry["value"])
    recipe = f"base : agent from {mix.low:g}:1 to {mix.high:g}:1 (--ratio), E = {format_modulus(mix.modulus)} / ratio"
    named = f"{name} {parts:g}:1"
    return _build_material(named, entry, (value, entry["tolerance"]["value"], entry["tolerance"]["source"]), published, recipe)


def _build_material(
    name: str,
    entry: JsonObject,
    modulus: tuple[float, float, str],
    published: tuple[PublishedModulus, ...],
    recipe: str = "",
) -> CatalogueMaterial:
    """Return a material from its entry; ``modulus`` is E in Pa, the standard deviation of ln E and the source of that."""
    value, log_sd, tolerance = modulus
    numbers = {key: Number(**entry[key]) for key in ("poisson_ratio", *FILM_KEYS) if key in entry}
    rounded = float(f"{value:.{MODULUS_DIGITS}g}")
    process = entry["process"]
    pulled = _read_data("materials-odbl.toml")
    law = build_law_numbers(pulled["law"].get(name), f"{pulled['source']}; {pulled['licence']}")  # of products without thinner
    heading = (name, entry["kind"], entry["about"])
    return CatalogueMaterial(*heading, rounded, log_sd, tolerance, published, numbers, law, process, recipe)


def _combine_published(entry: JsonObject, published: tuple[PublishedModulus, ...]) -> tuple[float, float, str]:
    """Return Young's modulus in Pa, the standard deviation of its logarithm and the source of that standard deviation.

    Several published values follow eq. SC.2. A single one is taken as it is, with the tolerance that the entry states, or with
    the scatter between test methods, eq. SC.3.
    """
    low, high = (pick(value.youngs_modulus for value in published) for pick in (min, max))
    if len(published) > 1:
        gap = f"the published values differ by a factor of {high / low:.3g}"
        explanation = f"{gap}; it reaches both ends from their geometric mean"
        return math.sqrt(low * high), math.log(high / low) / 2, explanation
    if "tolerance" in entry:
        return low, entry["tolerance"]["value"], entry["tolerance"]["source"]
    gaps = sorted(map(abs, _compute_method_gaps()))
    ends = " to ".join(f"{math.exp(gap):.2g}" for gap in (gaps[0], gaps[-1]))
    explanation = f"one method only; products that were pulled and compressed differ by a factor of {ends}"
    # a gap is the difference of two methods, with twice the variance of one
    return low, math.sqrt(sum(gap**2 for gap in gaps) / (2 * len(gaps))), explanation


@cache
def _compute_method_gaps() -> tuple[float, ...]:
    """Return ln E_compression - ln E_tension (eq. SC.3) of each product without thinner that both databases have."""
    pulled = _read_data("materials-odbl.toml")["value"]
    return tuple(
        math.log(read_compressed()[name].youngs_modulus[0] / MODULUS_QUANTITY.read(name, text))
        for name, text in pulled.items()
        if name in read_compressed()
    )


@cache
def read_compressed() -> dict[str, Thinned]:
    """Return the products tested in compression, by name."""

    def read_moduli(texts: Iterable[str]) -> tuple[float, ...]:
        return tuple(MODULUS_QUANTITY.read("youngs_modulus", text) for text in texts)

    return {
        name: Thinned(tuple(entry["thinner"]), read_moduli(entry["youngs_modulus"]), read_moduli(entry["scatter"]))
        for name, entry in _read_data("materials-cc-by.toml")["value"].items()
    }


def _list_published(name: str, entry: JsonObject) -> tuple[PublishedModulus, ...]:
    """List all published moduli of a product without thinner."""
    values = [
        value | {"youngs_modulus": MODULUS_QUANTITY.read(name, value["youngs_modulus"])} for value in entry.get("value", ())
    ]
    if name in read_compressed():
        first = read_compressed()[name]
        values.append(
            _read_origin("materials-cc-by.toml") | {"youngs_modulus": first.youngs_modulus[0], "scatter": first.scatter[0]}
        )
    pulled = _read_data("materials-odbl.toml")["value"]
    if name in pulled:
        values.append(_read_origin("materials-odbl.toml") | {"youngs_modulus": MODULUS_QUANTITY.read(name, pulled[name])})
    return tuple(PublishedModulus(**value) for value in values)


def _read_origin(file: str) -> dict[str, str]:
    """Return test method, source and licence, which all values of a database's file share."""
    return {key: _read_data(file)[key] for key in ("method", "source", "licence")}


@cache
def _read_data(name: str) -> JsonObject:
    """Return the tables of a TOML file in this package."""
    return tomllib.loads(files("geometry.scenes").joinpath(name).read_text(encoding="utf-8"))
