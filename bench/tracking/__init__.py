"""How well an object is tracked at a pixel budget, by acquisition strategy."""
