"""Policies: tracks and what the ROI showed of them -> which object to look at in the next frames.

One class for each strategy; they take the same inputs, so that one can take the place of another.
"""

from typing import TYPE_CHECKING

from operators.policy.centred import CentredPolicy, CentredPolicySettings
from operators.policy.decision import PolicyState
from operators.policy.former import NO_POLICY
from operators.policy.learned import LearnedPolicy, LearnedPolicySettings
from operators.policy.pursuit import PursuitPolicy, PursuitPolicySettings, PursuitState
from operators.policy.round_robin import (
    RoundRobinPolicy,
    RoundRobinPolicySettings,
    RoundRobinState,
)

__all__ = [
    "CentredPolicy",
    "CentredPolicySettings",
    "LearnedPolicy",
    "LearnedPolicySettings",
    "PolicyState",
    "PursuitPolicy",
    "PursuitPolicySettings",
    "PursuitState",
    "RoundRobinPolicy",
    "RoundRobinPolicySettings",
    "RoundRobinState",
]


if not TYPE_CHECKING:  # a checker shall see the names above and no others

    def __getattr__(name: str) -> object:
        """Raise the sentence that names what took the place of the class with all strategies."""
        missing = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(NO_POLICY if name == "Policy" else missing)
