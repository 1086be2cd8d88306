"""What an ONNX file says about itself: facts by name -> its metadata."""

from collections.abc import Mapping
from pathlib import Path

import onnx


def describe(path: Path, facts: Mapping[str, str]) -> None:
    """Add facts to a network's metadata; those of the same name are replaced."""
    model = onnx.load(path)
    known = {p.key: p.value for p in model.metadata_props}
    onnx.helper.set_model_props(model, known | dict(facts))
    onnx.save(model, path)
