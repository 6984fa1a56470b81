"""What every level takes and returns, and how film forces become stresses with bounds."""
