"""What is wrong with an installation or a graph, and what to do about it."""

from pipeline.doctor.doctor import doctor_command

__all__ = ["doctor_command"]
