"""What the parts of a running graph say to each other: tagged, versioned messages, one codec."""
