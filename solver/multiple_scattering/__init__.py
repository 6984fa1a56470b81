"""Multiple scattering between tumours and the tissue's boundary: modes out, finite elements back, a Galerkin series."""
