"""Generate tetrahedra in child processes, with netgen from shapes and with pytetwild from triangles; define netgen's input."""

# Imports inside functions: pytetwild loads without its pyvista, which must be hidden from it first.
