"""The phase of the ratio under a sinusoidal load, by the losses of the materials."""
