"""Generate tetrahedra in child processes, with netgen from shapes and with pytetwild from triangles; define netgen's input."""
