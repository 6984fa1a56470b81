"""Sensitivity, optimisation, report and command line."""
