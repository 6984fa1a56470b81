"""``curve``, ``scan``, ``detectability``: many readings of one probe, each beside its picture."""
