"""What every source of samples shares: errors, samples, the interface of a transport."""
