"""Pictures and VTU files of 3D solutions."""
