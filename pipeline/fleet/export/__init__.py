"""Exports of a graph to engines other than our agents' own deployment."""
