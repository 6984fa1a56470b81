"""Calibration and check measured on built probes that are drawn at random."""
