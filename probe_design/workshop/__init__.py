"""Add to the files of `export`: sizes rounded for machining, and the deviation that the ratio allows each dimension."""
