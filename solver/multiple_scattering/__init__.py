"""Tumours and boundary answering each other: modes out, finite elements back, summed as a Galerkin series."""
