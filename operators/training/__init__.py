"""Code shared by trainings; never imported by a running graph."""
