"""A policy for a consumer that acts: tracks, context, ROI and joints in, what to look at out."""

from operators.acting.acting import ActingPolicy, ActingPolicySettings
from operators.acting.looked import Looked

__all__ = ["ActingPolicy", "ActingPolicySettings", "Looked"]
