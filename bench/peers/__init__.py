"""The contestants of `bench.bus`: one file per way to move a picture between two processes.

Each file runs by itself, `python -m bench.peers.NAME --nbytes N --count N --rate-hz R`, and prints
one JSON line (`ruler.collect`). They need numpy and the library they are named for, nothing of
fovea, so that they run in an environment of their own; `fovea_bus` needs fovea instead.
"""
