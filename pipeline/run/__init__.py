"""Everything that runs a whole graph: supervisor, swaps, topology changes, in-line runner."""
