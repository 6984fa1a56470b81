"""Describe a scene: one probe on one piece of tissue with its inclusions, contact, placement and load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from pydantic import ValidationError, model_validator

from geometry.common.errors import InputError
from geometry.scenes.fit_check import check_bodies_fit
from geometry.scenes.keys import Value, find_key, replace_values
from geometry.scenes.scene_tables import Observable, SceneTables
from geometry.scenes.validation_messages import convert_error


class Scene(SceneTables):
    """Everything that an evaluator needs to know; frozen, in SI units, checked as a whole."""

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
        tables = self.model_dump(exclude_unset=True)
        keys = [find_key(name, tables, Scene) for name in changes]
        values = [key.read_bare_value(value) for key, value in zip(keys, changes.values(), strict=True)]
        return self.from_tables(replace_values(tables, keys, values))

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
