"""Policies that show texts until they are read: learned, and by a rule."""
