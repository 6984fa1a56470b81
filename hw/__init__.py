"""The built probe: transport, decoding and virtual probe. Imports nothing of the other packages."""
