"""List the layers of a scene, with neighbours of one material merged."""

from __future__ import annotations

from geometry.scenes.scene import Tissue


def list_material_layers(tissue: Tissue, merged: bool = True) -> list[list[float]]:
    """Return thickness, modulus and Poisson's ratio of layers above the tissue's own material; equal neighbours are merged."""
    own_material, layers = [tissue.youngs_modulus, tissue.poisson_ratio], list[list[float]]()
    for layer in tissue.layer:
        material = [layer.youngs_modulus, layer.poisson_ratio]
        if merged and layers and layers[-1][1:] == material:
            layers[-1][0] += layer.thickness
        else:
            layers.append([layer.thickness, *material])
    while merged and layers and layers[-1][1:] == own_material:
        layers.pop()
    return layers
