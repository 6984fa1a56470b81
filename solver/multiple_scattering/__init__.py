"""Multiple scattering between tumours, by modes, and the tissue's boundary, by finite elements."""
