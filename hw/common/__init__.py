"""Parts shared by all sources of samples: errors, samples and the interface of a transport."""
