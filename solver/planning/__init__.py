"""Choose the evaluator and its accuracy for a scene, decide which features may be neglected, and bound their effect."""

# Imports inside functions: formulas start without the coarse mesh and its SciPy, scenes that they
# do not concern without contact and solid, whose SciPy packages take longest, and without subprocess.
