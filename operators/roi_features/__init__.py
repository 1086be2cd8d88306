"""Appearance at full resolution: ROI frame and tracks -> features and verdicts."""

from operators.roi_features.roi_features import RoiEncoder, RoiEncoderSettings

__all__ = ["RoiEncoder", "RoiEncoderSettings"]
