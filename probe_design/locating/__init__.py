"""Locate tumours from a scan: probabilities of their number, and of where, how deep, how large and how stiff each is."""
