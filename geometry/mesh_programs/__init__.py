"""Programs that make tetrahedra, in processes of their own: netgen of shapes, pytetwild of triangles; and what netgen is told."""
