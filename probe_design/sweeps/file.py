"""Read and check the specification of a sweep, as a TOML file or as the same tables in Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.json_types import JsonMapping, JsonObject
from geometry.common.resources import Limits, get_limits
from geometry.common.text_files import read_tables
from geometry.scenes.file_kinds import check_kind
from geometry.scenes.keys import Key, Value, find_at_path, find_key, replace_values
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import find_scene
from geometry.scenes.units import MEMORY_QUANTITY, TIME_QUANTITY, read_fraction
from probe_design.sweeps.constraints import evaluate_condition
from probe_design.sweeps.designs import SAMPLE_KINDS, DesignSampling, Variable, check_integer, read_variable
from solver.evaluators import AUTO, DEFAULT_ACCURACY, EVALUATOR_NAMES, check_accuracy

_SWEEP_KEYS = ("scene", "evaluator", "accuracy", "linear", "time_limit", "memory_limit", "sample", "constraints", "variables")


@dataclass(frozen=True)
class Sweep:
    """A checked specification of a sweep; SI units.

    Attributes
    ----------
    base
        The tables of the scene that is varied.
    variables
        The varied keys with their values or ranges.
    sample
        How the designs are drawn.
    evaluator, accuracy, linear
        As in ``solver.evaluate``.
    constraints
        Conditions that designs must satisfy; see ``probe_design.sweeps.constraints``.
    limits
        Time and memory of each design.
    """

    base: JsonMapping
    variables: tuple[Variable, ...]
    sample: DesignSampling
    evaluator: str = "auto"
    accuracy: float = 0.01
    linear: bool = False
    constraints: tuple[str, ...] = ()
    limits: Limits = field(default_factory=Limits)

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the variables."""
        return tuple(variable.key for variable in self.variables)

    def list_designs(self) -> list[tuple[int, tuple[Value, ...]]]:
        """Return number and values of every design that satisfies the constraints.

        Raises
        ------
        InputError
            A constraint is malformed, or no design satisfies them all.
        """
        designs = self.sample.draw_designs(self.variables)
        is_allowed = np.ones(len(designs), dtype=bool)
        for text in self.constraints:
            is_allowed &= evaluate_condition(text, lambda name: self._read_values(name, designs), len(designs))
        if not is_allowed.any():
            raise InputError("constraints", Words("met by no design"), "conditions that some design meets")
        return [(number, values) for number, values in enumerate(designs) if is_allowed[number]]

    def _read_values(self, name: str, designs: list[tuple[Value, ...]]) -> tuple[Any, str]:
        """Return the values of a key in all designs, an array if it is a variable, else one number; and their SI unit."""
        scene_key = find_key(name, self.base, Scene)
        for column, variable_key in enumerate(self.keys):
            if variable_key.path == scene_key.path:
                values: list[Any] = [row[column] for row in designs]
                if all(isinstance(value, float) for value in values):
                    return np.array(values), scene_key.unit
        value = find_at_path(
            replace_values(self.base, self.keys, designs[0]), scene_key.path
        )  # without keys that a variable replaces
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError("constraints", name, "keys that hold a number, in the scene or as a variable")
        return value, scene_key.unit


def read_sweep(path: Path | str) -> Sweep:
    """Read a sweep file; file names in it are relative to its folder.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or a value is not allowed.
    """
    contents = read_tables(path, "sweep file")
    check_kind(contents, str(path), "sweep file", "a sweep file, with scene and [variables]")
    return sweep_from_dict(contents, Path(path).parent, True)


def sweep_from_dict(tables: Mapping[str, object], folder: Path | str = ".", units_required: bool = False) -> Sweep:
    """Check the tables of a sweep file and return the sweep.

    Parameters
    ----------
    tables
        As in the file; ``scene`` may be a ``Scene``, numbers are in SI units.
    folder
        To which file names are relative.
    units_required
        Whether a bare number is refused where a unit belongs.

    Raises
    ------
    InputError
        A key or value is not allowed.
    """
    for name in tables:
        if name not in _SWEEP_KEYS:
            raise InputError(str(name), tables[name], describe_choices(name, _SWEEP_KEYS))
    base = _make_surface_paths_absolute(find_scene(tables.get("scene"), Path(folder)).model_dump(exclude_unset=True))
    sample = _read_sample(tables.get("sample", {}))
    entries = tables.get("variables")
    if not isinstance(entries, Mapping) or not entries:
        raise InputError(
            "variables",
            Words("missing") if entries is None else entries,
            'a table of variables, [variables."probe.gap"] or the like',
        )
    for name in entries:
        if not isinstance(name, str):
            raise InputError("variable", name, "keys of the scene file, such as probe.gap")
    variables = tuple(
        read_variable(name, item, base, kind=sample.kind, units_required=units_required, folder=Path(folder))
        for name, item in entries.items()
    )
    if len({item.key.path for item in variables}) < len(variables):
        raise InputError("variables", Words("two for one key"), "each key once")
    constraints = tables.get("constraints", [])
    if not isinstance(constraints, list | tuple) or not all(isinstance(item, str) for item in constraints):
        raise InputError("constraints", constraints, "a list of conditions, each a text")
    if constraints and sample.kind == "saltelli":
        raise InputError("constraints", constraints, "none with sample.kind = 'saltelli', whose indices need every design")
    evaluator, accuracy, linear = _read_settings(tables, base)
    return Sweep(
        base, variables, sample, evaluator=evaluator, accuracy=accuracy, linear=linear, constraints=tuple(constraints),
        limits=_read_limits(tables, units_required),
    )  # fmt: skip


def _make_surface_paths_absolute(base: JsonObject) -> JsonObject:
    """Return the tables of a scene with absolute paths of surface files: workers may run in another folder."""
    bodies = [
        {**body, "surface": str(Path(body["surface"]).absolute())} if body.get("surface") else body
        for body in base.get("inclusion", ())
    ]
    return base | {"inclusion": bodies} if bodies else base


def _read_settings(tables: Mapping[str, object], base: JsonObject) -> tuple[str, float, bool]:
    """Return evaluator, accuracy (left out, the ``reading.accuracy`` of the base scene) and ``linear``, checked.

    Raises
    ------
    InputError
        One of them is not allowed.
    """
    evaluator, linear = tables.get("evaluator", AUTO), tables.get("linear", False)
    accuracy = tables.get("accuracy", base.get("reading", {}).get("accuracy") or DEFAULT_ACCURACY)
    if evaluator not in (AUTO, *EVALUATOR_NAMES):
        raise InputError("evaluator", evaluator, describe_choices(evaluator, (AUTO, *EVALUATOR_NAMES)))
    accuracy = read_fraction("accuracy", accuracy, "a number above 0 and below 1, such as 0.01 or 1 %")
    check_accuracy(accuracy)
    if not isinstance(linear, bool):
        raise InputError("linear", linear, "true or false")
    return str(evaluator), accuracy, linear


def _read_limits(tables: Mapping[str, object], units_required: bool) -> Limits:
    """Return the time and memory limits of each design, by default those of this process."""
    time, memory = tables.get("time_limit"), tables.get("memory_limit")
    return Limits(
        seconds=get_limits().seconds if time is None else TIME_QUANTITY.read("time_limit", time, units_required),
        memory=get_limits().memory if memory is None else MEMORY_QUANTITY.read("memory_limit", memory, units_required),
    )


def _read_sample(table: object) -> DesignSampling:
    """Return how the designs are drawn, from the table ``[sample]``, checked. Raises ``InputError``."""
    if not isinstance(table, Mapping):
        raise InputError("sample", table, "a table, [sample]")
    for name in table:
        if name not in ("kind", "n", "seed"):
            raise InputError(f"sample.{name}", table[name], describe_choices(name, ("kind", "n", "seed")))
    kind = table.get("kind", "grid")
    if kind not in SAMPLE_KINDS:
        raise InputError("sample.kind", kind, describe_choices(kind, SAMPLE_KINDS))
    if kind == "grid":
        if len(table) > ("kind" in table):  # any key besides kind
            raise InputError("sample", Words("n or seed of a grid"), f"n and seed with kind = {', '.join(SAMPLE_KINDS[1:])}")
        return DesignSampling()
    return DesignSampling(
        kind,
        check_integer("sample.n", table.get("n"), 1, 10_000_000),
        check_integer("sample.seed", table.get("seed", 0), 0, 2**63),
    )


def build_scene(base: Mapping[str, object], keys: tuple[Key, ...], values: tuple[Value, ...]) -> Scene:
    """Build the scene of one design. Raises ``InputError`` if the scene is not valid."""
    return Scene.from_tables(replace_values(base, keys, values))
