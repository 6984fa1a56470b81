"""What a skin does to a scan: the probe of scene.toml moved over its tumour, without and with a breast's skin on the tissue.

    python examples/skin_scan.py [-o skin-scan.png]

Each curve is the ratio over that of the same tissue without the tumour, so that what is left is the tumour's own doing.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from geometry import Scene, read_scene
from probe_design.maps.scan import scan

HERE = Path(__file__).parent
SKIN = {"thickness": 1.44e-3, "youngs_modulus": 56.3e3, "poisson_ratio": 0.45}  # probe-design tissue show breast


def skinned(scene: Scene) -> Scene:
    """Return the scene with a skin on its tissue."""
    data = scene.model_dump(exclude_unset=True)
    return Scene.model_validate(data | {"tissue": data["tissue"] | {"layer": [SKIN]}})


def main() -> None:
    """Draw both scans."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("skin-scan.png"))
    options = parser.parse_args()
    scene, positions = read_scene(HERE / "scene.toml"), np.linspace(-20e-3, 20e-3, 41)
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for name, scanned_scene in (("no skin", scene), ("skin of 1.44 mm and 56.3 kPa", skinned(scene))):
        line = scan(scanned_scene, "x", positions, linear=True)
        ratio_without = line.ratio_without or np.nan
        change = 100 * (np.array(line.ratio, dtype=float) / ratio_without - 1)
        axes.plot(1e3 * positions, change, label=f"{name}: ratio without a tumour {ratio_without:.3f}")
        print(f"{name}: without a tumour {ratio_without:.4f}, above it {change.max():+.1f} %")
    axes.set(xlabel="probe's axis beside the tumour's, mm", ylabel="what the tumour changes of the ratio, %")
    figure.legend(loc="outside upper center", fontsize="small", ncols=2)
    axes.grid(alpha=0.3)
    figure.savefig(options.output, dpi=150)
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
