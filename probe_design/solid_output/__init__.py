"""Pictures and VTU files of three-dimensional solutions."""

# Imports inside functions: pyvista and matplotlib load only for a file or a picture that is asked for.
