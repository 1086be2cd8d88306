"""What is attached to this host and what it can do; `fovea sensors`."""
