"""What `export` adds to the workshop's package: sizes rounded to what is machined, and what the ratio leaves each dimension."""
