"""Five small operators to read, to run and to copy.

    moving_square   a source: makes frames, at its own rate or when it is asked for one
    brighten        stateless: one frame in, one frame out
    motion          stateful: what it has learned survives a swap
    blend           two inputs: two frames of one exposure
    meter           settings that change while it runs, commands, figures for the report

Each has a graph of its name: `fovea run examples/motion`.
"""
