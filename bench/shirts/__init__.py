"""Shirt numbers of a whole pitch: who was read, and whether the name stayed with the right one."""
