"""Describe a scene: one probe on one piece of tissue with its inclusions, contact, placement and load."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Self

from pydantic import ValidationError, model_validator

from geometry.common.calls import CallError, check_call
from geometry.common.errors import InputError, Words
from geometry.common.text_files import parse_tables, read_text
from geometry.scenes.file_kinds import check_kind
from geometry.scenes.fit_check import check_bodies_fit
from geometry.scenes.keys import Value, find_key, replace_values
from geometry.scenes.scene_tables import Observable, SceneTables
from geometry.scenes.validation_messages import convert_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Scene(SceneTables):
    """Everything that an evaluator needs to know; frozen, in SI units, checked as a whole."""

    def __init__(self, *places: object, **tables: object) -> None:
        """Build a scene from its tables, mappings or models, by their names; numbers are in SI units.

        Raises
        ------
        InputError
            A value is missing or not allowed.
        """
        if places:
            form = "Scene(probe=..., tissue=..., load=...)"
            raise CallError("scene", places[0], f"tables by their names, {form}; Scene.from_file reads a file")
        try:
            super().__init__(**tables)  # type: ignore[arg-type]  # which pydantic checks
        except ValidationError as refused:
            raise convert_error(refused, type(self)) from None

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # pydantic validates nested scenes without calling it

    @model_validator(mode="after")
    def _check_fit(self) -> Self:
        check_bodies_fit(self)
        return self

    @model_validator(mode="after")
    def _check_charges(self) -> Self:
        """Raise ``InputError`` where charges are read of films that give none."""
        films = self.probe.film.by_block if self.probe.film is not None and self.observable == "charge" else ()
        if any(film.d33 == 0 and film.mean_lateral_charge == 0 for film in films):
            raise InputError("probe.film.d33", "0 pC/N", "other than 0, or d31 + d32 other than 0, as charges are read")
        return self

    @classmethod
    @check_call
    def from_file(cls, path: Path | str) -> Self:
        """Read the scene file at ``path``; names of surface files in it are relative to its folder.

        Raises
        ------
        InputError
            The file is missing, empty or not TOML, or it states something that is not allowed.
        """
        if not isinstance(path, str | PathLike):
            raise InputError("path", path, "the name of a scene file; Scene.from_dict takes tables")
        scene, folder = cls.from_toml(read_text(path, "scene file"), str(path)), Path(path).parent
        # a body with a surface file gets the file's name with the folder, so that it can be opened from anywhere
        if all(body.surface is None for body in scene.inclusion):
            return scene
        bodies = (
            body if body.surface is None else body.model_copy(update={"surface": str(folder / body.surface)})
            for body in scene.inclusion
        )
        return scene.model_copy(update={"inclusion": tuple(bodies)})

    @classmethod
    def from_toml(cls, text: str, name: str = "scene") -> Self:
        """Read a scene from TOML text; ``name`` stands in messages. Raises ``InputError``."""
        data = parse_tables(text, name, "a TOML scene file")
        check_kind(data, name, "scene file", "a scene file, with [probe], [tissue] and [load]")
        if not data:
            raise InputError(name, Words("empty"), "a scene with [probe], [tissue] and [load]")
        return cls.from_dict(data)

    @classmethod
    @check_call
    def from_dict(cls, tables: Mapping[str, object]) -> Self:
        """Build a scene from the tables of a scene file, quantities as texts with units. Raises ``InputError``."""
        return cls.from_tables(tables, units_required=True)

    @classmethod
    def from_tables(cls, tables: Mapping[str, object], units_required: bool = False) -> Self:
        """Build a scene from the tables of a scene file.

        Parameters
        ----------
        tables
            The tables; quantities are texts with units or SI numbers.
        units_required
            Whether a number without a unit is refused where a unit belongs, as in files.

        Raises
        ------
        InputError
            A value is missing or not allowed.
        """
        try:
            return cls.model_validate(tables, context={"units_required": units_required})
        except ValidationError as refused:
            raise convert_error(refused, cls) from None

    def with_modulus(self, index: int, youngs_modulus: float) -> Self:
        """Return the scene with another Young's modulus of an inclusion, Pa, unchecked."""
        bodies = list(self.inclusion)
        bodies[index] = bodies[index].model_copy(update={"youngs_modulus": youngs_modulus})
        return self.model_copy(update={"inclusion": tuple(bodies)})

    @check_call
    def replace(self, changes: Mapping[str, Value]) -> Self:
        """Return the scene with other values; the scene itself stays as it is.

        Parameters
        ----------
        changes
            New values by the keys of the scene file: ``probe.gap``, ``tissue.layer[0].thickness``, ``inclusion[1].depth``, or
            ``inclusion.depth`` where there is one inclusion. A value is a text with its unit, ``"0.2 mm"``, or an SI number.

        Returns
        -------
        Self
            The new scene. A key that cannot stand beside a new one is removed, such as ``area_ratio`` beside a new
            ``outer_radius``; a material with a new number loses its name.

        Raises
        ------
        InputError
            There is no such key, or the new scene is not allowed.

        Examples
        --------
        >>> scene.replace({"probe.gap": "0.2 mm", "load.force": 0.01}).probe.gap  # doctest: +SKIP
        0.0002
        """
        if not isinstance(changes, Mapping):
            raise InputError("changes", changes, "new values by their keys, such as {'probe.gap': '0.2 mm'}")
        tables = self.model_dump(exclude_unset=True)
        keys = [find_key(name, tables, Scene) for name in changes]
        values = [key.read_bare_value(value) for key, value in zip(keys, changes.values(), strict=True)]
        return self.from_tables(replace_values(tables, keys, values))

    @check_call
    def plot(self) -> Figure:
        """Draw the meridian section to scale: probe, tissue with its layers, tumours; Matplotlib is imported when it is used.

        Returns
        -------
        Figure
            A notebook shows it; its ``savefig`` writes it to a file.
        """
        from geometry.scenes.section_figure import draw_section

        return draw_section(self)

    @property
    def observable(self) -> Observable:
        """What a reading is: the ratio of the films' charges, or of the stresses on them."""
        film = self.probe.film
        return self.reading.observable or ("charge" if film is not None and film.has_bonds else "stress")

    @property
    def models_charges(self) -> bool:
        """Whether the films' charges follow from their stress, so that films and bonds are always modelled."""
        return self.probe.film is not None and not self.probe.film.uses_psi

    @property
    def target(self) -> int | None:
        """Index of the inclusion that ``log_sensitivity`` refers to, if there is one."""
        marked = [index for index, body in enumerate(self.inclusion) if body.target]
        if marked:
            return marked[0]
        return 0 if len(self.inclusion) == 1 else None
