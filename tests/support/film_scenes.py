"""Scenes of the film references, ``tests/reference/film/expected.json``: lengths in mm, moduli in MPa, charges in pC/N.

Its ``about`` says how they were computed, by two independent codes.
"""

from __future__ import annotations

import json
from functools import cache

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from tests.support.paths import REFERENCE


@cache
def read_cases() -> dict[str, JsonObject]:
    """Return all cases by name."""
    cases = json.loads((REFERENCE / "film" / "expected.json").read_text(encoding="utf-8"))["cases"]
    return {case["name"]: case for case in cases}


def list_tissue_cases() -> list[str]:
    """Return the names of the cases with a whole probe on tissue."""
    return [name for name, case in read_cases().items() if case["tissue"]]


def build_stack(stack: JsonObject) -> JsonObject:
    """Return the table ``probe.film`` of a case, SI."""
    tape = {"youngs_modulus": 1e6 * stack["tape_modulus"], "poisson_ratio": stack["tape_nu"]}
    film = {"thickness": 1e-3 * stack["film"], "youngs_modulus": 1e6 * stack["film_modulus"], "poisson_ratio": stack["film_nu"]}
    bonds = {"bond_to_block": stack["lower"], "bond_to_base": stack["upper"]}
    film |= {key: {"thickness": 1e-3 * size} | (tape if size else {}) for key, size in bonds.items()}
    return film | {"electrode_inset": 1e-3 * stack["inset"]}


def build_scene(name: str) -> Scene:
    """Return the scene of a case with a whole probe on tissue."""
    case = read_cases()[name]
    (inner, outer), tissue = case["blocks"], case["tissue"]
    blocks = {
        key: {"youngs_modulus": 1e6 * block["modulus"], "poisson_ratio": block["nu"]}
        for key, block in (("inner", inner), ("outer", outer))
    }
    sizes = {"inner_radius": inner["outside"], "outer_radius": outer["outside"], "gap": outer["inside"] - inner["outside"]}
    probe = {key: 1e-3 * size for key, size in (sizes | {"height": inner["height"]}).items()}
    probe |= blocks | {"base": {"rigid": True}, "film": build_stack(case["stack"])}
    material = {"youngs_modulus": 1e6 * tissue["modulus"], "poisson_ratio": tissue["nu"]}
    ground = {"shape": "cylinder", "radius": 1e-3 * tissue["radius"], "depth": 1e-3 * tissue["depth"]} | material
    tumour = {"diameter": 2e-3 * tissue["sphere"], "depth": 1e-3 * tissue["sphere_depth"]}
    tumour |= {"youngs_modulus": 1e6 * tissue["sphere_modulus"], "poisson_ratio": tissue["sphere_nu"]}
    interface = "bonded" if tissue.get("bonded", True) else "frictionless"
    tables = {"probe": probe, "tissue": ground, "inclusion": [tumour] if tissue["sphere"] else []}
    return Scene.from_tables(tables | {"contact": {"interface": interface}, "load": {"force": 0.01}})
