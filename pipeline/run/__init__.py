"""What runs a whole graph: the supervisor of its processes, swaps, and the in-line runner."""
