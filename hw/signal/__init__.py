"""From samples to charges: sine fits, noise, charge amplifier."""
