"""Policies: tracks and their ROI features -> which object to look at in the next frames.

There is one class per strategy; all have the same inputs, so that they are interchangeable.
"""

from typing import TYPE_CHECKING

from operators.policy.centred import CentredPolicy, CentredPolicySettings
from operators.policy.decision import PolicyState
from operators.policy.former import NO_POLICY
from operators.policy.greedy import GreedyPolicy, GreedyPolicySettings, GreedyState
from operators.policy.learned import LearnedPolicy, LearnedPolicySettings
from operators.policy.pursuit import PursuitPolicy, PursuitPolicySettings, PursuitState
from operators.policy.reading.greedy import GreedyReadingPolicy, GreedyReadingPolicySettings
from operators.policy.reading.inputs import TextPolicyState
from operators.policy.reading.policy import ReadingPolicy, ReadingPolicySettings
from operators.policy.round_robin import (
    RoundRobinPolicy,
    RoundRobinPolicySettings,
    RoundRobinState,
)
from operators.policy.verifying import VerifyingPolicy, VerifyingPolicySettings, VerifyingState

__all__ = [
    "CentredPolicy",
    "CentredPolicySettings",
    "GreedyPolicy",
    "GreedyPolicySettings",
    "GreedyReadingPolicy",
    "GreedyReadingPolicySettings",
    "GreedyState",
    "LearnedPolicy",
    "LearnedPolicySettings",
    "PolicyState",
    "PursuitPolicy",
    "PursuitPolicySettings",
    "PursuitState",
    "ReadingPolicy",
    "ReadingPolicySettings",
    "RoundRobinPolicy",
    "RoundRobinPolicySettings",
    "RoundRobinState",
    "TextPolicyState",
    "VerifyingPolicy",
    "VerifyingPolicySettings",
    "VerifyingState",
]


if not TYPE_CHECKING:  # type checkers see only the names above

    def __getattr__(name: str) -> object:
        """Raise an error that names the successors of the former class `Policy`."""
        missing = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(NO_POLICY if name == "Policy" else missing)
