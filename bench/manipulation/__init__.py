"""Evaluation of the manipulation task: seeded trials of a robot under a pixel budget."""
