"""Choose the evaluator and its accuracy for a scene, decide which features may be neglected, and bound their effect."""

# Imports inside functions: formulas start without the coarse mesh and its SciPy, scenes without surface files without subprocess.
