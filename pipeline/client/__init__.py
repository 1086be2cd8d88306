"""The client of running graphs, here or on several hosts: questions, orders, taps, status.

`pipeline.client.find` gives the client of a graph. Nothing here prints or reads a command line.
"""
