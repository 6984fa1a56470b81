"""Second set of ``generate_extra_scenes.py``: limits of the range of designs, beyond and between the scenes of the first."""

from __future__ import annotations

from benchmarks.references.extra_scenes import Wishes

ALL = ("tissue_poisson", "inner_poisson", "outer_poisson", "inclusion_poisson")
INCOMPRESSIBLE: Wishes = dict.fromkeys(ALL, 0.499999)

# fmt: off
SCENES: dict[str, Wishes] = {
    "incompressible-six-nines": {"contrast": None, "inner_radius": 4, "area_ratio": 0.8, "gap": 0.2, **INCOMPRESSIBLE},
    "incompressible-six-nines-stiff-inclusion": {
        "inner_radius": 4, "area_ratio": 0.5, "gap": 0.3, "contrast": 1e6, "diameter": 8, "cover": 0.2, **INCOMPRESSIBLE,
    },
    "incompressible-six-nines-frictionless": {
        "inner_radius": 3, "area_ratio": 1.2, "gap": 0.1, "contrast": 100, "diameter": 9, "cover": 0.1, "frictionless": True,
        **INCOMPRESSIBLE,
    },
    "void-one-millionth": {"inner_radius": 4, "area_ratio": 0.6, "contrast": 1e-6, "diameter": 8, "cover": 0.15},
    "void-one-millionth-frictionless": {
        "inner_radius": 3, "area_ratio": 0.4, "contrast": 1e-6, "diameter": 12, "cover": 0.02, "frictionless": True,
    },
    "rigid-inclusion-frictionless": {
        "inner_radius": 4, "area_ratio": 2, "gap": 0.15, "contrast": 1e6, "diameter": 10, "cover": 0.08, "frictionless": True,
    },
    "blocks-hundred-thousand-times-softer": {
        "inner_modulus": 0.1, "outer_modulus": 0.2, "tissue_modulus": 1e4, "inner_radius": 4, "area_ratio": 0.7, "contrast": 20,
        "diameter": 8, "cover": 0.2,
    },
    "blocks-million-times-stiffer": {
        "inner_modulus": 1e9, "outer_modulus": 1e9, "tissue_modulus": 1e3, "inner_radius": 3, "area_ratio": 0.4, "contrast": 10,
        "diameter": 8, "cover": 0.2, "frictionless": True,
    },
    "inner-stiffer-outer-softer": {
        "inner_modulus": 1e9, "outer_modulus": 0.01, "tissue_modulus": 1e3, "inner_radius": 4, "area_ratio": 0.8, "contrast": 10,
        "diameter": 8, "cover": 0.3,
    },
    "hairline-gap-sleeve-fifty": {
        "gap": 0.005, "inner_radius": 9, "area_ratio": 50, "inner_slenderness": 0.05, "outer_slenderness": 10, "contrast": 10,
        "diameter": 12, "cover": 0.2,
    },
    "five-millimetre-gap-wide-outer": {
        "gap": 5, "inner_radius": 1, "area_ratio": 0.05, "inner_slenderness": 10, "outer_slenderness": 0.05, "contrast": 50,
        "diameter": 9, "cover": 0.05, "inner_poisson": 0.499999,
    },
    "flat-discs-six-nines": {
        "inner_radius": 8, "area_ratio": 0.9, "gap": 0.05, "inner_slenderness": 0.05, "outer_slenderness": 0.05, "contrast": 10,
        "diameter": 8, "cover": 0.3, "inner_poisson": 0.499999, "outer_poisson": 0.499999, "frictionless": True,
    },
    "half-percent-cover-under-inner": {
        "inner_radius": 5, "area_ratio": 0.6, "gap": 0.2, "diameter": 6, "cover": 0.005, "contrast": 100,
    },
    "half-percent-cover-outer-wide-frictionless": {  # outer radius 8.29
        "inner_radius": 5, "area_ratio": 0.6, "gap": 0.2, "diameter": 16, "cover": 0.005, "contrast": 0.01, "frictionless": True,
    },
    "half-percent-cover-three-outer-radii": {  # outer radius 4.04
        "inner_radius": 2, "area_ratio": 0.33, "gap": 0.05, "diameter": 12.07, "cover": 0.005, "contrast": 1e3,
        "tissue_poisson": 0.499999, "tissue_radius": 30, "tissue_depth": 40,
    },
    "equator-at-inner-radius": {  # 4.004 beside 4, hole 4.3
        "inner_radius": 4, "area_ratio": 0.7, "gap": 0.3, "diameter": 8.008, "cover": 0.03, "contrast": 30,
    },
    "equator-at-hole-radius": {  # 4.297 beside 4.3
        "inner_radius": 4, "area_ratio": 0.7, "gap": 0.3, "diameter": 8.594, "cover": 0.05, "contrast": 0.05,
        "frictionless": True,
    },
    "equator-at-outer-radius": {  # 6.4322 beside 6.4302
        "inner_radius": 4, "area_ratio": 0.7, "gap": 0.3, "diameter": 12.8644, "cover": 0.02, "contrast": 300,
    },
    "sheet-of-tissue": {
        "inner_radius": 6, "area_ratio": 0.4, "gap": 0.1, "tissue_depth_ratio": 0.301, "tissue_radius_ratio": 4, "diameter": 3,
        "cover": 0.01, "contrast": 1e3, "tissue_poisson": 0.499999, "frictionless": True,
    },
    "micro-probe": {
        "inner_radius": 0.1, "area_ratio": 1.5, "gap": 0.005, "inner_slenderness": 1, "outer_slenderness": 1, "diameter": 0.2,
        "cover": 0.1, "contrast": 50,
    },
    "micro-probe-giant-inclusion": {
        "inner_radius": 0.1, "area_ratio": 0.2, "gap": 0.01, "inner_slenderness": 3, "outer_slenderness": 3, "diameter": 20,
        "cover": 0.005, "contrast": 1e6, "frictionless": True,
    },
}
# fmt: on
