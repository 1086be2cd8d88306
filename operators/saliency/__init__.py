"""Saliency: context frames in, detected objects out."""

from operators.saliency.moved import MovedSaliency, MovedSaliencySettings
from operators.saliency.saliency import Saliency, SaliencySettings

__all__ = ["MovedSaliency", "MovedSaliencySettings", "Saliency", "SaliencySettings"]
