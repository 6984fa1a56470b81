"""Volume meshes: surfaces, pytetwild, repair, checks, cache."""

# Imports inside functions: pyvista loads only where a surface is read, platformdirs where a mesh is stored.
