"""What commands ask of graphs that run, and how it is shown."""
