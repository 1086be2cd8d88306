"""One graph over several hosts: agents that run its parts, certificates, clocks, deployment."""
