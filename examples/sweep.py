"""A sweep from a script: ``python examples/sweep.py``. Stop it when you like and start it again: no row is computed twice."""

from pathlib import Path

from probe_design import sweep

SWEEP = {
    "scene": Path(__file__).with_name("scene.toml"),
    "evaluator": "closed-form",
    "sample": {"kind": "saltelli", "n": 64, "seed": 1},
    "variables": {
        "probe.gap": {"from": "0.05 mm", "to": "0.2 mm", "scale": "log"},
        "probe.outer.youngs_modulus": {"from": "20 kPa", "to": "1 MPa", "scale": "log"},
        "inclusion.depth": {"from": "7 mm", "to": "12 mm"},
    },
}
done = sweep(SWEEP, "out/sweep-script")
frame = done.to_frame()
print(frame.nlargest(3, "log_sensitivity")[["probe.gap", "probe.outer.youngs_modulus", "inclusion.depth", "log_sensitivity"]])
print(f"{done.ok} of {done.designs} designs answered, {done.answered} of them now")
