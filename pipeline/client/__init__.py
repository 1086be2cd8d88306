"""Clients of running graphs, local or deployed: questions, orders, taps, status.

`pipeline.client.find` returns the client of a graph. Nothing here prints or parses a command line.
"""
