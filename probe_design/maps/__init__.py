"""Compute many readings of one probe, with pictures (commands ``curve``, ``scan`` and ``detectability``)."""
