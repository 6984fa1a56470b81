"""Charges of bonded films: what film and bond change, and which film and bond to take."""
