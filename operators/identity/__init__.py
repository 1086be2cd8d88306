"""Identity: tracks and what the ROI showed of them -> tracks whose ids are identities."""

from operators.identity.identity import Identity, IdentitySettings
from operators.identity.people import People

__all__ = ["Identity", "IdentitySettings", "People"]
