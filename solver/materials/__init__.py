"""Constitutive laws of a scene's materials: stiffness matrices at small strain and energies at finite strain."""
