"""Graphs over several hosts: agents, certificates, clock offsets, deployment."""
