"""Constitutive laws: from a scene's material to stiffness matrices at small strain and to energies at finite strain."""
