"""A small detector of what a robot handles, class-agnostic: its network and its training."""
