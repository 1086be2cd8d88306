"""A street as a car sees it that drives along: signs, shop fronts and plates to be read."""

from drivers.scenes.road.scene import RoadScene

__all__ = ["RoadScene"]
