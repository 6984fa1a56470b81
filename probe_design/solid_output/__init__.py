"""Pictures and VTU files of three-dimensional solutions."""
