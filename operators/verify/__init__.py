"""A second look: what a detector finds in the ROI corrects and verifies what the context showed."""

from operators.verify.refine import Refine
from operators.verify.second_look import SecondLookSettings
from operators.verify.verify import Verify

__all__ = ["Refine", "SecondLookSettings", "Verify"]
