"""Built-in scenes: the paper's probe, with marked assumptions where the paper gives no number, and typical scenes."""

from __future__ import annotations

from importlib.resources import files

from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_from_toml
from geometry.scenes.scene_tables import Load

LINEAR_LOAD_N = (
    0.2e-3  # N: linear elasticity holds for the paper's probe, whose outer film's pressures nearly cancel, up to 0.27 mN
)
TYPICAL_CHANGES: dict[str, dict[str, float]] = {  # changes of the tumour of typical.toml
    "on-axis": {},
    "off-axis": {"x": 6e-3},  # half under the probe
    "shallow": {"depth": 5e-3},  # covered by an eighth of its diameter
    "soft": {"youngs_modulus": 600.0},  # a tenth of the tissue: a cyst
}


def read_builtin_scene() -> Scene:
    """Return the built-in scene; its file gives the source of every number."""
    return scene_from_toml(_read_text("builtin.toml"), "builtin.toml")


def read_loaded_builtin_scene() -> Scene:
    """Return the built-in scene under ``LINEAR_LOAD_N``, at which linear elasticity holds.

    For `optimize` this is not needed, as it limits the loads itself.
    """
    return read_builtin_scene().model_copy(update={"load": Load(force=LINEAR_LOAD_N)})


def read_builtin_bench_scene() -> Scene:
    """Return the scene that the bench uses if none is given: the typical one with the tumour on the axis.

    The paper's probe does not serve, as its outer film gives no charge that could be read.
    """
    return read_typical_scenes()["on-axis"]


def read_typical_scenes() -> dict[str, Scene]:
    """Return typical scenes by name: the paper's probe without groove, and another probe over each of ``TYPICAL_CHANGES``."""
    paper, scene = read_loaded_builtin_scene(), scene_from_toml(_read_text("typical.toml"), "typical.toml")
    scenes = {"paper-without-groove": paper.model_copy(update={"probe": paper.probe.model_copy(update={"groove": None})})}
    for name, update in TYPICAL_CHANGES.items():
        scenes[name] = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update=update),)})
    return scenes


def _read_text(name: str) -> str:
    """Return the text of a file of the package's data."""
    return files("probe_design.data").joinpath(name).read_text(encoding="utf-8")
