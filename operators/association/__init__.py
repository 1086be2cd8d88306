"""Association: detections of each frame -> tracks over the past and the next frames."""

from operators.association.association import Association, AssociationSettings, AssociationState

__all__ = ["Association", "AssociationSettings", "AssociationState"]
