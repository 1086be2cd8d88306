"""Saliency: context frames in, detected objects out."""

from operators.saliency.saliency import Saliency, SaliencySettings

__all__ = ["Saliency", "SaliencySettings"]
