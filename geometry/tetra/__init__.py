"""Volume meshes: surfaces, pytetwild, repair, checks, cache."""
