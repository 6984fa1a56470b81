"""The numbers that each scene of ``generate_extra_scenes.py`` fixes; the rest is drawn."""

from __future__ import annotations

from typing import Any

Wishes = dict[str, Any]
"""Lengths in mm, moduli in Pa; a pair is a range; ``contrast`` None: without an inclusion.

``*_slenderness``: a block's height in inner radii; ``tissue_*_ratio``: a size of the tissue in outer radii;
``cover``: tissue over the inclusion in diameters; ``contrast``: the inclusion's modulus over the tissue's.
"""

# fmt: off
SCENES: dict[str, Wishes] = {
    "thin-cover-stiff": {
        "diameter": 8, "cover": 0.005, "contrast": 30, "inner_radius": (2, 5), "area_ratio": (0.3, 3), "inner_modulus": 1e5,
        "outer_modulus": 1e5,
    },
    "thin-cover-rigid-bonded": {"diameter": 6, "cover": 0.01, "contrast": 1e4, "inner_radius": (3, 5), "area_ratio": (0.3, 3)},
    "thin-cover-soft": {
        "diameter": 10, "cover": 0.02, "contrast": 0.001, "inner_radius": (3, 6), "area_ratio": (0.3, 3),
        "inner_modulus": (1e4, 1e6), "outer_modulus": (1e4, 1e6),
    },
    "hairline-gap-bonded": {"gap": 0.005, "inner_radius": 10, "area_ratio": 1.5, "contrast": 10, "diameter": 12, "cover": 0.5},
    "thin-sleeve-tall": {
        "inner_radius": 4, "area_ratio": 12, "inner_slenderness": 5, "outer_slenderness": 5, "gap": 0.1, "inner_modulus": 1e5,
        "outer_modulus": 1e6, "diameter": 8, "cover": 0.5, "contrast": 10,
    },
    "wide-outer-flat": {
        "inner_radius": 2, "area_ratio": 0.05, "inner_slenderness": 0.2, "outer_slenderness": 0.2, "gap": 0.1, "contrast": 20,
        "diameter": 10, "cover": 0.3,
    },
    "giant-stiff-inclusion": {
        "inner_radius": 1, "area_ratio": 1, "gap": 0.05, "diameter": 40, "cover": 0.02, "contrast": 100, "tissue_depth": 60,
        "tissue_radius": 50,
    },
    "no-inclusion-incompressible": {
        "contrast": None, "tissue_poisson": 0.4999, "inner_poisson": 0.4999, "outer_poisson": 0.4999,
    },
    "frictionless-thin-cover": {
        "diameter": 8, "cover": 0.01, "contrast": 10, "inner_radius": (2, 5), "area_ratio": (0.2, 2), "frictionless": True,
    },
    "force-load-mixed": {"inner_radius": 4, "area_ratio": 0.8, "contrast": 10, "diameter": 8, "cover": 0.5, "by_force": True},
    "short-inner-tall-outer": {"inner_slenderness": 0.1, "outer_slenderness": 4, "inner_radius": 3, "area_ratio": 1},
    "tall-inner-short-outer": {"inner_slenderness": 8, "outer_slenderness": 0.2, "inner_radius": 3, "area_ratio": 1},
    "incompressible-everything-shallow": {
        "tissue_poisson": 0.4999, "inner_poisson": 0.4999, "outer_poisson": 0.4999, "inclusion_poisson": 0.4999,
        "contrast": 10, "diameter": 8, "cover": 0.05, "inner_radius": 4, "area_ratio": 0.5,
    },
    "zero-poisson": {
        "tissue_poisson": 0.0, "inner_poisson": 0.0, "outer_poisson": 0.0, "inclusion_poisson": 0.0, "contrast": 10,
        "diameter": 8, "cover": 0.3, "inner_radius": 4, "area_ratio": 0.5,
    },
    "narrow-tissue": {
        "tissue_radius_ratio": 1.1, "tissue_depth_ratio": 1.5, "inner_radius": 4, "area_ratio": 0.6, "gap": 0.2,
        "diameter": 6, "cover": 0.3, "contrast": 10,
    },
    "thin-tissue-layer": {
        "tissue_depth_ratio": 0.3, "tissue_radius_ratio": 3, "inner_radius": 8, "area_ratio": 0.5, "gap": 0.3, "diameter": 2,
        "cover": 0.25, "contrast": 50,
    },
    "thin-tissue-incompressible": {
        "tissue_depth_ratio": 0.3, "tissue_radius_ratio": 1.3, "inner_radius": 8, "area_ratio": 1, "gap": 0.3, "diameter": 2,
        "cover": 0.1, "contrast": 50, "tissue_poisson": 0.4999,
    },
    "tiny-probe-deep-big-tumour": {
        "inner_radius": 0.5, "area_ratio": 0.3, "gap": 0.02, "diameter": 30, "cover": 0.3, "contrast": 100,
        "tissue_depth": 60, "tissue_radius": 50,
    },
    "tiny-inclusion-shallow": {"inner_radius": 5, "area_ratio": 1, "diameter": 0.5, "cover": 0.2, "contrast": 1e3},
    "tiny-inclusion-deep-void": {"inner_radius": 3, "area_ratio": 1, "diameter": 1, "cover": 8, "contrast": 0.0001},
    "void-thin-cover": {"diameter": 8, "cover": 0.01, "contrast": 0.0001, "inner_radius": 4, "area_ratio": 1, "gap": 0.2},
    "wide-gap": {"gap": 5, "inner_radius": 2, "area_ratio": 0.3, "contrast": 10, "diameter": 6, "cover": 0.4},
    "gap-wider-than-blocks": {"gap": 4, "inner_radius": 0.8, "area_ratio": 0.5, "contrast": 30, "diameter": 10, "cover": 0.1},
    "blocks-softer-than-tissue": {
        "inner_modulus": 100, "outer_modulus": 300, "tissue_modulus": 1e4, "contrast": 10, "diameter": 8, "cover": 0.3,
        "inner_radius": 4, "area_ratio": 0.5,
    },
    "blocks-rigid": {
        "inner_modulus": 1e7, "outer_modulus": 1e7, "tissue_modulus": 1e3, "contrast": 10, "diameter": 8, "cover": 0.2,
        "inner_radius": 4, "area_ratio": 0.5,
    },
    "rigid-inner-soft-outer": {
        "inner_modulus": 1e7, "outer_modulus": 100, "inner_radius": 4, "area_ratio": 0.5, "contrast": 10, "diameter": 8,
        "cover": 0.3,
    },
    "soft-inner-rigid-outer-frictionless": {
        "inner_modulus": 100, "outer_modulus": 1e7, "inner_radius": 4, "area_ratio": 0.5, "contrast": 10, "diameter": 8,
        "cover": 0.3, "frictionless": True,
    },
    "frictionless-incompressible": {
        "tissue_poisson": 0.4999, "inner_poisson": 0.499, "outer_poisson": 0.4999, "contrast": 30, "diameter": 10,
        "cover": 0.1, "inner_radius": 3, "area_ratio": 0.3, "frictionless": True,
    },
    "frictionless-hairline-gap": {
        "gap": 0.005, "inner_radius": 6, "area_ratio": 2, "contrast": 5, "diameter": 8, "cover": 0.3, "frictionless": True,
    },
    "frictionless-thin-sleeve": {
        "inner_radius": 8, "area_ratio": 30, "gap": 0.05, "contrast": 10, "diameter": 14, "cover": 0.2,
        "inner_slenderness": 1, "outer_slenderness": 1, "frictionless": True,
    },
    "frictionless-force-giant-inclusion": {
        "inner_radius": 2, "area_ratio": 0.5, "diameter": 36, "cover": 0.01, "contrast": 10, "tissue_depth": 60,
        "tissue_radius": 40, "frictionless": True, "by_force": True,
    },
    "frictionless-no-inclusion-narrow": {
        "contrast": None, "tissue_radius_ratio": 1.15, "tissue_depth_ratio": 0.8, "frictionless": True,
    },
    "sleeve-fifty": {
        "inner_radius": 10, "area_ratio": 50, "gap": 0.05, "inner_slenderness": 0.5, "outer_slenderness": 0.5,
        "outer_modulus": 1e7, "inner_modulus": 1e5, "contrast": 10, "diameter": 14, "cover": 0.4,
    },
    "inclusion-fills-tissue": {
        "inner_radius": 3, "area_ratio": 0.7, "gap": 0.1, "diameter": 30, "cover": 0.05, "contrast": 20, "tissue_radius": 16,
        "tissue_depth": 35,
    },
    "inclusion-near-floor": {
        "inner_radius": 3, "area_ratio": 0.7, "diameter": 12, "cover": 0.3, "contrast": 20, "tissue_depth": 16.3,
        "tissue_radius": 30,
    },
    "thin-cover-under-gap": {
        "inner_radius": 1, "area_ratio": 0.4, "gap": 1.5, "diameter": 20, "cover": 0.005, "contrast": 50, "tissue_radius": 30,
        "tissue_depth": 30,
    },
    "weak-contrast": {"contrast": 1.05, "inner_radius": 3, "area_ratio": 0.3, "diameter": 6, "cover": 0.2},
    "flat-discs-incompressible": {
        "inner_slenderness": 0.05, "outer_slenderness": 0.05, "inner_poisson": 0.4999, "outer_poisson": 0.4999,
        "inner_radius": 6, "area_ratio": 1, "contrast": 10, "diameter": 10, "cover": 0.2,
    },
    "columns-ten-radii": {
        "inner_slenderness": 10, "outer_slenderness": 10, "inner_radius": 1.5, "area_ratio": 0.8, "gap": 0.1, "contrast": 10,
        "diameter": 5, "cover": 0.4,
    },
    "sleeve-fifty-tall": {
        "inner_radius": 2, "area_ratio": 50, "inner_slenderness": 10, "outer_slenderness": 10, "gap": 0.05,
        "outer_modulus": 1e6, "inner_modulus": 1e4, "contrast": 10, "diameter": 6, "cover": 0.3,
    },
    "frictionless-flat-discs": {
        "inner_slenderness": 0.05, "outer_slenderness": 0.05, "inner_poisson": 0.499, "outer_poisson": 0.4999,
        "inner_radius": 8, "area_ratio": 1.5, "gap": 0.01, "contrast": 10, "diameter": 10, "cover": 0.2, "frictionless": True,
    },
    "half-percent-cover-incompressible-frictionless": {
        "inner_radius": 4, "area_ratio": 0.3, "gap": 0.05, "diameter": 12, "cover": 0.005, "contrast": 30,
        "tissue_poisson": 0.4999, "inclusion_poisson": 0.4999, "frictionless": True,
    },
    "giant-void-incompressible": {
        "inner_radius": 0.5, "area_ratio": 0.5, "gap": 0.05, "diameter": 40, "cover": 0.02, "contrast": 0.001,
        "tissue_poisson": 0.4999, "tissue_depth": 60, "tissue_radius": 50,
    },
    "everything-extreme": {
        "inner_radius": 10, "area_ratio": 0.5, "gap": 0.005, "inner_slenderness": 0.05, "outer_slenderness": 10,
        "inner_modulus": 1e7, "outer_modulus": 100, "tissue_modulus": 1e3, "tissue_poisson": 0.4999, "inner_poisson": 0.4999,
        "outer_poisson": 0.4999, "inclusion_poisson": 0.4999, "contrast": 1e4, "diameter": 20, "cover": 0.005,
        "tissue_depth": 60, "tissue_radius": 50,
    },
    "deep-large-cover": {"inner_radius": 2, "area_ratio": 0.12, "gap": 0.2, "diameter": 8, "cover": 2, "contrast": 10},
    "wildcard-1": {},
    "wildcard-2": {},
    "wildcard-3": {"frictionless": True},
    "wildcard-4": {"by_force": True},
    "wildcard-5": {},
    "wildcard-6": {"frictionless": True, "by_force": True},
}
# fmt: on
