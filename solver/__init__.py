"""A scene in, stresses out: one evaluator per level of fidelity behind one small interface."""
