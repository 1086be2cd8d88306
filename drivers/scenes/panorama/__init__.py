"""A wide field that is read by windows: a ground of up to 16384x16384, and moving objects on it."""

from drivers.scenes.panorama.scene import PanoramaScene

__all__ = ["PanoramaScene"]
