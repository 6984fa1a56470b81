"""Measure locating: the forward model of scans."""
