"""Read the file of `--hide`: tumours that a virtual tissue holds, and that the program under test does not know.

[[inclusion]]
diameter = "9 mm"
depth = "10 mm"
x = "3 mm"
y = "-5 mm"
youngs_modulus = "26 kPa"
poisson_ratio = 0.45
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ValidationError

from geometry.common.errors import InputError, Words
from geometry.common.text_files import read_tables
from geometry.scenes.fit_check import check_bodies_fit
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from geometry.scenes.validation_messages import convert_error

ALLOWED = "tables [[inclusion]] as in a scene file, and nothing else"


class _Hidden(BaseModel):
    inclusion: tuple[Inclusion, ...] = ()


def read_hidden_tumours(path: Path, scene: Scene) -> tuple[Inclusion, ...]:
    """Return the tumours of a file; an empty file hides none.

    Raises
    ------
    InputError
        The file has other tables, or a tumour that is not allowed or does not fit the scene's tissue.
    """
    tables: Mapping[str, object] = read_tables(path, "file of hidden tumours")
    if set(tables) - {"inclusion"}:
        raise InputError("hide", Words(f"{path} with {', '.join(sorted(tables))}"), ALLOWED)
    try:
        entries = {name: tuple(part) if isinstance(part, list) else part for name, part in tables.items()}
        hidden = _Hidden.model_validate(entries, context={"units_required": True}).inclusion
    except ValidationError as refused:
        raise convert_error(refused, _Hidden, "hide") from None
    check_bodies_fit(scene.model_copy(update={"inclusion": hidden}))
    return hidden
