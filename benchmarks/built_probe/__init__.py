"""Built probes drawn at random: what calibration and check make of them, counted."""
