"""Recordings of graphs: messages to MCAP files and back."""
