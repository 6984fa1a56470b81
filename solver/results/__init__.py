"""Results of evaluators, and their computation from film forces: stresses and ratio with error bounds."""

# Imports inside functions: limits of threads load SciPy, and whoever shows a result imports this package.
