"""Saliency: context frames in, candidate objects out."""

from operators.saliency.saliency import Saliency, SaliencySettings

__all__ = ["Saliency", "SaliencySettings"]
