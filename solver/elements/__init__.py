"""Elements of the meridian plane: shape functions, their integrals, and sums over Gauss points as large products."""
