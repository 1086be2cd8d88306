"""ROI encoder: ROI frame and tracks -> appearance features and verdicts."""

from operators.roi_features.roi_features import RoiEncoder, RoiEncoderSettings

__all__ = ["RoiEncoder", "RoiEncoderSettings"]
