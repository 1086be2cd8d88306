"""Export of graphs to other deployment engines: systemd, Compose, Kubernetes."""
