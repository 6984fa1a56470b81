"""Results of evaluators, and their computation from film forces: stresses and ratio with error bounds."""
