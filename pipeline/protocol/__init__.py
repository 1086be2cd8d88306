"""Control protocol of a running graph: tagged, versioned messages with one codec."""
