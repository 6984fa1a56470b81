"""A small scene that needs three dimensions: a grooved probe on a block of tissue, a tumour beside its axis."""

from geometry import scene_from_dict


def scene(**changes):
    soft = {"youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    block = {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48}
    tables = {
        "probe": {
            "inner_radius": "4 mm", "area_ratio": 1.2, "gap": "0.1 mm", "height": "3 mm", "inner": block, "outer": block,
            "base": {"rigid": True}, "groove": {"width": "2 mm", "depth": "1 mm"},
        },
        "tissue": {"shape": "block", "length": "60 mm", "breadth": "50 mm", "depth": "40 mm", **soft},
        "inclusion": [{"diameter": "8 mm", "depth": "7 mm", "x": "3 mm", **soft}],
        "load": {"indentation": "3 um"},
    }  # fmt: skip
    tables.update(changes)
    return scene_from_dict(tables)
