"""Training of the detector of text: oriented boxes around words, one class.

What it exports is used live by `operators.saliency` alone, as an output of format `obb`.
"""
