"""Linear algebra without physics: factorisations, conjugate gradients, threads and memory of the process."""
