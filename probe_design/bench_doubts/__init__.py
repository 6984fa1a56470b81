"""What may be wrong with a bench: loads, lags, rates, force sensors, other probes; found where readings show it, else counted."""
