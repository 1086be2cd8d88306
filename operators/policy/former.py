"""Removed settings of policies, with the error for graphs that still use them."""

from collections.abc import Mapping

CLASSES = (
    *("LearnedPolicy", "VerifyingPolicy", "PursuitPolicy"),
    *("GreedyPolicy", "RoundRobinPolicy", "CentredPolicy"),
)
_OPERATORS = f"operators.policy:{CLASSES[0]}, {', '.join(CLASSES[1:-1])} or {CLASSES[-1]}"
NO_POLICY = f"there is no class Policy any more; name {_OPERATORS} as the operator"
STRATEGY: Mapping[str, str] = {
    "strategy": f"expected the strategy as the class of the node, operator: {_OPERATORS}"
}
CARRIERS: Mapping[str, str] = {"held_by": "renamed; expected carriers"}
PRIOR: Mapping[str, str] = {"loyalty": "renamed; expected target_prior"}
FEEDBACK: Mapping[str, str] = {"feedback_score": "removed; what the consumer sees gained nothing"}
VERIFIED: Mapping[str, str] = {"least_genuine": "removed; objects that the ROI refutes stay"}
SEVERAL_LOOKS: Mapping[str, str] = {"looks": "removed; a verdict takes two looks"}
