"""Diagnosis of an installation or a graph, with remedies."""

from pipeline.doctor.doctor import doctor_command

__all__ = ["doctor_command"]
