"""Fit a law at finite strain to a measured curve of stress against stretch."""
