"""The linear-Gaussian model that every detection, estimate, calibration and check rests on."""
