"""Policy: tracks and what the ROI showed of them -> which object to look at in the next frames."""

from operators.policy.policy import Policy, PolicySettings, PolicyState

__all__ = ["Policy", "PolicySettings", "PolicyState"]
