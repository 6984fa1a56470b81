"""The phase of the ratio under a sinusoidal load, from the materials' loss factors."""
