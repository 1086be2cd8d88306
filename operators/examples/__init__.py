"""Five small operators to read, to run and to copy.

    moving_square   a source: produces frames, at its own rate or on request
    brighten        stateless: one frame in, one frame out
    motion          stateful: its background survives a swap
    blend           two inputs: two frames of one exposure
    meter           live settings, commands, figures for the report

Each has a graph of its name: `fovea run examples/motion`.
"""
