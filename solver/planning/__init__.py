"""Choose the evaluator and its accuracy for a scene, decide which features may be neglected, and bound their effect."""
