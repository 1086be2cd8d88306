"""Evaluation of tracking at a pixel budget, by acquisition strategy."""
