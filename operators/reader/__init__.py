"""Read texts at full resolution: pictures in, texts with their boxes out."""

from operators.reader.ctc import OnnxReader
from operators.reader.reader import Reader
from operators.reader.shirts import ShirtReader

__all__ = ["OnnxReader", "Reader", "ShirtReader"]
